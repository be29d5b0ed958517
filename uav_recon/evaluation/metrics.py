"""Quality of a model against truth, and the numbers of a stream and of a planner. Pure; every sampling is seeded.

Accuracy and completion are point to surface: they reach zero for a perfect model. The paper's point-to-point figures
stand beside them and never fall under point_floor_cm, the distance of truth sampled twice against itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from uav_recon.evaluation.triangle_surface import TriangleSurface
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray

SAMPLES = 300_000
PSNR_CAP_DB = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceTruth:
    """What a model is held against, in world; frozen once per scene and mount, never cut by what a flight saw.

    surface: the triangles a model may lie on. points (N, 3): drawn on the part that can be seen, area-weighted.
    points_again (M, 3): the same part drawn a second time, for the floor of the point-to-point figures; without it the
    floor is taken between two halves of the points and scaled to their whole density.
    """

    surface: TriangleSurface
    points_world: FloatArray
    points_again_world: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Quality:
    """The quality section of report.json: cm, shares of 1, dB. None where there is nothing to measure."""

    accuracy_cm: float | None
    completion_cm: float | None
    recall_5cm: float | None
    recall_2cm: float | None
    f_score_2cm: float | None
    psnr_db: float | None
    accuracy_point_cm: float | None
    completion_point_cm: float | None
    point_floor_cm: float | None


@dataclass(frozen=True, slots=True)
class StreamStatistics:
    """A periodic stream as it arrived; None where there were too few arrivals to say."""

    rate_hz: float | None
    gap_p99_ms: float | None
    gap_max_ms: float | None


def measure(model: TriangleSurface, truth: SurfaceTruth, psnr: float | None, seed: int = 0, samples: int = SAMPLES) -> Quality:
    """Measure a model against truth, both in world.

    ``samples`` points are drawn on the model, area-weighted. An empty model recalls nothing and has no accuracy.
    """
    model_points = model.sample(samples, seed)
    to_truth_m = truth.surface.distance_m(model_points)
    to_model_m = model.distance_m(truth.points_world)
    precision_2cm, recall_2cm = share_within(to_truth_m, 0.02), share_within(to_model_m, 0.02)
    return Quality(
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
    """Distance (N,) from each point (N, 3) to the nearest of ``to_points`` (M, 3); infinite if M = 0."""
    if len(to_points) == 0:
        return np.full(len(from_points), np.inf)
    distance = np.empty(len(from_points))
    near = cKDTree(from_points).indices  # neighbours after each other: what one search read is at hand for the next
    distance[near], _ = cKDTree(to_points).query(from_points[near], workers=-1)
    return distance


def share_within(distance_m: FloatArray, threshold_m: float) -> float | None:
    """Share of distances under a threshold: recall from truth to model, precision from model to truth."""
    return float(np.mean(distance_m < threshold_m)) if len(distance_m) else None


def f_score(precision: float | None, recall: float | None) -> float | None:
    """Harmonic mean of precision and recall (Knapitsch et al. 2017); an empty model scores 0."""
    if recall is None:
        return None
    if not precision or not recall:
        return 0.0
    return 2.0 * precision * recall / (precision + recall)


def psnr_db(images: Sequence[ByteArray], truths: Sequence[ByteArray]) -> float | None:
    """Mean over views of the peak signal to noise ratio; images (H, W, 3) uint8, unseen pixels black by their maker.

    A view without any error counts as 100 dB. Raises ValueError if counts or shapes differ.
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
    """Rate and gaps of messages that arrived at these instants (any order)."""
    gaps_s = np.diff(np.sort(np.asarray(arrival_s, dtype=np.float64)))
    if len(gaps_s) == 0 or gaps_s.sum() <= 0.0:
        return StreamStatistics(None, None, None)
    return StreamStatistics(
        rate_hz=float(len(gaps_s) / gaps_s.sum()),
        gap_p99_ms=float(np.percentile(gaps_s, 99.0) * 1e3),
        gap_max_ms=float(gaps_s.max() * 1e3),
    )


def explored_fraction(known_free: BoolArray, truth_free_seen: BoolArray) -> float | None:
    """Share of the truly free voxels that can be seen, which the flight knows to be free; masks of one shape.

    Raises ValueError if the shapes differ. None if nothing can be seen.
    """
    if known_free.shape != truth_free_seen.shape:
        raise ValueError(f"known free {known_free.shape} and truth {truth_free_seen.shape} are on different grids")
    total = int(np.count_nonzero(truth_free_seen))
    return float(np.count_nonzero(known_free & truth_free_seen) / total) if total else None


def _point_floor_cm(truth: SurfaceTruth, seed: int) -> float | None:
    """Truth against itself. The mean distance to the nearest of n points per area goes with 1 / sqrt(n) on a surface."""
    if truth.points_again_world is not None:
        return _mean_cm(point_distance_m(truth.points_again_world, truth.points_world))
    order = np.random.default_rng(seed).permutation(len(truth.points_world))
    half = len(order) // 2
    floor_cm = _mean_cm(point_distance_m(truth.points_world[order[:half]], truth.points_world[order[half:]]))
    return None if floor_cm is None else floor_cm / float(np.sqrt(2.0))


def _mean_cm(distance_m: FloatArray) -> float | None:
    """Mean in cm; None if there is none or it is infinite (nothing to be near to)."""
    if len(distance_m) == 0 or not np.isfinite(distance_m).all():
        return None
    return float(distance_m.mean() * 100.0)
