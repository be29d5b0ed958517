"""The processes of a flight in real time, by name: who runs, who ended how, and who is not to be started again.

One file each way in the flight's runtime folder: the supervisor writes the first, the troubles the second.
"""

from __future__ import annotations

import json
import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RUNNING, DOWN = "running.json", "down.json"


@dataclass(frozen=True, slots=True)
class Exit:
    """A process that ended: its code as subprocess has it (minus a signal), and when, on time.monotonic()."""

    name: str
    code: int
    stamp_s: float


class ProcessRegistry:
    """folder: of the flight's runtime."""

    def __init__(self, folder: Path) -> None:
        self._running, self._down = folder / RUNNING, folder / DOWN

    def tell(self, pids: dict[str, int], exits: list[Exit]) -> None:
        """Write down who runs and who ended; the supervisor's."""
        _write(self._running, {"pids": pids, "exits": [[e.name, e.code, e.stamp_s] for e in exits]})

    def pid(self, name: str) -> int | None:
        """Of a process that was last told to run."""
        found = _read(self._running, {"pids": {}})["pids"].get(name)
        return None if found is None else int(found)

    def exits(self) -> list[Exit]:
        """In the order in which they ended."""
        return [Exit(*each) for each in _read(self._running, {"exits": []})["exits"]]

    def keep_down(self, names: tuple[str, ...]) -> None:
        """These and no others are not to be started again."""
        _write(self._down, list(names))

    def kept_down(self) -> frozenset[str]:
        """What keep_down() said last."""
        return frozenset(_read(self._down, []))

    def send(self, name: str, number: signal.Signals) -> None:
        """Signal a process, if it runs."""
        send(self.pid(name), number)


def send(pid: int | None, number: signal.Signals) -> None:
    """Signal a process, if it is there."""
    if pid is not None:
        try:
            os.kill(pid, number)
        except ProcessLookupError:
            return


def child_of(parent: int | None, word: str) -> int | None:
    """The child of a process with a word in its command line; None without one."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            its_parent = int(stat.read_text().rpartition(")")[2].split()[1])
            if its_parent == parent and word in stat.with_name("cmdline").read_text():
                return int(stat.parent.name)
        except OSError:
            continue  # it ended meanwhile
    return None


def _write(path: Path, tree: object) -> None:
    fresh = path.with_suffix(".new")
    fresh.write_text(json.dumps(tree), encoding="utf-8")
    fresh.replace(path)


def _read(path: Path, otherwise: Any) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return otherwise
