"""The processes of a flight in real time: start, supervision, landing and end."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from sitl.apps.progress_display import ProgressDisplay
from sitl.runtime.die_with_parent import die_with_parent_command
from uav_recon.app.flight_channels import read_only_channels
from uav_recon.errors import UserError
from uav_recon.types.vehicle import FlightPhase

READY_TIMEOUT_S = 240.0
LANDING_S = 300.0  # from the first Ctrl-C to the end of the mission, with model and report; as in its systemd unit
NICENESS = {"world": -5, "pilot": -10, "perception": -5, "mission": 0}
GRACE_S = {"mission": 90.0, "pilot": 20.0, "perception": 5.0, "world": 20.0}  # time to land and to save; in this order
EXIT_INTERRUPTED = 130
IDLE = "idle"  # the mission's phase until the vehicle and the mapper are ready
NOT_FLOWN = "interrupted before take-off; nothing was flown"
_ON_THE_GROUND = (FlightPhase.CONNECTING, FlightPhase.READY)


@dataclass
class _Child:
    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def end_reason(self) -> str:
        """Return the reason for its end: the signal, or the last line on stderr."""
        code = self.process.returncode
        if code is not None and code < 0:
            return f"killed by {signal.Signals(-code).name}"
        lines = [line for line in self.log.read_text(errors="replace").splitlines() if line.strip()]
        return lines[-1].strip() if lines else f"exit code {code} and no message"


class SimProcesses:
    """Simulator, pilot, perception and mission of one flight, by their command lines.

    A context manager: at its end all processes are ended. Each leads its own session, so that Ctrl-C reaches only this
    launcher, and each is killed when the launcher ends. Children of a process end with it.
    """

    def __init__(
        self, commands: dict[str, list[str]], logs: Path, runtime: Path, console: Console, begun_s: float | None = None
    ) -> None:
        """Create the launcher; it starts nothing.

        begun_s: when the program began, on the monotonic clock. The console shows how long it took to be ready.
        """
        self._commands = commands
        self._logs = logs
        self._runtime = runtime
        self._console = console
        self._channels = read_only_channels(runtime)
        self._begun_s = begun_s
        self._children: list[_Child] = []
        self._interrupts = 0
        self._given_up = False
        self._deadline_s = float("inf")  # deadline for the end of the mission after an interrupt

    def __enter__(self) -> SimProcesses:
        return self

    def __exit__(self, *_: object) -> None:
        self._end_all()

    def fly(self, while_starting: Callable[[], None] = lambda: None) -> str | None:
        """Start what does not run yet and fly; return the fault in one line, None without one.

        SIGINT or SIGTERM lands; a second one ends all processes at once. Before the take-off the first one ends them, and
        UserError is raised. while_starting(): called while the processes start; what it raises ends the flight before the
        take-off.
        """
        before = signal.signal(signal.SIGINT, self._interrupt), signal.signal(signal.SIGTERM, self._interrupt)
        try:
            for name in self._commands:
                if name not in {child.name for child in self._children}:
                    self.start(name)
            while_starting()
            fault = self._watch()
            self._land_remaining()
            return fault
        finally:
            self._end_all()
            signal.signal(signal.SIGINT, before[0])
            signal.signal(signal.SIGTERM, before[1])

    def start(self, name: str) -> None:
        """Start one process before the others."""
        log = self._logs / f"{name}.log"
        with log.open("wb") as out:
            process = subprocess.Popen(  # noqa: S603 - our own programs
                die_with_parent_command(self._commands[name]),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        with contextlib.suppress(PermissionError):  # priorities as in the systemd units, if permitted
            os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS[name])
        with contextlib.suppress(OSError):  # for kernels that schedule by session: sched(7), autogroup
            Path(f"/proc/{process.pid}/autogroup").write_text(str(NICENESS[name]), encoding="ascii")
        self._children.append(_Child(name, process, log))

    def _watch(self) -> str | None:
        deadline_s = time.monotonic() + READY_TIMEOUT_S
        with ProgressDisplay(self._console, self._channels) as screen:
            while True:
                mission = self._child("mission")
                if mission.process.poll() is not None:
                    return None if mission.process.returncode == 0 else f"mission died: {mission.end_reason()}"
                for child in self._children:
                    if child.process.poll() is not None:
                        return f"{child.name} died: {child.end_reason()}"
                if self._given_up:
                    raise UserError(NOT_FLOWN, EXIT_INTERRUPTED)
                if time.monotonic() > self._deadline_s:
                    return f"the mission did not end within {LANDING_S:.0f} s after the interrupt"
                shown = screen.show()
                self._say_ready()
                if not shown and time.monotonic() > deadline_s:
                    return f"the vehicle was not ready within {READY_TIMEOUT_S:.0f} s; see the logs in {self._logs}"
                time.sleep(0.2)

    def _say_ready(self) -> None:
        """Print once how long it took until the mission was ready to take off."""
        progress = self._channels.progress.latest()
        if self._begun_s is not None and progress is not None and progress.phase != IDLE:
            self._console.print(f"ready after {time.monotonic() - self._begun_s:.0f} s", highlight=False)
            self._begun_s = None

    def _grounded(self) -> bool:
        """Return True before the take-off: nothing to land, nothing to save."""
        vehicle = self._channels.vehicle.latest()
        return vehicle is None or vehicle.phase in _ON_THE_GROUND

    def _child(self, name: str) -> _Child:
        return next(child for child in self._children if child.name == name)

    def _interrupt(self, number: int, _: object) -> None:
        self._interrupts += 1
        if self._interrupts > 1:
            self._kill_all()
            shutil.rmtree(self._runtime, ignore_errors=True)
            os._exit(EXIT_INTERRUPTED)
        if self._grounded():
            self._given_up = True
            return
        self._deadline_s = time.monotonic() + LANDING_S
        for child in self._children:
            if child.name == "mission" and child.process.poll() is None:
                child.process.send_signal(signal.SIGTERM)
        self._console.print("[yellow]landing, then writing the report; press Ctrl-C again to end all processes at once[/]")

    def _land_remaining(self) -> None:
        """End the processes in order: the vehicle lands, the mission saves the model, then the rest."""
        for name, grace_s in GRACE_S.items():
            child = self._child(name)
            if child.process.poll() is None:
                child.process.terminate()
            try:
                child.process.wait(grace_s)
            except subprocess.TimeoutExpired:
                self._console.print(f"[red]{name} did not end within {grace_s:.0f} s and is killed[/]")

    def _end_all(self) -> None:
        self._kill_all()
        for child in self._children:
            child.process.wait()

    def _kill_all(self) -> None:
        for child in self._children:  # each leads a process group, which contains its children
            try:
                os.killpg(child.process.pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
