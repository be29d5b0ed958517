"""`uav-recon bench uncertainty`: how each uncertainty ranks true errors, on partial maps."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from sitl.bench.mapper import mapper_tables, seeded_views, training_run
from sitl.bench.mapper.mapper_bench import VIEWS, MapperBench, ticking
from sitl.bench.mapper.sparsification import ause, spearman
from uav_recon.app.option_validation import UsageError
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.measurement import host_info, result_file
from uav_recon.measurement.machine_speed import measure_machine_speed

PRINTED_WIDTH = 100  # if the output is not a terminal
RANDOM_SEED = 20240320

Result = dict[str, Any]


def views_of(words: str) -> tuple[int, ...]:
    """Parse the numbers of views after which a map is evaluated, ascending.

    Raises UserError with one line for bad input.
    """
    try:
        views = tuple(sorted({int(word) for word in words.split(",")}))
    except ValueError:
        views = ()
    if not views or not 1 <= views[0] <= views[-1] <= VIEWS[1]:
        raise UsageError(f"--after {words}: want numbers of views with commas between them, 1 to {VIEWS[1]}")
    return views


def bench_uncertainty(wanted: MapperBench, after: tuple[int, ...]) -> int:
    """Measure, print a table, write JSON. Raises UserError with one line for bad input."""
    options = wanted.checked()
    console = Console(stderr=True)
    with console.status("loading ...") as status:
        scene = seeded_views.load(options, lambda what: status.update(f"{what} ..."))
        status.update("compiling ...")
        training_run.warm_up(scene.keyframes[0])
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as progress:
        maps = partial_maps(scene, wanted, after, ticking(progress, "view by view", len(scene.keyframes)))
    about = {
        "scene": scene.name,
        **{name: getattr(wanted, name) for name in _TOLD},
        "camera_errors": wanted.camera_error_scale,
        "machine": host_info.processor(),
        "commit": host_info.commit(),
        "calibration_cpu": measure_machine_speed().cpu_slowdown,
    }
    result: Result = {"about": about, "partial_maps": maps}
    mapper_tables.show_uncertainties(Console(width=None if sys.stdout.isatty() else PRINTED_WIDTH), result)
    if wanted.json is not None:
        result_file.save(wanted.json, result)
    return 0


_TOLD = ("views", "camera", "depth_noise", "mount", "pose_noise", "steps_per_view", "seed")


def partial_maps(
    scene: seeded_views.MapperScene, wanted: MapperBench, after: tuple[int, ...], tick: Callable[[], None]
) -> list[Result]:
    """Return the scores of every measure after each of the given numbers of views."""
    trainer = training_run.make_trainer(scene, wanted.steps_per_view, wanted.seed)
    maps = []
    for n, keyframe in enumerate(scene.keyframes):
        trainer.add(keyframe)
        trainer.train(wanted.steps_per_view)
        if n + 1 in after:
            maps.append(_scores(trainer, scene) | {"views": n + 1})
        tick()
    return maps


def _scores(trainer: NeuralMapper, scene: seeded_views.MapperScene) -> Result:
    whole = trainer.whole_surface(training_run.WHOLE_VOXEL_M)
    error = scene.surface.distance_m(whole.vertices.astype(np.float64))
    seen = whole.observed
    scores = {}
    for name, measure in trainer.uncertainties.items():
        value = measure.at(whole.vertices).astype(np.float64)
        scores[name] = {
            "ause_all": ause(error, value),
            "ause_observed": ause(error[seen], value[seen]),
            "spearman_all": spearman(error, value),
            "spearman_observed": spearman(error[seen], value[seen]),
        }
    by_chance = np.random.default_rng(RANDOM_SEED).random(len(error))
    return {
        "vertices": len(error),
        "observed_share": float(seen.mean()),
        "error_all_cm": 100.0 * float(error.mean()),
        "error_observed_cm": 100.0 * float(error[seen].mean()),
        "random_all": ause(error, by_chance),
        "random_observed": ause(error[seen], by_chance[seen]),
        "scores": scores,
    }
