"""`uav-recon bench endurance`: memory, disk and time per view over hours of keyframes.

They must not grow. No flight is simulated. The views of `bench mapper` are repeated, each round in another order. Each
keyframe runs through the complete mapper: save to disk, add to memory, training steps, surface, and a checkpoint when due.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from sitl.bench.mapper import seeded_views, training_run
from sitl.bench.mapper.mapper_bench import PRINTED_WIDTH, MapperBench
from sitl.bench.mapper.mapper_tables import figure
from uav_recon.app.option_validation import UsageError
from uav_recon.evaluation.triangle_surface import TriangleSurface
from uav_recon.mapping.keyframe_store import KeyframeFolder
from uav_recon.mapping.neural.keyframes.ray_buffer import MAX_VIEWS
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.worker.checkpoint import MapperCheckpoints
from uav_recon.measurement import host_info, result_file
from uav_recon.measurement.machine_speed import measure_machine_speed
from uav_recon.measurement.printed_table import narrow_table

PARTS = 10
HOURS = (0.01, 10.0)


@dataclass(frozen=True)
class Part:
    """Results of a tenth of the run.

    Times are medians over its views, in processor milliseconds of the mapper's thread.

    calibration_cpu: slowness of the machine relative to the reference at the end of the part; other programs may affect it.
    """

    views: int
    kept: int
    save_ms: float
    add_ms: float
    step_ms: float
    surface_ms: float
    checkpoint_ms: float  # longest delay of the mapper by a checkpoint
    resident_mb: float
    checkpoint_mb: float
    slots: int
    calibration_cpu: float


@dataclass(frozen=True)
class Endurance:
    """Results of the run.

    when_full: accuracy when the keyframe memory was first full (None: never).
    at_the_end: accuracy at the end.
    """

    parts: list[Part]
    when_full: training_run.Accuracy | None
    at_the_end: training_run.Accuracy


def bench_endurance(wanted: MapperBench, hours: float, period_s: float) -> int:
    """Measure, print a table, write JSON. Raises UserError with one line for bad input."""
    if not HOURS[0] <= hours <= HOURS[1] or not 0.1 <= period_s <= 60.0:
        raise UsageError(f"--hours {hours:g} --period-s {period_s:g}: want {HOURS[0]:g} to {HOURS[1]:g} h, 0.1 to 60 s")
    options, console = wanted.checked(), Console(stderr=True)
    with console.status("loading ...") as status:
        scene = seeded_views.load(options, lambda what: status.update(f"{what} ..."))
        training_run.warm_up(scene.keyframes[0])
    count = max(int(hours * 3600.0 / period_s), PARTS)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as progress:
        task = progress.add_task("keyframes", total=count)

        def tick() -> None:
            progress.advance(task)
            progress.refresh()

        result = endure(scene, count, wanted.steps_per_view, wanted.seed, tick)
    _show(
        Console(width=None if sys.stdout.isatty() else PRINTED_WIDTH),
        result,
        f"{scene.name}: {count} keyframes of {len(scene.keyframes)} views, {wanted.steps_per_view} steps each",
    )
    if wanted.json is not None:
        about = {"machine": host_info.processor(), "commit": host_info.commit()}
        result_file.save(wanted.json, asdict(result) | {"about": about})
    return 0


def endure(
    scene: seeded_views.MapperScene, count: int, steps_per_view: int, seed: int, tick: training_run.Tick = lambda: None
) -> Endurance:
    """Run the mapper on ``count`` keyframes."""
    random, trainer, order = (
        np.random.default_rng(seed),
        training_run.make_trainer(scene, steps_per_view, seed),
        np.zeros(0, int),
    )
    parts: list[Part] = []
    when_full: training_run.Accuracy | None = None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        keyframes, checkpoints = KeyframeFolder(folder / "keyframes"), MapperCheckpoints(folder / "checkpoint", {"seed": seed})
        laps: list[list[float]] = []
        for n in range(count):
            if not len(order):
                order = random.permutation(len(scene.keyframes))
            view, order = scene.keyframes[order[0]], order[1:]
            lap = [time.thread_time()]
            keyframes.save(view)
            lap.append(time.thread_time())
            trainer.add(view)
            lap.append(time.thread_time())
            trainer.train(steps_per_view)
            lap.append(time.thread_time())
            trainer.surface()
            lap.append(time.thread_time())
            checkpoints.save_if_due(trainer, n + 1, keyframes.stamp_s(n))
            lap.append(time.thread_time())
            laps.append(lap)
            if len(trainer.kept) == MAX_VIEWS and when_full is None:
                when_full = _accuracy(trainer, scene)
            if (n + 1) * PARTS // count > len(parts):
                checkpoints.wait()
                took = np.diff(np.array(laps) * 1e3)
                disk_mb = sum(path.stat().st_size for path in (folder / "checkpoint").iterdir()) / 1e6 if n >= 8 else 0.0
                save, add, train, surface, _ = np.median(took, axis=0)
                parts.append(
                    Part(
                        n + 1, len(trainer.kept), save, add, train / steps_per_view, surface, took[:, 4].max(),
                        host_info.resident_mb(), disk_mb, trainer.field.slots, measure_machine_speed().cpu_slowdown,
                    )
                )  # fmt: skip
                laps = []
            tick()
        checkpoints.wait()
    return Endurance(parts, when_full, _accuracy(trainer, scene))


def _accuracy(trainer: NeuralMapper, scene: seeded_views.MapperScene) -> training_run.Accuracy:
    mesh = trainer.mesh(training_run.MESH_VOXEL_M)
    return training_run.against_truth(TriangleSurface(mesh.vertices_world, mesh.faces), scene)


def _show(console: Console, result: Endurance, title: str) -> None:
    table = narrow_table(title, "views", "kept", "save", "add", "step", "surface", "held up", "RAM", "disk", "machine")
    for part in result.parts:
        numbers = (part.save_ms, part.add_ms, part.step_ms, part.surface_ms, part.checkpoint_ms)
        table.add_row(
            str(part.views), str(part.kept), *(f"{ms:.1f}" for ms in numbers),
            f"{part.resident_mb:.0f}", f"{part.checkpoint_mb:.0f}", f"{part.calibration_cpu:.2f}",
        )  # fmt: skip
    console.print(table)
    console.print(
        "save to held up (the longest wait for a checkpoint): ms, raw; RAM and disk (the checkpoint's): MB; machine: times as "
        "slow as the reference machine"
    )
    for when, accuracy in ((f"when {MAX_VIEWS} views were kept", result.when_full), ("at the end", result.at_the_end)):
        if accuracy is not None:
            console.print(
                f"{when}: accuracy {figure(accuracy.accuracy_cm, 2)} cm, completion {figure(accuracy.completion_cm, 2)} cm, "
                f"recall {figure(accuracy.recall_seen_5cm, 3)}",
                highlight=False,
            )
