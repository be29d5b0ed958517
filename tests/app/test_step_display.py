"""A long step shows what it does and how far it is; a quick one says nothing."""

from __future__ import annotations

import io
import time

from rich.console import Console

from uav_recon.app.step_display import StepDisplay


def test_where_there_is_no_terminal_a_long_step_prints_lines_with_its_progress() -> None:
    out = io.StringIO()
    with StepDisplay(Console(file=out), quick_s=0.02, period_s=0.02).step("meshing") as report:
        report(1, 4)
        deadline_s = time.monotonic() + 10.0
        while out.getvalue().count("\n") < 2 and time.monotonic() < deadline_s:
            time.sleep(0.01)
    lines = out.getvalue().splitlines()
    assert lines[:2] == ["meshing: 25 %, 0 s"] * 2
    assert len(out.getvalue().splitlines()) == len(lines), "and none after its end"


def test_a_quick_step_and_a_quiet_console_print_nothing() -> None:
    out = io.StringIO()
    with StepDisplay(Console(file=out)).step("quick"):
        pass
    with StepDisplay(Console(file=out, quiet=True), quick_s=0.0).step("quiet") as report:
        report(1, 2)
    assert out.getvalue() == ""


def test_on_a_terminal_the_step_is_a_bar() -> None:
    out = io.StringIO()
    with StepDisplay(Console(file=out, force_terminal=True, width=100)).step("meshing") as report:
        report(1, 4)
    assert "meshing" in out.getvalue()
