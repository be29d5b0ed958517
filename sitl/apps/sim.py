"""`uav-recon sim`: starts the outside world and the unmodified product, watches them, judges the flight."""

from __future__ import annotations

import socket
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console

from sitl.apps.kernel_compilation import compile_ahead, flight_jobs
from sitl.apps.sim_options import SimOptions
from sitl.apps.sim_processes import SimProcesses
from sitl.scene.scene import GENERATED, Scene, SceneError, load_scene
from uav_recon import config as product_config
from uav_recon.errors import EXIT_USAGE, UserError

__all__ = ["SimOptions", "simulate"]


def simulate(options: SimOptions) -> int:
    """Fly as asked; returns the exit code. Raises Failure with one line for anything a user can mend."""
    console = Console(stderr=False)
    begun_s = time.monotonic()
    _need_open3d()
    if options.scene is None or options.scene.startswith(GENERATED) or Path(options.scene).exists():  # else refused below
        compile_ahead(flight_jobs((options.variant,), options.mapper == "neural"), console)
    scene = _scene(options)
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
            _claim_port(options.port)
            times_real = None
            fault = SimProcesses(_commands(options, Path(runtime)), options.out / "logs", Path(runtime), console, begun_s).fly()
    from sitl.apps.flight_judge import judge, summary

    report = judge(options, scene, time.monotonic() - started_s, fault, console)
    console.print(summary(report, options.out))
    if times_real is not None:
        console.print(f"flown in lockstep at {times_real:.1f} times real time")
    if fault:
        raise UserError(fault)
    return 0 if report.completed else 1


def _scene(options: SimOptions) -> Scene:
    try:
        return load_scene(options.scene, options.start, options.fence, options.radius_m, fine=options.mapper == "neural")
    except SceneError as error:
        raise UserError(str(error), EXIT_USAGE) from None


def _need_open3d() -> None:
    """Truth is measured with Open3D: say so before the flight, not after it."""
    try:
        import open3d  # noqa: F401
    except (ImportError, OSError) as error:
        raise UserError(f"Open3D cannot be loaded: {error} (see README.md for the packages it needs)") from None


def _claim_port(port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise UserError(f"--port {port}: {error.strerror.lower() if error.strerror else error}") from None


def _commands(options: SimOptions, runtime: Path) -> dict[str, list[str]]:
    """The outside world and the unmodified product, in the order in which they start."""
    world, flight = runtime / "world.json", ["--flight", str(options.out)]
    options.world(runtime).save(world)
    product, config = [sys.executable, "-m", "uav_recon"], ["--config", str(options.out / "config.toml")]
    return {
        "world": [sys.executable, "-m", "sitl.apps.world_process", str(world)],
        "pilot": [*product, "pilot", *config, *flight],
        "perception": [*product, "perception", *config],
        "mission": [*product, "mission", *config, *flight],
    }
