"""`uav-recon bench tasks`: time to find views of the learned surface of a recorded flight.

The map is the flight's last one. The surface is the mapper's at each recorded state, and the vehicle is at the pose of the
keyframe before that state. The uncertainty of the elements is not recorded. Random values replace it, so that surface
everywhere is uncertain and every plan searches for the maximum number of tasks.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from uav_recon.app import config_file, mission_factory
from uav_recon.app.option_validation import UsageError, readable, require_writable_file
from uav_recon.errors import UserError
from uav_recon.mapping.keyframe_store import KeyframeError, KeyframeFolder
from uav_recon.measurement import host_info, result_file
from uav_recon.measurement.machine_speed import measure_machine_speed
from uav_recon.measurement.printed_table import narrow_table
from uav_recon.measurement.stage_timing import Stopwatch, TimingSummary
from uav_recon.planning.candidate_view import PlanningContext
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.frontier.frontiers import fence_box
from uav_recon.planning.presets import derived
from uav_recon.planning.reconstruction.surface_views import SurfaceViews
from uav_recon.recording.map_file import load_map
from uav_recon.recording.timelapse import load_states
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import SurfaceElements

PRINTED_WIDTH = 100  # if the output is not a terminal
SEED = 20240321
PHASES = ("merged", "end phase")  # within R_loc, and within alpha times R_loc

Result = dict[str, Any]


def bench_tasks(flight: Path, json_path: Path | None) -> int:
    """Measure, print a table, write JSON.

    Raises UserError with one line for a folder that is not a complete flight.
    """
    require_writable_file("--json", json_path)
    with readable(str(flight)):
        folder, flown = flight.is_dir(), (flight / "config.toml").is_file()
    if not folder:
        raise UsageError(f"{flight}: no such flight folder")
    if not flown:
        raise UsageError(f"{flight}: has no config.toml: not a flight")
    times, tasks, elements = _measure(flight)
    machine_speed = measure_machine_speed()
    result: Result = {
        "flight": flight.name,
        "elements": elements,
        "machine": host_info.processor(),
        "commit": host_info.commit(),
        "calibration_cpu": machine_speed.cpu_slowdown,
        "phases": {
            phase: {
                "plans": len(times[phase]),
                "tasks": float(np.mean(tasks[phase])),
                "cpu_ms": asdict(TimingSummary.of(times[phase])),
                "cpu_ms_calibrated": asdict(TimingSummary.of(times[phase]).divided_by(machine_speed.cpu_slowdown)),
            }
            for phase in PHASES
        },
    }
    _show(Console(width=None if sys.stdout.isatty() else PRINTED_WIDTH), result)
    if json_path is not None:
        result_file.save(json_path, result)
    return 0


def _measure(flight: Path) -> tuple[dict[str, list[float]], dict[str, list[int]], int]:
    """Return milliseconds and number of tasks of each plan by phase, and the last element count."""
    config, voxels = config_file.load_config(flight / "config.toml"), load_map(flight)
    if voxels is None:
        raise UsageError(f"{flight}: has no voxels.npz: not a flight that ended")
    low, high = np.array(config.safety.fence_min_m), np.array(config.safety.fence_max_m)
    camera = mission_factory.camera_geometry(config)
    planner = derived(config.planner, low, high, camera)
    space = FlyableSpace(voxels.grid, planner.clearance_m, *fence_box(voxels.grid, low, high))
    space.update(voxels)
    views, cosine_sums = SurfaceViews(planner, camera), np.zeros(voxels.grid.shape, dtype=np.float32)
    moments = list(_moments(flight))
    times: dict[str, list[float]] = {phase: [] for phase in PHASES}
    tasks: dict[str, list[int]] = {phase: [] for phase in PHASES}
    console = Console(stderr=True)
    for lap in range(2):  # the first lap compiles and is discarded
        for n, (surface, position) in enumerate(track(moments, "plans", console=console, transient=True)):
            exit_cells = space.locate_vehicle(position)
            if exit_cells is None:
                continue
            context = PlanningContext(voxels, space, exit_cells, position)
            for phase, factor in zip(PHASES, (1.0, planner.end_factor), strict=True):
                fresh = SurfaceElements(*surface, revision=(lap * len(moments) + n) * len(PHASES) + PHASES.index(phase))
                watch = Stopwatch()
                found = views.propose(context, fresh, cosine_sums, factor)
                watch.lap(phase)
                if lap:
                    times[phase].append(watch.cpu_ms[phase])
                    tasks[phase].append(len(found))
    if not times[PHASES[0]]:
        raise UserError(f"{flight}: no keyframe stands where this vehicle may fly")
    return times, tasks, len(moments[-1][0][0])


def _moments(flight: Path) -> Iterator[tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray]]:
    """Yield positions, normals and uncertainty of each surface state, and the vehicle position."""
    try:
        keyframes = KeyframeFolder(flight / "keyframes")
    except KeyframeError as error:
        raise UsageError(str(error)) from None
    states, random = load_states(flight), np.random.default_rng(SEED)
    if not states or not len(keyframes):
        raise UsageError(f"{flight}: has no states of the surface, or no keyframes: not a flight with a mapper")
    stamps = np.array([keyframes.stamp_s(n) for n in range(len(keyframes))])
    for state in states:
        last = keyframes.load(max(int(np.searchsorted(stamps, state.stamp_s)) - 1, 0))
        surface = (state.position_world, state.normal_world, random.random(len(state.position_world)))
        yield surface, last.world_from_depth.translation_m


def _show(console: Console, result: Result) -> None:
    console.print(
        f"{result['flight']}: surface of {result['elements']} elements in the end; commit {result['commit']}, "
        f"{result['machine']}, its processor {result['calibration_cpu']:.2f} times as slow as the reference machine.",
        highlight=False,
    )
    title = "tasks of surface: milliseconds of the processor, and calibrated"
    table = narrow_table(title, "phase", "plans", "tasks", "median", "p95", "max", "cal.", "p95", "max")
    for phase, phase_result in result["phases"].items():
        spreads = [
            phase_result[name][key] for name in ("cpu_ms", "cpu_ms_calibrated") for key in ("median_ms", "p95_ms", "max_ms")
        ]
        table.add_row(phase, str(phase_result["plans"]), f"{phase_result['tasks']:.1f}", *(f"{value:.1f}" for value in spreads))
    console.print(table)
