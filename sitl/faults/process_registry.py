"""Registry of the processes of a real-time flight.

It holds the running processes by name, the exits, and the processes that must not be restarted, in two files in the flight's
runtime folder. The supervisor writes the first, the injectors write the second.
"""

from __future__ import annotations

import json
import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sitl.runtime import atomic_file

RUNNING = "running.json"
DOWN = "down.json"


@dataclass(frozen=True, slots=True)
class Exit:
    """A process that ended.

    code: as subprocess reports it; a signal is its negative number.
    stamp_s: when it ended, on time.monotonic().
    """

    name: str
    code: int
    stamp_s: float


class ProcessRegistry:
    """Registry of the processes of one flight.

    folder: the runtime folder of the flight.
    """

    def __init__(self, folder: Path) -> None:
        self._running = folder / RUNNING
        self._down = folder / DOWN

    def tell(self, pids: dict[str, int], exits: list[Exit]) -> None:
        """Write the running processes and the exits. Only the supervisor calls this."""
        tree = {"pids": pids, "exits": [[e.name, e.code, e.stamp_s] for e in exits]}
        atomic_file.replace(self._running, json.dumps(tree).encode())

    def pid(self, name: str) -> int | None:
        """Return the process id that was last registered for a name, None without one."""
        found = _read(self._running, {"pids": {}})["pids"].get(name)
        return None if found is None else int(found)

    def exits(self) -> list[Exit]:
        """Return the exits in the order in which the processes ended."""
        return [Exit(*each) for each in _read(self._running, {"exits": []})["exits"]]

    def block_restart(self, names: tuple[str, ...]) -> None:
        """Set the processes that must not be restarted; this replaces the previous set."""
        atomic_file.replace(self._down, json.dumps(list(names)).encode())

    def blocked_restarts(self) -> frozenset[str]:
        """Return the processes that must not be restarted."""
        return frozenset(_read(self._down, []))

    def send(self, name: str, number: signal.Signals) -> None:
        """Send a signal to a process, if it runs."""
        send(self.pid(name), number)


def send(pid: int | None, number: signal.Signals) -> None:
    """Send a signal to a process, if it exists."""
    if pid is not None:
        try:
            os.kill(pid, number)
        except ProcessLookupError:
            return


def child_of(parent: int | None, word: str) -> int | None:
    """Return the child of a process that has a word in its command line, None without one."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            its_parent = int(stat.read_text().rpartition(")")[2].split()[1])
            if its_parent == parent and word in stat.with_name("cmdline").read_text():
                return int(stat.parent.name)
        except OSError:
            continue  # the process ended while it was read
    return None


def _read(path: Path, otherwise: Any) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return otherwise
