"""How the flight stands, again and again: on a terminal in one place, elsewhere a line each time."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from typing import Protocol, TextIO

from uav_recon.interfaces import Clock
from uav_recon.operator.client import CallError
from uav_recon.operator.status import Status

PERIOD_S, MAX_LOST = 1.0, 3  # a pilot that is started again is back before three answers are lost


class Page(Protocol):
    """Where it is shown. Both raise OSError where nobody reads any more."""

    def show(self, status: Status) -> None:
        """An answer."""
        ...

    def lost(self, why: str) -> None:
        """None came; it is asked again."""
        ...


class Block:
    """On a terminal: some lines, written over the ones before, none longer than the terminal is wide."""

    def __init__(self, out: TextIO) -> None:
        self._out, self._height, self._lines = out, 0, list[str]()

    def show(self, status: Status) -> None:
        """In the place of what was shown before."""
        self._lines = status.lines()
        self._write(self._lines)

    def lost(self, why: str) -> None:
        """Below the last answer."""
        self._write([*self._lines, f"no answer: {why}"])

    def _write(self, lines: list[str]) -> None:
        """In one piece, so that it does not flicker."""
        width = shutil.get_terminal_size().columns - 1
        back = f"\x1b[{self._height}F\x1b[J" if self._height else ""
        self._out.write(back + "".join(f"{line[:width]}\n" for line in lines))
        self._out.flush()
        self._height = len(lines)


class Lines:
    """In a pipe or a file: a plain line for each answer; that none came is said beside it."""

    def __init__(self, out: TextIO, beside: TextIO, text: Callable[[Status], str]) -> None:
        self._out, self._beside, self._text = out, beside, text

    def show(self, status: Status) -> None:
        """At once, not when a buffer is full."""
        self._out.write(self._text(status) + "\n")
        self._out.flush()

    def lost(self, why: str) -> None:
        """So that what reads the lines meets nothing else."""
        self._beside.write(f"uav-recon: no answer: {why}\n")


def in_a_line(status: Status) -> str:
    """All of it."""
    return "  ".join(" ".join(line.split()) for line in status.lines())


def watch(ask: Callable[[], Status], page: Page, clock: Clock) -> None:
    """Ask once a second for ever. Raises the last CallError if the very first answer, or MAX_LOST in a row, did not come."""
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
