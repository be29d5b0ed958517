"""Faults of an overloaded computer, and the load that the pilot causes.

They need a real-time flight.
"""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
import sys
from pathlib import Path

from sitl.faults.injectors.base import Capabilities, InjectionContext, Injector
from sitl.faults.injectors.process_signals import MAPPER, RECORDER, processes_of
from sitl.faults.process_registry import child_of
from sitl.runtime.die_with_parent import die_with_parent_command

BUSY = "while True: pass"
DISK_LOAD = """
import os, sys
with open(sys.argv[1], "wb", buffering=0) as file:
    while True:
        file.seek(0)
        file.write(bytes(1 << 24))
        os.fsync(file.fileno())
"""
_MEGABYTE = 1e6


class BusyProcesses(Injector):
    """Programs that keep the CPU or the disk busy for a while, at the default priority."""

    needs = Capabilities.PROCESSES

    def __init__(self, program: str, count: int, for_s: float) -> None:
        """Set up the load without starting it.

        program: Python source; its argument is the path of a file in the flight's folder.
        """
        self._program = program
        self._count = count
        self._for_s = for_s
        self._processes: list[subprocess.Popen[bytes]] = []

    def begin(self, at: InjectionContext) -> None:
        """Start the programs."""
        assert at.config is not None
        for k in range(self._count):
            command = [sys.executable, "-c", self._program, str(at.config.with_name(f"toil-{k}"))]
            process = subprocess.Popen(die_with_parent_command(command))  # noqa: S603 - our own programs
            self._processes.append(process)
            with contextlib.suppress(PermissionError):  # the world starts them and may itself have a higher priority
                os.setpriority(os.PRIO_PROCESS, process.pid, 0)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """End the programs after for_s."""
        if self._processes and since_s >= self._for_s:
            self.end(at)

    def end(self, at: InjectionContext) -> None:
        """Kill the programs and remove their files."""
        for process in self._processes:
            process.kill()
            process.wait()
        self._processes.clear()
        assert at.config is not None
        for k in range(self._count):
            at.config.with_name(f"toil-{k}").unlink(missing_ok=True)


class ProcessUsageMonitor(Injector):
    """Monitor of one process.

    It notes the greatest "memory" in MB, and as "writes" the number of writes by the main thread.
    """

    needs = Capabilities.PROCESSES

    def __init__(self, name: str) -> None:
        self._name = name
        self._before = 0

    def begin(self, at: InjectionContext) -> None:
        """Record the number of writes before the fault."""
        self._before = self._writes(at)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Sample ten times a second."""
        if int(since_s * 60.0) % 6 == 0 and (pid := processes_of(at).pid(self._name)) is not None:
            at.notes["memory"] = max(at.notes.get("memory", 0.0), resident_bytes(pid) / _MEGABYTE)
            at.notes["writes"] = float(self._writes(at) - self._before)

    def _writes(self, at: InjectionContext) -> int:
        pid = processes_of(at).pid(self._name)
        return 0 if pid is None else writes_of(pid)


class FileSizeLimitOfProcesses(Injector):
    """Limit on the size of every file that the product writes, in bytes.

    Writes fail with an OSError, as on a full disk. Root is not needed.
    """

    needs = Capabilities.PROCESSES

    def __init__(self, max_bytes: int = 4096) -> None:
        self._max_bytes = max_bytes

    def begin(self, at: InjectionContext) -> None:
        """Limit mission, pilot and the mission's children.

        The channels between the processes are in memory and are not affected.
        """
        registry = processes_of(at)
        mission = registry.pid("mission")
        for pid in (mission, registry.pid("pilot"), child_of(mission, MAPPER), child_of(mission, RECORDER)):
            if pid is not None:
                _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (self._max_bytes, hard))


def resident_bytes(pid: int) -> int:
    """Return the resident memory of a process, its own and shared; 0 once it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize()
    except (OSError, IndexError):
        return 0


def writes_of(pid: int) -> int:
    """Return the number of write calls by a process's main thread until now.

    write(2) and its variants count; a datagram that is sent does not. 0 once the process has ended.
    """
    try:
        lines = Path(f"/proc/{pid}/task/{pid}/io").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("syscw")), 0)
