"""`uav-recon sim`: starts the outside world and the unmodified product, watches them, judges the flight."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from sitl.fly_options import SimOptions
from sitl.fly_progress import Screen
from sitl.scene import Scene, SceneError, load_scene
from uav_recon import config as product_config
from uav_recon import run

__all__ = ["SimOptions", "simulate"]

READY_TIMEOUT_S = 240.0
NICENESS = {"world": -5, "pilot": -10, "perception": -5, "mission": 0}
GRACE_S = {"mission": 90.0, "pilot": 20.0, "perception": 5.0, "world": 20.0}  # to land, to save; in this order


def simulate(options: SimOptions) -> int:
    """Fly as asked; returns the exit code. Raises run.Failure with one line for anything a user can mend."""
    console = Console(stderr=False)
    _need_open3d()
    scene = _scene(options)
    options.make_folder()
    started_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="uav_recon-") as runtime:
        config = options.config(scene, Path(runtime))
        product_config.save(config, options.out / "config.toml")
        if options.lockstep:
            from sitl.fly_lockstep import fly_in_lockstep, interrupts

            with interrupts() as land:
                flown = fly_in_lockstep(options, config, scene, console, land)
            fault, times_real = flown.fault, flown.simulated_s / flown.wall_s
        else:
            _claim_port(options.port)
            times_real = None
            fault = _RealTime(options, config, Path(runtime), console).fly()
    from sitl.fly_report import judge, summary

    report = judge(options, scene, time.monotonic() - started_s, fault, console)
    console.print(summary(report, options.out))
    if times_real is not None:
        console.print(f"flown in lockstep at {times_real:.1f} times real time")
    if fault:
        raise run.Failure(fault)
    return 0 if report.completed else 1


def _scene(options: SimOptions) -> Scene:
    try:
        return load_scene(options.scene, options.start, options.fence, options.radius_m, fine=options.mapper == "neural")
    except SceneError as error:
        raise run.Failure(str(error), run.EXIT_USAGE) from None


def _need_open3d() -> None:
    """Truth is measured with Open3D: say so before the flight, not after it."""
    try:
        import open3d  # noqa: F401
    except (ImportError, OSError) as error:
        raise run.Failure(f"Open3D cannot be loaded: {error} (see README.md for the packages it needs)") from None


def _claim_port(port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise run.Failure(f"--port {port}: {error.strerror.lower() if error.strerror else error}") from None


@dataclass
class _Child:
    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def last_words(self) -> str:
        """Why it ended: the signal, or the last line it left on stderr."""
        code = self.process.returncode
        if code is not None and code < 0:
            return f"killed by {signal.Signals(-code).name}"
        lines = [line for line in self.log.read_text(errors="replace").splitlines() if line.strip()]
        return lines[-1].strip() if lines else f"exit code {code} and no message"


class _RealTime:
    """The children of one flight. Each leads a session of its own, so Ctrl-C reaches only this launcher."""

    def __init__(self, options: SimOptions, config: product_config.Config, runtime: Path, console: Console) -> None:
        self._options, self._config, self._runtime, self._console = options, config, runtime, console
        self._children: list[_Child] = []
        self._interrupts = 0

    def fly(self) -> str | None:
        """Fly; returns the fault in one line, None for none."""
        before = signal.signal(signal.SIGINT, self._interrupt), signal.signal(signal.SIGTERM, self._interrupt)
        try:
            self._start()
            fault = self._watch()
            self._land_remaining()
            return fault
        finally:
            self._end_all()
            signal.signal(signal.SIGINT, before[0])
            signal.signal(signal.SIGTERM, before[1])

    def _start(self) -> None:
        options, flight = self._options, str(self._options.out)
        world_file = self._runtime / "world.json"
        options.world(self._runtime).save(world_file)
        product = [sys.executable, "-m", "uav_recon.cli"]
        config = ["--config", str(options.out / "config.toml")]
        self._spawn("world", [sys.executable, "-m", "sitl.fly_world", str(world_file)])
        self._spawn("pilot", [*product, "pilot", *config, "--flight", flight])
        self._spawn("perception", [*product, "perception", *config])
        self._spawn("mission", [*product, "mission", *config, "--flight", flight])

    def _spawn(self, name: str, command: list[str]) -> None:
        log = self._options.out / "logs" / f"{name}.log"
        with log.open("wb") as out:
            process = subprocess.Popen(  # noqa: S603 - our own programs
                command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT, start_new_session=True
            )
        with contextlib.suppress(PermissionError):  # as the services have it, and as a flight controller is: if we may
            os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS[name])
        with contextlib.suppress(OSError):  # where the kernel weighs whole sessions and not processes: sched(7), autogroup
            Path(f"/proc/{process.pid}/autogroup").write_text(str(NICENESS[name]), encoding="ascii")
        self._children.append(_Child(name, process, log))

    def _watch(self) -> str | None:
        wires = run.file_wires(self._runtime)
        deadline_s = time.monotonic() + READY_TIMEOUT_S
        with Screen(self._console, wires) as screen:
            while True:
                mission = self._child("mission")
                if mission.process.poll() is not None:
                    return None if mission.process.returncode == 0 else f"mission died: {mission.last_words()}"
                for child in self._children:
                    if child.process.poll() is not None:
                        return f"{child.name} died: {child.last_words()}"
                if not screen.show() and time.monotonic() > deadline_s:
                    return f"not ready after {READY_TIMEOUT_S:.0f} s; see {self._options.out / 'logs'}"
                time.sleep(0.2)

    def _child(self, name: str) -> _Child:
        return next(child for child in self._children if child.name == name)

    def _interrupt(self, number: int, _: object) -> None:
        self._interrupts += 1
        if self._interrupts > 1:
            self._kill_all()
            shutil.rmtree(self._runtime, ignore_errors=True)
            os._exit(130)
        for child in self._children:
            if child.name == "mission" and child.process.poll() is None:
                child.process.send_signal(signal.SIGTERM)
        self._console.print("[yellow]landing; press Ctrl-C again to end everything at once[/]")

    def _land_remaining(self) -> None:
        """Whatever ended the watch, the vehicle comes down, the mission saves its model and the world its truth."""
        for name, grace_s in GRACE_S.items():
            child = self._child(name)
            if child.process.poll() is None:
                child.process.terminate()
            try:
                child.process.wait(grace_s)
            except subprocess.TimeoutExpired:
                self._console.print(f"[red]{name} did not end within {grace_s:.0f} s[/]")

    def _end_all(self) -> None:
        self._kill_all()
        for child in self._children:
            child.process.wait()

    def _kill_all(self) -> None:
        for child in self._children:  # a child leads its session: its own children go with it
            try:
                os.killpg(child.process.pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
