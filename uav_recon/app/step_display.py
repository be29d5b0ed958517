"""Display of long steps outside the flight.

A terminal shows a progress bar; any other output gets a plain line every few seconds.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

QUICK_S = 2.0  # a step that ends within the first prints nothing
PERIOD_S = 10.0  # between lines
Report = Callable[[int, int], None]  # amount done, total amount


def no_report(done: int, total: int) -> None:
    """Ignore progress."""


class StepDisplay:
    """Display of the running step and its progress; a quiet console shows nothing.

    quick_s: where the console is no terminal, a step that ends within this time prints nothing. period_s: time between
    lines.
    """

    def __init__(self, console: Console, quick_s: float = QUICK_S, period_s: float = PERIOD_S) -> None:
        self._console = console
        self._quick_s = quick_s
        self._period_s = period_s

    @contextmanager
    def step(self, text: str) -> Iterator[Report]:
        """Show a step while the block runs.

        The value of the block reports the step's progress, from any thread.
        """
        if self._console.quiet:
            yield no_report
        elif self._console.is_terminal:
            with self._bar(text) as report:
                yield report
        else:
            with self._lines(text) as report:
                yield report

    @contextmanager
    def _bar(self, text: str) -> Iterator[Report]:
        columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, console=self._console, transient=True) as progress:
            task = progress.add_task(text, total=None)
            yield lambda done, total: progress.update(task, completed=done, total=total)

    @contextmanager
    def _lines(self, text: str) -> Iterator[Report]:
        over, begun_s, state = threading.Event(), time.monotonic(), [0, 0]

        def report(done: int, total: int) -> None:
            state[:] = done, total

        def print_lines() -> None:
            wait_s = self._quick_s
            while not over.wait(wait_s):
                done, total = state
                share = f"{100 * done // total} %, " if total else ""
                line = f"{text}: {share}{time.monotonic() - begun_s:.0f} s"
                self._console.print(line, markup=False, highlight=False, soft_wrap=True)
                wait_s = self._period_s

        printer = threading.Thread(target=print_lines, name="step display", daemon=True)
        printer.start()
        try:
            yield report
        finally:
            over.set()
            printer.join()
