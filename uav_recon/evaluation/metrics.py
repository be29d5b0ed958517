"""Metrics of a model against ground truth, and statistics of streams and exploration.

All functions are pure, and all sampling is seeded. Accuracy and completion are point-to-surface distances: they are zero for
a perfect model. The point-to-point figures of the paper are reported too. They never fall below point_floor_cm, the distance
between two samplings of the ground truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from uav_recon.evaluation.triangle_surface import TriangleSurface
from uav_recon.types.flight_metrics import ModelQuality, StreamStatistics
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray

SAMPLES = 300_000
PSNR_CAP_DB = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceTruth:
    """Ground truth in world, fixed per scene and mount; does not depend on what a flight saw.

    surface: the triangles a model may lie on. points_world (N, 3): area-weighted samples of the part that can be seen.
    points_again_world (M, 3): a second sampling of the same part, for the floor of the point-to-point figures; without it
    the floor is taken between two halves of the points and scaled to their full density.
    """

    surface: TriangleSurface
    points_world: FloatArray
    points_again_world: FloatArray | None = None


def measure(
    model: TriangleSurface, truth: SurfaceTruth, psnr: float | None, seed: int = 0, samples: int = SAMPLES
) -> ModelQuality:
    """Measure a model against ground truth, both in world.

    ``samples`` area-weighted points are drawn on the model. An empty model has a recall of zero and no accuracy.
    """
    model_points = model.sample(samples, seed)
    to_truth_m = truth.surface.distance_m(model_points)
    to_model_m = model.distance_m(truth.points_world)
    precision_2cm, recall_2cm = share_within(to_truth_m, 0.02), share_within(to_model_m, 0.02)
    return ModelQuality(
        accuracy_cm=_mean_cm(to_truth_m),
        completion_cm=_mean_cm(to_model_m),
        recall_5cm=share_within(to_model_m, 0.05),
        recall_2cm=recall_2cm,
        f_score_2cm=f_score(precision_2cm, recall_2cm),
        psnr_db=psnr,
        accuracy_point_cm=_mean_cm(point_distance_m(model_points, truth.points_world)),
        completion_point_cm=_mean_cm(point_distance_m(truth.points_world, model_points)),
        point_floor_cm=_point_floor_cm(truth, seed),
    )


def point_distance_m(from_points: FloatArray, to_points: FloatArray) -> FloatArray:
    """Return the distance (N,) from each point (N, 3) to the nearest of ``to_points`` (M, 3).

    Infinite if M = 0.
    """
    if len(to_points) == 0:
        return np.full(len(from_points), np.inf)
    distance = np.empty(len(from_points))
    near = cKDTree(from_points).indices  # neighbours in sequence: a search finds the memory of the previous one in the cache
    distance[near], _ = cKDTree(to_points).query(from_points[near], workers=-1)
    return distance


def share_within(distance_m: FloatArray, threshold_m: float) -> float | None:
    """Return the share of distances under a threshold; None without distances.

    This is the recall for distances from truth to model, the precision from model to truth.
    """
    return float(np.mean(distance_m < threshold_m)) if len(distance_m) else None


def f_score(precision: float | None, recall: float | None) -> float | None:
    """Return the harmonic mean of precision and recall (Knapitsch et al. 2017).

    An empty model scores 0; None without truth.
    """
    if recall is None:
        return None
    if not precision or not recall:
        return 0.0
    return 2.0 * precision * recall / (precision + recall)


def psnr_db(images: Sequence[ByteArray], truths: Sequence[ByteArray]) -> float | None:
    """Return the peak signal-to-noise ratio, averaged over views; None without views.

    images (H, W, 3) uint8; the caller renders unseen pixels black. A view without any error counts as 100 dB. Raises
    ValueError if counts or shapes differ.
    """
    if len(images) != len(truths):
        raise ValueError(f"{len(images)} images for {len(truths)} truths")
    values = []
    for image, truth in zip(images, truths, strict=True):
        if image.shape != truth.shape:
            raise ValueError(f"image {image.shape} does not fit truth {truth.shape}")
        error = float(np.mean((image.astype(np.float64) - truth.astype(np.float64)) ** 2))
        values.append(PSNR_CAP_DB if error == 0.0 else min(PSNR_CAP_DB, 10.0 * float(np.log10(255.0**2 / error))))
    return float(np.mean(values)) if values else None


def stream_statistics(arrival_s: Sequence[float] | FloatArray) -> StreamStatistics:
    """Return rate and gaps of messages from their arrival times (any order)."""
    gaps_s = np.diff(np.sort(np.asarray(arrival_s, dtype=np.float64)))
    if len(gaps_s) == 0 or gaps_s.sum() <= 0.0:
        return StreamStatistics(None, None, None)
    return StreamStatistics(
        rate_hz=float(len(gaps_s) / gaps_s.sum()),
        gap_p99_ms=float(np.percentile(gaps_s, 99.0) * 1e3),
        gap_max_ms=float(gaps_s.max() * 1e3),
    )


def explored_fraction(known_free: BoolArray, truth_free_seen: BoolArray) -> float | None:
    """Return the share of the visible free voxels of the ground truth that the map has as free.

    The masks have the same shape, else ValueError. None if no voxel is visible.
    """
    if known_free.shape != truth_free_seen.shape:
        raise ValueError(f"known free {known_free.shape} and truth {truth_free_seen.shape} are on different grids")
    total = int(np.count_nonzero(truth_free_seen))
    return float(np.count_nonzero(known_free & truth_free_seen) / total) if total else None


def _point_floor_cm(truth: SurfaceTruth, seed: int) -> float | None:
    """Return the distance between two samplings of the ground truth.

    On a surface, the mean distance to the nearest of n points per area is proportional to 1 / sqrt(n).
    """
    if truth.points_again_world is not None:
        return _mean_cm(point_distance_m(truth.points_again_world, truth.points_world))
    order = np.random.default_rng(seed).permutation(len(truth.points_world))
    half = len(order) // 2
    floor_cm = _mean_cm(point_distance_m(truth.points_world[order[:half]], truth.points_world[order[half:]]))
    return None if floor_cm is None else floor_cm / float(np.sqrt(2.0))


def _mean_cm(distance_m: FloatArray) -> float | None:
    """Return the mean in cm; None if there is no distance or one is infinite."""
    if len(distance_m) == 0 or not np.isfinite(distance_m).all():
        return None
    return float(distance_m.mean() * 100.0)
