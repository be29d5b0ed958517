"""`uav-recon sim`: run simulator and unmodified product, watch them, evaluate the flight."""

from __future__ import annotations

import dataclasses
import socket
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console

from sitl.apps.kernel_compilation import compile_and_load, flight_jobs
from sitl.apps.sim_options import SimOptions
from sitl.apps.sim_processes import SimProcesses
from sitl.scene.scene import Scene, SceneError, load_scene
from uav_recon import config as product_config
from uav_recon.app.option_validation import require_writable_file
from uav_recon.bench import result_file
from uav_recon.errors import EXIT_USAGE, UserError

__all__ = ["SimOptions", "simulate"]


def simulate(options: SimOptions, json: Path | None = None) -> int:
    """Run one flight and return the exit code.

    json: file for the report with its result header. Raises UserError with one line for anything that a user can correct.
    """
    require_writable_file("--json", json)
    console = Console(stderr=False)
    options.check_folder()
    if not options.lockstep:
        _claim_port(options.port)
    begun_s = time.monotonic()
    _need_open3d()
    scene = compile_and_load(flight_jobs((options.variant,), options.mapper == "neural"), console, lambda: _scene(options))
    options.make_folder()
    started_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="uav_recon-") as runtime:
        config = options.config(scene, Path(runtime))
        product_config.save(config, options.out / "config.toml")
        if options.lockstep:
            from sitl.apps.lockstep import fly_in_lockstep, interrupts

            with interrupts() as land:
                flown = fly_in_lockstep(options, config, scene, console, land)
            fault, times_real = flown.fault, flown.simulated_s / flown.wall_s
        else:
            times_real = None
            fault = SimProcesses(_commands(options, Path(runtime)), options.out / "logs", Path(runtime), console, begun_s).fly()
    from sitl.apps.flight_judge import evaluate_flight, summary

    report = evaluate_flight(options, scene, time.monotonic() - started_s, fault, console)
    console.print(summary(report, options.out), markup=False, highlight=False, soft_wrap=True)
    if json is not None:
        flight = {"completed": report.completed, "times_real": times_real, "report": dataclasses.asdict(report)}
        result_file.save(json, flight)
    if times_real is not None:
        console.print(f"lockstep flight at {times_real:.1f} times real time")
    if fault:
        raise UserError(fault)
    return 0 if report.completed else 1


def _scene(options: SimOptions) -> Scene:
    try:
        return load_scene(options.scene, options.start, options.fence, options.radius_m, fine=options.mapper == "neural")
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


def _commands(options: SimOptions, runtime: Path) -> dict[str, list[str]]:
    """Return the command lines of simulator and unmodified product, in the order of their start."""
    world, flight = runtime / "world.json", ["--flight", str(options.out)]
    options.world(runtime).save(world)
    product, config = [sys.executable, "-m", "uav_recon"], ["--config", str(options.out / "config.toml")]
    return {
        "world": [sys.executable, "-m", "sitl.apps.world_process", str(world)],
        "pilot": [*product, "pilot", *config, *flight],
        "perception": [*product, "perception", *config],
        "mission": [*product, "mission", *config, *flight],
    }
