"""Periodic display of the flight status.

A terminal is overwritten in place; any other output gets one line per answer.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from typing import Protocol, TextIO

from uav_recon.interfaces import Clock
from uav_recon.operator.client import CallError
from uav_recon.operator.status import Status

PERIOD_S = 1.0  # interval of the requests
MAX_LOST = 3  #: warn: the watch ends after this many missing answers in a row: a restarted pilot answers before


class Page(Protocol):
    """A display of the status. Both methods raise OSError once the reader is gone."""

    def show(self, status: Status) -> None:
        """Show an answer."""
        ...

    def lost(self, why: str) -> None:
        """Show that an answer is missing, with the reason."""
        ...


class TerminalOutput:
    """Display for a terminal.

    Its lines overwrite the previous ones, cut to the width of the terminal.
    """

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._height = 0
        self._lines = list[str]()

    def show(self, status: Status) -> None:
        """Overwrite the previous answer."""
        self._lines = status.lines()
        self._write(self._lines)

    def lost(self, why: str) -> None:
        """Add the reason below the last answer."""
        self._write([*self._lines, f"no answer: {why}"])

    def _write(self, lines: list[str]) -> None:
        """Write all lines at once, which avoids flicker."""
        width = shutil.get_terminal_size().columns - 1
        back = f"\x1b[{self._height}F\x1b[J" if self._height else ""
        self._out.write(back + "".join(f"{line[:width]}\n" for line in lines))
        self._out.flush()
        self._height = len(lines)


class LineOutput:
    """Display for a pipe or a file: a plain line per answer.

    Missing answers are reported on a second stream.
    """

    def __init__(self, out: TextIO, beside: TextIO, text: Callable[[Status], str]) -> None:
        self._out = out
        self._beside = beside
        self._text = text

    def show(self, status: Status) -> None:
        """Write one line and flush."""
        self._out.write(self._text(status) + "\n")
        self._out.flush()

    def lost(self, why: str) -> None:
        """Write the reason to the second stream, so that the first holds answers only."""
        self._beside.write(f"uav-recon: no answer: {why}\n")


def in_a_line(status: Status) -> str:
    """Return the whole status in one line."""
    return "  ".join(" ".join(line.split()) for line in status.lines())


def watch(ask: Callable[[], Status], page: Page, clock: Clock) -> None:
    """Ask once a second until interrupted.

    Raises the last CallError if the first answer, or MAX_LOST in a row, is missing.
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
