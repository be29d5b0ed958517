"""Troubles of a computer that has too much to do, and what they cost the pilot's process. They need a flight in real time."""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
import sys
from pathlib import Path

from sitl.faults.injectors.base import Capabilities, InjectionContext, Injector
from sitl.faults.injectors.process_signals import MAPPER, RECORDER, roster_of
from sitl.faults.process_registry import child_of
from sitl.runtime.die_with_parent import die_with_parent_command

BUSY = "while True: pass"
THRASHING = """
import os, sys
with open(sys.argv[1], "wb", buffering=0) as file:
    while True:
        file.seek(0)
        file.write(bytes(1 << 24))
        os.fsync(file.fileno())
"""
_MEGABYTE = 1e6


class BusyProcesses(Injector):
    """Programs that do nothing but work, at the priority that everybody has, for a while."""

    needs = Capabilities.PROCESSES

    def __init__(self, program: str, count: int, for_s: float) -> None:
        """program: Python, which is given the name of a file in the flight's folder."""
        self._program, self._count, self._for_s = program, count, for_s
        self._toiling: list[subprocess.Popen[bytes]] = []

    def begin(self, at: InjectionContext) -> None:
        """Start them."""
        assert at.config is not None
        for k in range(self._count):
            command = [sys.executable, "-c", self._program, str(at.config.with_name(f"toil-{k}"))]
            process = subprocess.Popen(die_with_parent_command(command))  # noqa: S603 - our own programs
            self._toiling.append(process)
            with contextlib.suppress(PermissionError):  # the world, which starts them, may have a better one
                os.setpriority(os.PRIO_PROCESS, process.pid, 0)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Until the time is over."""
        if self._toiling and since_s >= self._for_s:
            self.end(at)

    def end(self, at: InjectionContext) -> None:
        """None is left, nor its file."""
        for process in self._toiling:
            process.kill()
            process.wait()
        self._toiling.clear()
        assert at.config is not None
        for k in range(self._count):
            at.config.with_name(f"toil-{k}").unlink(missing_ok=True)


class MemoryPressure(Injector):
    """What a process takes is noted: its "memory" in MB at most, and how many "writes" its main thread makes in all."""

    needs = Capabilities.PROCESSES

    def __init__(self, name: str) -> None:
        self._name, self._before = name, 0

    def begin(self, at: InjectionContext) -> None:
        """Begin to count."""
        self._before = self._writes(at)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Ten times a second."""
        if int(since_s * 60.0) % 6 == 0 and (pid := roster_of(at).pid(self._name)) is not None:
            at.notes["memory"] = max(at.notes.get("memory", 0.0), resident_bytes(pid) / _MEGABYTE)
            at.notes["writes"] = float(self._writes(at) - self._before)

    def _writes(self, at: InjectionContext) -> int:
        pid = roster_of(at).pid(self._name)
        return 0 if pid is None else writes_of(pid)


class NoSpace(Injector):
    """No file that the product writes grows beyond so many bytes: what a full disk says too (an OSError), without root."""

    needs = Capabilities.PROCESSES

    def __init__(self, max_bytes: int = 4096) -> None:
        self._max_bytes = max_bytes

    def begin(self, at: InjectionContext) -> None:
        """Mission, pilot and the mission's children; what the processes say to one another lies in memory."""
        roster = roster_of(at)
        mission = roster.pid("mission")
        for pid in (mission, roster.pid("pilot"), child_of(mission, MAPPER), child_of(mission, RECORDER)):
            if pid is not None:
                _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (self._max_bytes, hard))


def resident_bytes(pid: int) -> int:
    """Memory of a process, of its own and shared; 0 once it is gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize()
    except (OSError, IndexError):
        return 0


def writes_of(pid: int) -> int:
    """write(2) and its kin by a process's main thread so far; a datagram that is sent is none. 0 once it is gone."""
    try:
        lines = Path(f"/proc/{pid}/task/{pid}/io").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("syscw")), 0)
