"""`uav-recon sim`: run simulator and unmodified product, watch them, evaluate the flight."""

from __future__ import annotations

import shutil
import socket
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from sitl.apps.flight_config import fitted_mount, flight_config, world_options
from sitl.apps.flight_folder import (
    check_folder,
    check_kept_file,
    check_program,
    dated_folder,
    make_folder,
    make_own_folder,
)
from sitl.apps.kernel_compilation import compile_and_load, flight_jobs
from sitl.apps.launched_process import WORLD, LaunchedProcess, flight_processes
from sitl.apps.sim_options import AUTO, SimOptions
from sitl.apps.sim_processes import SimProcesses
from sitl.scene.scene import Scene, SceneError, load_scene, require_scene
from uav_recon import config as product_config
from uav_recon.app.kernel_cache import KernelJob, are_compiled
from uav_recon.app.option_validation import require_writable_file
from uav_recon.config import Config
from uav_recon.errors import EXIT_USAGE, UserError
from uav_recon.measurement import result_file

WORLD_OPTIONS = "world.json"  # in the runtime folder


@dataclass(frozen=True)
class FlownFlight:
    """A flight before its evaluation.

    fault: in one line, None without one. wall_s: its duration. times_real: speed of a lockstep flight, None in real time.
    view_budget: maximum number of keyframes for the mapper.
    """

    scene: Scene
    fault: str | None
    wall_s: float
    times_real: float | None
    view_budget: int


def simulate(options: SimOptions) -> int:
    """Run one flight and return the exit code.

    Raises UserError with one line for anything that a user can correct.
    """
    console = Console(stderr=False)
    dated = options.out is None
    if dated:
        options = replace(options, out=dated_folder(options.scene))
    _check_files(options)
    options = _with_mount(options, console)
    if dated:
        options = replace(options, out=make_own_folder(options.folder))
    if same := _same_variant(options):
        console.print(same, markup=False, highlight=False)
    try:
        with tempfile.TemporaryDirectory(prefix="uav_recon-") as runtime:
            flight = (_fly_in_lockstep if options.lockstep else _fly_in_real_time)(options, Path(runtime), console)
    finally:
        if dated:
            with suppress(OSError):  # only an empty one: the flight did not begin
                options.folder.rmdir()
    return _conclude(options, flight, console)


def _check_files(options: SimOptions) -> None:
    """Check files, folder, scene and port before anything is loaded. Raises UserError."""
    from uav_recon.localization.calibration.kept_calibration import is_calibration
    from uav_recon.localization.slam.kept_map import is_map

    check_kept_file("--calibration", options.calibration, is_calibration, "a calibration file")
    check_kept_file("--flown-map", options.flown_map, is_map, "the map of a flight")
    check_program(options.firmware)
    require_writable_file("--json", options.json)
    check_folder(options.folder)
    try:
        require_scene(options.scene)
    except SceneError as error:
        raise UserError(str(error), EXIT_USAGE) from None
    if not options.lockstep:
        _claim_port(options.port)


def _conclude(options: SimOptions, flight: FlownFlight, console: Console) -> int:
    """Evaluate the flight, print and write the result, and return the exit code.

    Raises UserError for the fault of the flight.
    """
    from sitl.apps.flight_judge import evaluate_flight, summary

    report = evaluate_flight(options, flight.scene, flight.wall_s, flight.fault, console)
    console.print(summary(report, options.folder), markup=False, highlight=False, soft_wrap=True)
    if options.json is not None:
        result = {
            "completed": report.completed,
            "times_real": flight.times_real,
            "view_budget": flight.view_budget,
            "report": report,
        }
        result_file.save(options.json, result)
    if flight.times_real is not None:
        console.print(f"lockstep flight at {flight.times_real:.1f} times real time")
    if flight.fault:
        raise UserError(flight.fault)
    return 0 if report.completed else 1


def _with_mount(options: SimOptions, console: Console) -> SimOptions:
    """Return the options with a mount; if none was given, print which fits the room."""
    if options.mount != AUTO:
        return options
    scene = compile_and_load(_jobs(options), console, lambda: _scene(options, textured=False))  # its size needs no texture
    fitted = replace(options, mount=fitted_mount(options, scene))
    size = " x ".join(f"{length:.1f}" for length in scene.fence_max - scene.fence_min)
    console.print(f"mount {fitted.mount}, for a fence of {size} m", markup=False, highlight=False)
    return fitted


def _same_variant(options: SimOptions) -> str:
    """Return a line if the variant equals another one with this mount, else ''."""
    equal = options.variant == "explore-yaw" and options.mount != "gimbal"
    return "variant explore-yaw equals explore: a fixed mount has no pitch to choose" if equal else ""


def _fly_in_lockstep(options: SimOptions, runtime: Path, console: Console) -> FlownFlight:
    from sitl.apps.lockstep import fly_in_lockstep, interrupts

    _need_open3d()
    scene = compile_and_load(_jobs(options), console, lambda: _scene(options, options.textured))
    make_folder(options.folder)
    started_s, config = time.monotonic(), _save_config(options, scene, runtime)
    with interrupts() as land:
        flown = fly_in_lockstep(options, config, scene, console, land)
    return FlownFlight(scene, flown.fault, time.monotonic() - started_s, flown.simulated_s / flown.wall_s, config.mission.views)


def _fly_in_real_time(options: SimOptions, runtime: Path, console: Console) -> FlownFlight:
    """Fly with all processes.

    If no kernel must be compiled, the simulator loads the scene while this process does.
    """
    begun_s, jobs, logs = time.monotonic(), _jobs(options), options.folder / "logs"
    world_options(options, runtime).save(runtime / WORLD_OPTIONS)
    with SimProcesses(_launched(options, runtime), logs, runtime, console, begun_s) as processes:
        if are_compiled(jobs):
            make_folder(options.folder)
            processes.start(WORLD)
        try:
            scene = compile_and_load(jobs, console, lambda: _scene(options, options.textured))
        except (UserError, KeyboardInterrupt):
            _remove(logs)
            raise
        make_folder(options.folder)
        started_s, config = time.monotonic(), _save_config(options, scene, runtime)
        fault = processes.fly(_need_open3d)
    return FlownFlight(scene, fault, time.monotonic() - started_s, None, config.mission.views)


def _jobs(options: SimOptions) -> list[KernelJob]:
    return flight_jobs((options.variant,), options.mapper == "neural")


def _save_config(options: SimOptions, scene: Scene, runtime: Path) -> Config:
    config = flight_config(options, scene, runtime)
    product_config.save(config, options.folder / "config.toml")
    return config


def _remove(logs: Path) -> None:
    """Remove the folder of a flight that did not start, if it holds nothing but logs."""
    shutil.rmtree(logs, ignore_errors=True)
    with suppress(OSError):
        logs.parent.rmdir()


def _scene(options: SimOptions, textured: bool) -> Scene:
    try:
        return load_scene(options.scene, options.start_pose, options.fence_corners, options.radius_m, fine=textured)
    except SceneError as error:
        raise UserError(str(error), EXIT_USAGE) from None


def _need_open3d() -> None:
    """Check that Open3D loads: the evaluation after the flight needs it. Raises UserError."""
    try:
        import open3d  # noqa: F401
    except (ImportError, OSError) as error:
        raise UserError(f"Open3D cannot be loaded: {error} (see README.md for the packages it needs)") from None


def _claim_port(port: int) -> None:
    """Check that the port is free. Raises UserError."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            reason = error.strerror.lower() if error.strerror else error
            raise UserError(f"--port {port}: {reason}; is another simulation running? --port takes 1024 to 65535") from None


def _launched(options: SimOptions, runtime: Path) -> list[LaunchedProcess]:
    world = ["sitl.apps.world_process", str(runtime / WORLD_OPTIONS)]
    return flight_processes(world, options.folder / "config.toml", options.folder)
