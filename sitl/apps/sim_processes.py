"""The processes of a flight in real time: start, supervision, landing and end."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from sitl.apps.launched_process import WORLD, LaunchedProcess
from sitl.apps.progress_display import ProgressDisplay
from sitl.runtime.die_with_parent import die_with_parent_command
from sitl.runtime.niceness import set_niceness
from uav_recon.app import process_table
from uav_recon.app.flight_channels import read_only_channels
from uav_recon.errors import UserError
from uav_recon.types.vehicle import FlightPhase

READY_TIMEOUT_S = 240.0
MISSION = process_table.MISSION.name
STOP_ORDER = (*(process.name for process in process_table.STOP_ORDER), WORLD)
EXIT_INTERRUPTED = 130
IDLE = "idle"  # the mission's phase until the vehicle and the mapper are ready
NOT_FLOWN = "interrupted before take-off; nothing was flown"
_ON_THE_GROUND = (FlightPhase.CONNECTING, FlightPhase.READY)


@dataclass
class _Child:
    launched: LaunchedProcess
    process: subprocess.Popen[bytes]
    log: Path
    deadline_s: float = math.inf  # for its end, once it was requested

    @property
    def name(self) -> str:
        return self.launched.name

    @property
    def runs(self) -> bool:
        return self.process.poll() is None

    @property
    def overdue(self) -> bool:
        return time.monotonic() > self.deadline_s

    def request_end(self) -> None:
        """Send SIGTERM, once. From then on the process has its stop timeout to end."""
        if self.runs and math.isinf(self.deadline_s):
            self.deadline_s = time.monotonic() + self.launched.stop_timeout_s
            self.process.terminate()

    def ends_in_time(self) -> bool:
        """Wait for the end until the deadline, and return True if the process has ended by then."""
        try:
            self.process.wait(max(self.deadline_s - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            return False
        return True

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
        self, launched: Sequence[LaunchedProcess], logs: Path, runtime: Path, console: Console, begun_s: float | None = None
    ) -> None:
        """Create the launcher; it starts nothing.

        launched: in the order of their start. begun_s: when the program began, on the monotonic clock. The console shows how
        long it took to be ready.
        """
        self._launched = {each.name: each for each in launched}
        self._logs = logs
        self._runtime = runtime
        self._console = console
        self._channels = read_only_channels(runtime)
        self._begun_s = begun_s
        self._children: list[_Child] = []
        self._interrupts = 0
        self._given_up = False

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
            for name in self._launched:
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
        log, launched = self._logs / f"{name}.log", self._launched[name]
        with log.open("wb") as out:
            process = subprocess.Popen(  # noqa: S603 - our own programs
                die_with_parent_command(launched.command),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        set_niceness(process.pid, launched.niceness)
        self._children.append(_Child(launched, process, log))

    def _watch(self) -> str | None:
        deadline_s = time.monotonic() + READY_TIMEOUT_S
        with ProgressDisplay(self._console, self._channels) as screen:
            while True:
                mission = self._child(MISSION)
                if not mission.runs:
                    return None if mission.process.returncode == 0 else f"mission died: {mission.end_reason()}"
                for child in self._children:
                    if not child.runs:
                        return f"{child.name} died: {child.end_reason()}"
                if self._given_up:
                    raise UserError(NOT_FLOWN, EXIT_INTERRUPTED)
                if mission.overdue:
                    return f"the mission did not end within {mission.launched.stop_timeout_s:.0f} s after the interrupt"
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
        for child in self._children:
            if child.name == MISSION:
                child.request_end()
        self._console.print("[yellow]landing, then writing the report; press Ctrl-C again to end all processes at once[/]")

    def _land_remaining(self) -> None:
        """End the processes in order: the vehicle lands, the mission saves the model, then the rest."""
        for name in STOP_ORDER:
            child = self._child(name)
            child.request_end()
            if not child.ends_in_time():
                self._console.print(f"[red]{name} did not end within {child.launched.stop_timeout_s:.0f} s and is killed[/]")

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
