"""`uav-recon bench planner`: time per frame from fusion to tour, and quality of the results."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rich.console import Console
from rich.progress import Progress, TaskID

from uav_recon.app.option_validation import UsageError, require_writable_file
from uav_recon.bench.planner import builtin_building, path_lengths, planner_tables, scaling, tours
from uav_recon.bench.planner.map_agreement import agreement
from uav_recon.bench.planner.recorded_stream import SIZE, STRIDE, RecordedStream, load
from uav_recon.bench.planner.replay import judged_views, mapped_of, timed_plans, timed_stages
from uav_recon.bench.planner.stages import MOUNTS_RAD, STAGES, warm_up
from uav_recon.measurement import host_info, result_file
from uav_recon.measurement.machine_speed import MachineSpeed, measure_machine_speed
from uav_recon.planning.tour import atsp
from uav_recon.types.maps import UNKNOWN

PRINTED_WIDTH = 110  # if the output is not a terminal
GOOD_VIEW = 0.95  # share of the cells seen by the best random view

Result = dict[str, Any]
T = TypeVar("T")


def bench_planner(stream: Path | None, size: str | None, stride: int | None, scale: bool, json_path: Path | None) -> int:
    """Measure, print tables, write JSON. Raises UserError with one line for bad input.

    size and stride apply only to a stream.
    """
    require_writable_file("--json", json_path)
    for option, value in (("--size", size), ("--stride", stride)):
        if stream is None and value is not None:
            raise UsageError(f"{option} needs --stream")
    recording = (
        builtin_building.fly_through() if stream is None else load(stream, size or SIZE, STRIDE if stride is None else stride)
    )
    began_s = time.perf_counter()
    warm_up(recording)
    compile_s = time.perf_counter() - began_s
    machine_speed = measure_machine_speed()
    result: Result = {
        "stream": recording.name,
        "image": f"{recording.lens.width}x{recording.lens.height}",
        "stride": recording.stride,
        "frames": len(recording.frames),
        "machine": host_info.processor(),
        "commit": host_info.commit(),
        "compile_s": compile_s,
        "calibration": machine_speed.slowdown,
        "calibration_cpu": machine_speed.cpu_slowdown,
    }
    progress = Progress(console=Console(stderr=True), transient=True, auto_refresh=False)
    with progress:
        result |= _growth(recording, progress) if scale else _replay(recording, machine_speed, progress)
    planner_tables.show(Console(width=None if sys.stdout.isatty() else PRINTED_WIDTH), result)
    if json_path is not None:
        result_file.save(json_path, result)
    return 0


def _replay(recording: RecordedStream, machine_speed: MachineSpeed, progress: Progress) -> Result:
    frames = recording.frames
    timed = timed_stages(recording, _tracked(progress, frames, "stages"))
    mapped = mapped_of(recording)
    mapped.start(frames[0])
    whole = timed_plans(mapped, mapped.planner(), _tracked(progress, frames, "plans"))
    ratios = {mount: judged_views(recording, _tracked(progress, frames, f"views, {mount}"), mount) for mount in MOUNTS_RAD}
    wall = {**{name: timed.wall.spread(*parts) for name, parts in STAGES.items()}, "plan": whole.wall.spread("plan")}
    cpu = {**{name: timed.cpu.spread(*parts) for name, parts in STAGES.items()}, "plan": whole.cpu.spread("plan")}
    result: Result = {
        "stages": {name: asdict(spread) for name, spread in wall.items()},
        "stages_calibrated": {name: asdict(spread.divided_by(machine_speed.slowdown)) for name, spread in wall.items()},
        "stages_cpu": {name: asdict(spread) for name, spread in cpu.items()},
        "stages_cpu_calibrated": {name: asdict(spread.divided_by(machine_speed.cpu_slowdown)) for name, spread in cpu.items()},
        "best_view_ratio": _ratio_summary(ratios["gimbal"]),
        "best_view_ratio_fixed": _ratio_summary(ratios["fixed"]),
    }
    return result | _map_quality(recording, mapped.config.clearance_m, progress) | _tour_quality(recording, progress)


def _ratio_summary(ratios: list[float]) -> Result:
    if not ratios:
        return {"median": None, "p05": None, "min": None, "share_of_95": None, "views": 0}
    low, middle = np.percentile(ratios, [5, 50])
    good = float(np.mean(np.array(ratios) >= GOOD_VIEW))
    return {"median": float(middle), "p05": float(low), "min": float(min(ratios)), "share_of_95": good, "views": len(ratios)}


def _map_quality(recording: RecordedStream, clearance_m: float, progress: Progress) -> Result:
    """Return the agreement of the map with the reference, and path lengths in the reference.

    The map is made from the frames only, without the declared take-off cylinder.
    """
    alone = mapped_of(recording)
    for posed in _tracked(progress, recording.frames, "map"):
        alone.voxels.integrate(posed)
    state = alone.voxels.snapshot().state
    reference = state if recording.reference is None else recording.reference
    agreed = agreement(state, reference)
    task = progress.add_task("paths", total=None)
    progress.refresh()
    lengths = path_lengths.compare(reference, recording.grid, alone.fence_m, clearance_m)
    progress.remove_task(task)
    known = recording.reference is not None
    return {
        "agreement": agreed.share if known else None,
        "occupied_freed": agreed.occupied_freed if known else None,
        "known_share": float(np.mean(state != UNKNOWN)),
        "path_length_m": None if lengths is None else lengths.mean_m,
        "path_lengths": None if lengths is None else asdict(lengths),
    }


def _tour_quality(recording: RecordedStream, progress: Progress) -> Result:
    folder = None if recording.folder is None else recording.folder / "atsp"
    cases = () if folder is None else tours.load_cases(folder)
    atsp.warm_up()
    scores = [tours.score(case) for case in _tracked(progress, cases, "tours")]
    return {"tour": {str(s.tasks): {"median_ms": s.median_ms, "gap": s.gap, "worst_gap": s.worst_gap} for s in scores}}


def _growth(recording: RecordedStream, progress: Progress) -> Result:
    task = progress.add_task("growth", total=sum(scaling.ticks(recording, copies) for copies in scaling.COPIES))
    sizes = [scaling.measure(recording, copies, _ticking(progress, task)) for copies in scaling.COPIES]
    base = sizes[0].stages
    return {
        "scale": [
            {
                "copies": size.copies,
                "area_m2": size.area_m2,
                "voxels": list(size.voxels),
                "memory_mb": size.memory_mb,
                "stages": {name: asdict(spread) for name, spread in size.stages.items()},
                "ratio": {
                    name: {
                        "median": spread.median_ms / base[name].median_ms,
                        "p95": spread.p95_ms / base[name].p95_ms,
                    }
                    for name, spread in size.stages.items()
                },
            }
            for size in sizes
        ]
    }


def _tracked(progress: Progress, items: Sequence[T], name: str) -> Iterator[T]:
    """Yield the items with a progress bar that is drawn between them.

    A thread that draws it would disturb the measured times.
    """
    task = progress.add_task(name, total=len(items))
    for item in items:
        yield item
        progress.advance(task)
        progress.refresh()


def _ticking(progress: Progress, task: TaskID) -> Callable[[int], None]:
    def tick(frames: int) -> None:
        progress.advance(task, frames)
        progress.refresh()

    return tick
