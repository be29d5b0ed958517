"""Repeated status: updated in place on a terminal, one line per answer elsewhere."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from typing import Protocol, TextIO

from uav_recon.interfaces import Clock
from uav_recon.operator.client import CallError
from uav_recon.operator.status import Status

PERIOD_S, MAX_LOST = 1.0, 3  # a restarted pilot is back before three answers are lost


class Page(Protocol):
    """Output of the status. Both methods raise OSError if the output is closed."""

    def show(self, status: Status) -> None:
        """Show an answer."""
        ...

    def lost(self, why: str) -> None:
        """Show that no answer came; the pilot is asked again."""
        ...


class Block:
    """Output on a terminal: lines that overwrite the ones before, none wider than the terminal."""

    def __init__(self, out: TextIO) -> None:
        self._out, self._height, self._lines = out, 0, list[str]()

    def show(self, status: Status) -> None:
        """Show the status in place of the earlier one."""
        self._lines = status.lines()
        self._write(self._lines)

    def lost(self, why: str) -> None:
        """Show the reason below the last answer."""
        self._write([*self._lines, f"no answer: {why}"])

    def _write(self, lines: list[str]) -> None:
        """Write all lines at once, so that the terminal does not flicker."""
        width = shutil.get_terminal_size().columns - 1
        back = f"\x1b[{self._height}F\x1b[J" if self._height else ""
        self._out.write(back + "".join(f"{line[:width]}\n" for line in lines))
        self._out.flush()
        self._height = len(lines)


class Lines:
    """Output to a pipe or a file: one plain line per answer.

    Missing answers are reported to ``beside``.
    """

    def __init__(self, out: TextIO, beside: TextIO, text: Callable[[Status], str]) -> None:
        self._out, self._beside, self._text = out, beside, text

    def show(self, status: Status) -> None:
        """Write the line and flush it."""
        self._out.write(self._text(status) + "\n")
        self._out.flush()

    def lost(self, why: str) -> None:
        """Write to the other stream, so that a reader of the lines gets nothing else."""
        self._beside.write(f"uav-recon: no answer: {why}\n")


def in_a_line(status: Status) -> str:
    """Return the status in one line."""
    return "  ".join(" ".join(line.split()) for line in status.lines())


def watch(ask: Callable[[], Status], page: Page, clock: Clock) -> None:
    """Ask once a second for ever.

    Raises the last CallError if the first answer, or MAX_LOST in a row, did not come.
    """
    lost, max_lost = 0, 1
    while True:
        begun_s = clock.now_s()
        try:
            page.show(ask())
            lost, max_lost = 0, MAX_LOST
        except CallError as error:
            lost += 1
            if lost == max_lost:
                raise
            page.lost(str(error))
        clock.sleep_until(max(begun_s + PERIOD_S, clock.now_s()))
