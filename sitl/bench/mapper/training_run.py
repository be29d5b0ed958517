"""Timed training of the mapper on a scene's views: one by one as in flight, or all at once.

Times are processor seconds of the calling thread, which are not lengthened by other load.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from sitl.bench.mapper.seeded_views import ImageRays, MapperScene
from sitl.bench.mapper.sparsification import ause
from uav_recon.config import MapperConfig, UncertaintyName
from uav_recon.evaluation.metrics import PSNR_CAP_DB, share_within
from uav_recon.evaluation.recall import ElementRecall
from uav_recon.evaluation.triangle_surface import TriangleSurface
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.sdf_interface import SdfField
from uav_recon.measurement import host_info
from uav_recon.measurement.stage_timing import TimingSummary
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import Float32Array

RECALLS = (0.90, 0.95, 0.99)
# steps between two evaluations of the recall, and max. steps
RECALL_EVERY = 10
RECALL_STEPS = 1000
SAMPLES = 300_000
FAR_M = 0.10  # surface farther than this from ground truth is hallucinated
WITHIN_M = 0.05
PARTIAL_SHARE = 0.375  # share of the views after which the uncertainty is evaluated
MESH_VOXEL_M = 0.02
WHOLE_VOXEL_M = 0.05
ROOM_RUNS = 7
COLOUR_SIGMAS: tuple[UncertaintyName, ...] = ("colour", "paper")

Tick = Callable[[], None]


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of a mesh against the visible ground truth.

    The cm values are means.

    hallucinated_fraction: share of the mesh's area.
    """

    accuracy_cm: float | None
    completion_cm: float | None
    recall_seen_5cm: float
    hallucinated_fraction: float | None


@dataclass(frozen=True)
class Online:
    """Results of training view by view.

    step, view_update and extraction_view summarize processor times over the views; *_wall are the wall-clock times.
    """

    trainer: NeuralMapper
    step: TimingSummary
    step_wall: TimingSummary
    view_update: TimingSummary
    view_update_wall: TimingSummary
    extraction_view: TimingSummary
    memory_mb: float
    ause_all: float | None
    ause_observed: float | None


def make_trainer(scene: MapperScene, steps_per_view: int, seed: int) -> NeuralMapper:
    """Return a mapper of the scene's box."""
    config = MapperConfig(seed=seed, steps_per_view=steps_per_view)
    return NeuralMapper(config, scene.low_m, scene.high_m, scene.depth_noise_px, 0.05)


def online(scene: MapperScene, steps_per_view: int, seed: int, tick: Tick = lambda: None) -> Online:
    """Add the views one by one, with steps_per_view training steps after each."""
    resident_mb = host_info.resident_mb()
    trainer = make_trainer(scene, steps_per_view, seed)
    steps, updates, extractions = [], [], []
    partial = max(1, round(PARTIAL_SHARE * len(scene.keyframes)))
    all_score, observed_score = None, None
    for n, keyframe in enumerate(scene.keyframes):
        began = _clocks()
        trainer.add(keyframe)
        added = _clocks()
        trainer.train(steps_per_view)
        trained = _clocks()
        trainer.surface()
        extractions.append(_clocks() - trained)
        steps.append((trained - added) / steps_per_view)
        updates.append(trained - began)
        if n + 1 == partial:
            all_score, observed_score = uncertainty_scores(trainer, scene.surface)
        tick()
    grown_mb = host_info.resident_mb() - resident_mb
    (step, step_wall), (update, update_wall), (extraction, _) = (_spreads(t) for t in (steps, updates, extractions))
    return Online(
        trainer, step, step_wall, update, update_wall, extraction, grown_mb, all_score, observed_score
    )  # fmt: skip


def learned(scene: MapperScene, steps_per_view: int, seed: int, correct: bool, tick: Tick = lambda: None) -> NeuralMapper:
    """Train on the views one by one, without timing.

    correct: if False, poses and exposures are not corrected.
    """
    trainer = make_trainer(scene, steps_per_view, seed)
    trainer.align_views = trainer.learn_gains = correct
    for keyframe in scene.keyframes:
        trainer.add(keyframe)
        trainer.train(steps_per_view)
        tick()
    return trainer


def colour_sigmas(scene: MapperScene, steps_per_view: int, seeds: Iterable[int], tick: Tick = lambda: None) -> dict[str, float]:
    """Return the median of each colour sigma on the surface, 0..1; geometric mean over seeds."""
    logs = []
    for seed in seeds:
        trainer = learned(scene, steps_per_view, seed, True, tick)
        points = trainer.all_surface_elements().position_world.astype(np.float32)
        logs.append([np.log(np.median(trainer.uncertainties[name].at(points))) for name in COLOUR_SIGMAS])
    means = np.exp(np.mean(logs, axis=0))
    return {name: float(mean) for name, mean in zip(COLOUR_SIGMAS, means, strict=True)}


def uncertainty_scores(trainer: NeuralMapper, truth: TriangleSurface) -> tuple[float | None, float | None]:
    """Return the AUSE of the mapper's uncertainty over all vertices and over observed vertices."""
    whole = trainer.whole_surface(WHOLE_VOXEL_M)
    error = truth.distance_m(whole.vertices.astype(np.float64))
    uncertainty = trainer.uncertainty.at(whole.vertices).astype(np.float64)
    return ause(error, uncertainty), ause(error[whole.observed], uncertainty[whole.observed])


def room_extraction(trainer: NeuralMapper) -> TimingSummary:
    """Time the extraction of all elements of the room, ROOM_RUNS times."""
    took = []
    for _ in range(ROOM_RUNS):
        began = _clocks()
        trainer.all_surface_elements()
        took.append(_clocks() - began)
    return _spreads(took)[0]


def time_to_recall(scene: MapperScene, seed: int, tick: Tick = lambda: None) -> dict[str, float | None]:
    """Return the seconds of training on all views at once until each recall is reached.

    Adding the views is not counted.
    """
    trainer = make_trainer(scene, 1, seed)
    for keyframe in scene.keyframes:
        trainer.add(keyframe)
    truth = ElementRecall(scene.points, trainer.element_spacing_m)
    reached: dict[str, float | None] = {f"{recall:.2f}": None for recall in RECALLS}
    took_s = 0.0
    for _ in range(0, RECALL_STEPS, RECALL_EVERY):
        began = _clocks()
        trainer.train(RECALL_EVERY)
        took_s += float((_clocks() - began)[0]) * 1e-3
        surface = trainer.all_surface_elements()
        recall = truth.of(surface.position_world, surface.normal_world)
        for name, value in reached.items():
            if value is None and recall >= float(name):
                reached[name] = took_s
        tick()
        if all(value is not None for value in reached.values()):
            break
    return reached


def against_truth(model: TriangleSurface, scene: MapperScene, seed: int = 0) -> Accuracy:
    """Compare a model with the ground truth: point-to-surface distances in both directions.

    300,000 points are drawn on the model by area.
    """
    to_truth_m = scene.surface.distance_m(model.sample(SAMPLES, seed))
    to_model_m = model.distance_m(scene.points)
    empty = not len(to_truth_m)
    return Accuracy(
        None if empty else 100.0 * float(to_truth_m.mean()),
        None if empty else 100.0 * float(to_model_m.mean()),
        share_within(to_model_m, WITHIN_M) or 0.0,
        None if empty else float(np.mean(to_truth_m > FAR_M)),
    )


def picture_psnr_db(trainer: NeuralMapper, field: SdfField, pictures: ImageRays) -> float | None:
    """Return the mean PSNR over the held-out images, rendered from a field.

    field: the trainer's field, with or without fused colours. A pixel without surface is black.
    """
    if not len(pictures.rgb):
        return None
    rgb = trainer.look(field, pictures.origin, pictures.direction)
    square = ((rgb.astype(np.float64) - pictures.rgb / 255.0) ** 2).mean(axis=1)
    pixels = np.bincount(pictures.picture)
    error = np.bincount(pictures.picture, square)[pixels > 0] / pixels[pixels > 0]
    worst = 10.0 ** (-0.1 * PSNR_CAP_DB)
    return float(np.mean(-10.0 * np.log10(np.maximum(error, worst))))


def warm_up(keyframe: PosedFrame) -> None:
    """Compile everything that is timed."""
    position = keyframe.world_from_depth.translation_m
    trainer = NeuralMapper(MapperConfig(), position - 1.5, position + 1.5, 0.02, 0.05)
    trainer.warm_up()
    trainer.add(keyframe)
    trainer.train(2)
    trainer.surface()
    trainer.whole_surface(WHOLE_VOXEL_M)
    ray: Float32Array = np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
    trainer.look(trainer.painted(), position[None].astype(np.float32), ray)


def _clocks() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the processor time of this thread and the wall-clock time, in milliseconds."""
    return np.array([time.thread_time() * 1e3, time.perf_counter() * 1e3])


def _spreads(took: list[np.ndarray[tuple[int], np.dtype[np.float64]]]) -> tuple[TimingSummary, TimingSummary]:
    columns = np.array(took).reshape(-1, 2)
    return TimingSummary.of(columns[:, 0]), TimingSummary.of(columns[:, 1])
