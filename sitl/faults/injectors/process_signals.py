"""Faults of real processes: stopped, killed, terminated, started twice.

They need a real-time flight.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from typing import cast

from sitl.faults.injectors.base import Capabilities, InjectionContext, Injector
from sitl.faults.process_registry import ProcessRegistry, child_of, send

# words in their command lines
MAPPER = "mapping.neural.worker.mapper_process"
RECORDER = "uav_recon\0record"


class ProcessStopped(Injector):
    """A process gets SIGSTOP, and SIGCONT after for_s."""

    needs = Capabilities.PROCESSES

    def __init__(self, name: str, for_s: float) -> None:
        self._name = name
        self._for_s = for_s
        self._stopped = False

    def begin(self, at: InjectionContext) -> None:
        """Stop the process."""
        processes_of(at).send(self._name, signal.SIGSTOP)
        self._stopped = True

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Continue the process, once."""
        if self._stopped and since_s >= self._for_s:
            self.end(at)

    def end(self, at: InjectionContext) -> None:
        """Continue the process, if it is still stopped."""
        if self._stopped:
            processes_of(at).send(self._name, signal.SIGCONT)
            self._stopped = False


class ProcessKilled(Injector):
    """Processes get SIGKILL, and are not restarted before for_s."""

    needs = Capabilities.PROCESSES

    def __init__(self, *names: str, for_s: float = 1e9) -> None:
        self._names = names
        self._for_s = for_s
        self._down = False

    def begin(self, at: InjectionContext) -> None:
        """Kill all of them at once."""
        processes_of(at).block_restart(self._names)
        self._down = True
        for name in self._names:
            processes_of(at).send(name, signal.SIGKILL)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Allow the supervisor to restart them after for_s."""
        if self._down and since_s >= self._for_s:
            processes_of(at).block_restart(())
            self._down = False


class ProcessTerminated(Injector):
    """A process gets SIGTERM, as from its supervisor.

    It notes the "exit code", and as "ended armed" whether the vehicle was armed then.
    """

    needs = Capabilities.PROCESSES

    def __init__(self, name: str) -> None:
        self._name = name

    def begin(self, at: InjectionContext) -> None:
        """Send SIGTERM and prevent a restart."""
        processes_of(at).block_restart((self._name,))
        processes_of(at).send(self._name, signal.SIGTERM)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Note the exit code, once the process has ended."""
        for ended in processes_of(at).exits():
            if ended.name == self._name and "exit code" not in at.notes:
                at.notes["exit code"] = float(ended.code)
                at.notes["ended armed"] = float(at.world.flyer.truth().armed)


class SecondPilot(Injector):
    """A second pilot process, started by hand.

    It notes "second's exit code" and, as "second lived", its lifetime in seconds.
    """

    needs = Capabilities.PROCESSES

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._began_s = 0.0

    def begin(self, at: InjectionContext) -> None:
        """Start it with the flight's own config."""
        command = [sys.executable, "-m", "uav_recon", "pilot", "--config", str(at.config)]
        self._began_s = time.monotonic()
        self._process = subprocess.Popen(command, stderr=subprocess.DEVNULL)  # noqa: S603 - our own program

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Note its exit code and lifetime, once it has ended."""
        if self._process is not None and "second's exit code" not in at.notes and self._process.poll() is not None:
            at.notes["second's exit code"] = float(self._process.returncode)
            at.notes["second lived"] = time.monotonic() - self._began_s


class ChildProcessSignalled(Injector):
    """A child of the mission gets a signal.

    It notes as "replaced" when another child has taken its role.
    """

    needs = Capabilities.PROCESSES

    def __init__(self, word: str, number: signal.Signals) -> None:
        """Set up the fault without sending the signal.

        word: word in the child's command line.
        """
        self._word = word
        self._number = number
        self._pid = cast("int | None", None)

    def begin(self, at: InjectionContext) -> None:
        """Send the signal."""
        self._pid = child_of(processes_of(at).pid("mission"), self._word)
        send(self._pid, self._number)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Look for a replacement ten times a second."""
        if self._pid is None or "replaced" in at.notes or int(since_s * 60.0) % 6:
            return
        other = child_of(processes_of(at).pid("mission"), self._word)
        if other not in (None, self._pid):
            at.notes["replaced"] = since_s

    def end(self, at: InjectionContext) -> None:
        """Continue a stopped child, so that it notices the end of its mission."""
        send(self._pid, signal.SIGCONT)


def processes_of(at: InjectionContext) -> ProcessRegistry:
    """Return the processes of the flight. Only a real-time flight has them."""
    assert at.registry is not None
    return at.registry
