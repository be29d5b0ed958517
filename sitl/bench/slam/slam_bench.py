"""`uav-recon bench slam`: trackers on rendered sequences with true poses."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from sitl.bench.slam import recording_bench, slam_tables, tracking_run
from sitl.bench.slam.frame_trackers import METHODS
from sitl.bench.slam.tracking_metrics import TrackingFigures, figures_of
from uav_recon.app.option_validation import UsageError, require_writable_file, require_writable_folder
from uav_recon.measurement import host_info, result_file
from uav_recon.measurement.machine_speed import measure_machine_speed

if TYPE_CHECKING:
    from sitl.apps.rgbd_sequences import RgbdSequence, SequenceOptions
    from sitl.apps.sequence_faults import FaultWindow
    from sitl.scene.scene import Scene

PRINTED_WIDTH = 110  # if the output is not a terminal
SEEDS = (1, 100)
PATHS = (1, 100)
LENGTH_M = (2.0, 200.0)
MOUNTS = ("fixed:15", "gimbal")
GYROS = ("none", "reference")
BUILT_IN = "built-in"  # as a --scene beside others

Result = dict[str, Any]


@dataclass(frozen=True)
class SlamBench:
    """The command-line options; see `uav-recon bench slam --help`."""

    scenes: tuple[str, ...]
    seeds: int
    paths: int
    length_m: float
    camera_errors: str | None
    mount: str
    fault: str | None
    methods: tuple[str, ...]
    cache: Path | None
    json: Path | None
    recordings: tuple[Path, ...] = ()
    intrinsics: str | None = None
    gyro: str = "none"
    depth_unit_m: float | None = None

    def check_recordings(self) -> None:
        """Raise UserError with one line for options that do not suit recordings."""
        require_writable_file("--json", self.json)
        for method in self.methods:
            _require_word("--method", method, tuple(METHODS))
        _require_word("--gyro", self.gyro, GYROS)
        if self.scenes:
            raise UsageError("--scene and --recording: want one of them")
        if self.fault not in (None, recording_bench.BLACK):
            raise UsageError(f"--fault {self.fault}: want {recording_bench.BLACK} with --recording")

    def sequences(self) -> list[SequenceOptions]:
        """Return the options of all sequences. Raises UserError with one line for bad input."""
        from sitl.apps.rgbd_sequences import SequenceOptions
        from sitl.apps.sequence_faults import FAULTS
        from sitl.apps.sim_options import camera_error_scale

        require_writable_file("--json", self.json)
        require_writable_folder("--cache", self.cache)
        if self.intrinsics is not None or self.gyro != GYROS[0] or self.depth_unit_m is not None:
            raise UsageError("--intrinsics, --gyro and --depth-unit: want --recording")
        _require_between("--seeds", self.seeds, SEEDS)
        _require_between("--paths", self.paths, PATHS)
        if not LENGTH_M[0] <= self.length_m <= LENGTH_M[1]:
            raise UsageError(f"--length {self.length_m:g}: want {LENGTH_M[0]:g} to {LENGTH_M[1]:g} m")
        _require_word("--mount", self.mount, MOUNTS)
        for method in self.methods:
            _require_word("--method", method, tuple(METHODS))
        if self.fault is not None:
            _require_word("--fault", self.fault, tuple(FAULTS))
        plain = SequenceOptions(
            camera_errors=camera_error_scale(self.camera_errors), gimbal=self.mount == "gimbal", length_m=self.length_m
        )
        if self.fault is not None:
            plain = FAULTS[self.fault].record(plain)
        return [
            dataclasses.replace(plain, scene=None if scene == BUILT_IN else scene, seed=seed, path=path)
            for scene in self.scenes or (BUILT_IN,)
            for path in range(self.paths)
            for seed in range(self.seeds)
        ]


def bench_slam(wanted: SlamBench) -> int:
    """Record, track, print tables, write JSON. Raises UserError with one line for bad input."""
    from sitl.apps.sweep_case import one_thread

    if wanted.recordings:
        wanted.check_recordings()
        one_thread()
        cv2.setNumThreads(1)
        return _bench_recordings(wanted)
    sequences = wanted.sequences()
    one_thread()  # before Open3D is loaded, which counts its threads then
    cv2.setNumThreads(1)
    console = Console(stderr=True)
    machine_speed = measure_machine_speed()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as progress:
        rows = _rows(wanted, sequences, progress)
    factor = math.sqrt(machine_speed.cpu_slowdown * measure_machine_speed().cpu_slowdown)
    result = {"summary": summary(rows), "sequences": rows, "about": _about(wanted, factor)}
    slam_tables.show(Console(width=None if sys.stdout.isatty() else PRINTED_WIDTH), result)
    if wanted.json is not None:
        result_file.save(wanted.json, result)
    return 0


def _bench_recordings(wanted: SlamBench) -> int:
    from uav_recon.app.recording_options import read_options
    from uav_recon.app.recording_remarks import print_remarks, skipped_remarks
    from uav_recon.sensors.recordings.bag_messages import BagTopics

    console = Console(stderr=True)
    machine_speed = measure_machine_speed()
    read = read_options(tracking_run.DEPTH_RANGE_M, wanted.intrinsics, BagTopics(), wanted.depth_unit_m)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    rows = []
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as progress:
        for folder in wanted.recordings:
            sequence = recording_bench.RecordedSequence.of(folder, read, gyro=wanted.gyro == GYROS[1])
            print_remarks(sequence.remarks(), console)
            for method in wanted.methods:
                with _bar(progress, f"{sequence.name}: {method}") as report:
                    run = recording_bench.track(METHODS[method](), sequence, black=wanted.fault is not None, report=report)
                row = {"recording": sequence.name, "method": method, "gyro": wanted.gyro, "fault": wanted.fault}
                rows.append(row | recording_bench.figures(run, sequence))
            print_remarks(skipped_remarks(sequence.recording.info), console)
    factor = math.sqrt(machine_speed.cpu_slowdown * measure_machine_speed().cpu_slowdown)
    about = {"calibration_cpu": factor, "machine": host_info.processor(), "commit": host_info.commit()}
    slam_tables.show_recordings(Console(width=None if sys.stdout.isatty() else PRINTED_WIDTH), rows, about)
    if wanted.json is not None:
        by_name = {method: {row["recording"]: row for row in rows if row["method"] == method} for method in _methods(rows)}
        result_file.save(wanted.json, {"summary": by_name, "recordings": rows, "about": about})
    return 0


def summary(rows: list[Result]) -> Result:
    """Return median and worst of each method's figures over its rows.

    Its reactions to all windows of a fault are added. ATE, drift and rotation are infinite in a row whose method gave too few
    poses.
    """
    return {method: _summary([row for row in rows if row["method"] == method]) for method in _methods(rows)}


def _rows(wanted: SlamBench, sequences: list[SequenceOptions], progress: Progress) -> list[Result]:
    rows: list[Result] = []
    scenes: dict[str | None, Scene] = {}
    for options in sequences:
        if options.scene not in scenes:
            scenes = {options.scene: _scene(options.scene)}  # one at a time: a scene takes much memory
        sequence, windows = _sequence(wanted, options, scenes[options.scene], progress)
        for method in wanted.methods:
            name = f"{sequence.name} path {options.path} seed {options.seed}: {method}"
            with _bar(progress, name) as report:
                figures = figures_of(tracking_run.run(METHODS[method](), sequence, report), sequence, windows)
            rows.append(_row(sequence.name, options, method, figures))
    return rows


@contextmanager
def _bar(progress: Progress, name: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar during the block; yields report(done, total), which draws it.

    A thread that draws it would disturb the measured times.
    """
    task = progress.add_task(name, total=None)
    progress.refresh()

    def report(done: int, total: int) -> None:
        progress.update(task, completed=done, total=total)
        progress.refresh()

    yield report
    progress.remove_task(task)


def _scene(path: str | None) -> Scene:
    from sitl.scene.scene import SceneError, load_scene

    try:
        return load_scene(path)
    except SceneError as error:
        raise UsageError(str(error)) from None


def _sequence(
    wanted: SlamBench, options: SequenceOptions, scene: Scene, progress: Progress
) -> tuple[RgbdSequence, list[FaultWindow]]:
    from sitl.apps.rgbd_sequences import recorded
    from sitl.apps.sequence_faults import altered
    from sitl.truth.random_route import NoRouteError

    with _bar(progress, f"{scene.name} path {options.path} seed {options.seed}: recording") as report:
        try:
            sequence = recorded(options, scene, wanted.cache, report)
        except (NoRouteError, ValueError) as error:
            raise UsageError(str(error)) from None
        except OSError as error:
            raise UsageError(f"--cache {wanted.cache}: cannot be written ({error.strerror})") from None
    return (sequence, []) if wanted.fault is None else altered(sequence, wanted.fault, options.seed)


def _row(name: str, options: SequenceOptions, method: str, figures: TrackingFigures) -> Result:
    error = figures.error
    return {
        "scene": name,
        "path": options.path,
        "seed": options.seed,
        "method": method,
        "length_m": None if error is None else error.length_m,
        "ate_cm": None if error is None else 100.0 * error.ate_m,
        "ate_max_cm": None if error is None else 100.0 * error.ate_max_m,
        "drift_percent": None if error is None else 100.0 * error.drift,
        "drift_median_percent": None if error is None else 100.0 * error.drift_median,
        "drift_p95_percent": None if error is None else 100.0 * error.drift_p95,
        "rotation_deg": None if error is None else math.degrees(error.rotation_rad),
        "rotation_drift_degpm": None if error is None else math.degrees(error.drift_radpm),
        "median_ms": figures.median_ms,
        "p95_ms": figures.p95_ms,
        "lost": figures.lost,
        "first_pose_s": figures.first_pose_s,
        "false_good": figures.false_good,
        "within_claimed": figures.within_claimed,
        "frames": figures.frames,
        "reactions": [asdict(reaction) for reaction in figures.reactions],
    }


_WORST_IS_LARGEST = ("ate_cm", "drift_percent", "rotation_deg", "median_ms", "p95_ms", "lost", "false_good")
REPORTED_S = 0.3
BACK_S = 2.0


def _summary(rows: list[Result]) -> Result:
    out: Result = {"sequences": len(rows)}
    for name in _WORST_IS_LARGEST:
        values = np.array([math.inf if row[name] is None else row[name] for row in rows], np.float64)
        out[name] = {"median": float(np.median(values)), "worst": float(values.max())}
    shares = [0.0 if row["within_claimed"] is None else row["within_claimed"] for row in rows]
    out["within_claimed"] = {"mean": float(np.mean(shares)), "worst": min(shares)}
    reactions = [reaction for row in rows for reaction in row["reactions"]]
    return out | ({"reactions": reaction_summary(reactions)} if reactions else {})


def reaction_summary(reactions: list[Result]) -> Result:
    """Return the shares of windows that are reported within REPORTED_S and back within BACK_S.

    With the medians of both times and the longest false good.
    """
    reported, back = (
        np.array([math.inf if reaction[name] is None else reaction[name] for reaction in reactions], np.float64)
        for name in ("reported_s", "back_s")
    )
    return {
        "windows": len(reactions),
        "reported_in_time": float((reported <= REPORTED_S).mean()),
        "reported_s": float(np.median(reported)),
        "back_in_time": float((back <= BACK_S).mean()),
        "back_s": float(np.median(back)),
        "false_good_s": max(float(reaction["false_good_s"]) for reaction in reactions),
    }


def _about(wanted: SlamBench, factor: float) -> Result:
    from sitl.apps.sim_options import camera_error_scale

    return {
        "scenes": list(wanted.scenes or (BUILT_IN,)),
        "seeds": wanted.seeds,
        "paths": wanted.paths,
        "length_m": wanted.length_m,
        "camera_errors": camera_error_scale(wanted.camera_errors),
        "mount": wanted.mount,
        "fault": wanted.fault,
        "calibration_cpu": factor,
        "machine": host_info.processor(),
        "commit": host_info.commit(),
    }


def _methods(rows: list[Result]) -> list[str]:
    return list(dict.fromkeys(str(row["method"]) for row in rows))


def _require_between(option: str, value: int, limits: tuple[int, int]) -> None:
    if not limits[0] <= value <= limits[1]:
        raise UsageError(f"{option} {value}: want {limits[0]} to {limits[1]}")


def _require_word(option: str, word: str, words: tuple[str, ...]) -> None:
    if word not in words:
        raise UsageError(f"{option} {word}: want one of {', '.join(words)}")
