"""The status again and again: in one place or in lines, and what becomes of answers that do not come."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from uav_recon.clock import ManualClock, MonotonicClock
from uav_recon.operator.client import CallError, send_command
from uav_recon.operator.command_socket import CommandSocket
from uav_recon.operator.status import Status
from uav_recon.operator.status_watch import PERIOD_S, LineOutput, TerminalOutput, in_a_line, watch


class Enough(Exception):  # noqa: N818 - Ctrl-C
    pass


class Seen:
    """A page that keeps what it was given."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def show(self, status: Status) -> None:
        self.told.append(status.pilot)

    def lost(self, why: str) -> None:
        self.told.append(why)


class Slept(ManualClock):
    """Time passes where somebody sleeps."""

    def sleep_until(self, instant_s: float) -> None:
        self.advance_to(instant_s)


def asking(*answers: str) -> Callable[[], Status]:
    """Each is a pilot's phase, or no answer if it begins with a capital."""
    left: Iterator[str] = iter(answers)

    def ask() -> Status:
        answer = next(left, "")
        if not answer:
            raise Enough
        if answer[0].isupper():
            raise CallError(answer)
        return Status(answer, "survey")

    return ask


def test_it_asks_once_a_second() -> None:
    clock, page = Slept(10.0), Seen()
    with pytest.raises(Enough):
        watch(asking("ready", "flying", "landed"), page, clock)
    assert page.told == ["ready", "flying", "landed"]
    assert clock.now_s() == 10.0 + 3 * PERIOD_S


def test_one_lost_answer_ends_nothing_and_three_in_a_row_do() -> None:
    page = Seen()
    with pytest.raises(Enough):
        watch(asking("ready", "Late", "Late", "flying", "Late", "Late", "flying"), page, Slept())
    assert page.told == ["ready", "Late", "Late", "flying", "Late", "Late", "flying"]
    page = Seen()
    with pytest.raises(CallError, match="Gone"):
        watch(asking("ready", "Late", "Late", "Gone", "flying"), page, Slept())
    assert page.told == ["ready", "Late", "Late"]


def test_where_no_pilot_is_at_all_it_says_so_at_once() -> None:
    page = Seen()
    with pytest.raises(CallError, match="No pilot"):
        watch(asking("No pilot is running there", "ready"), page, Slept())
    assert page.told == []


def test_on_a_terminal_each_takes_the_place_of_the_one_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    out = io.StringIO()
    block, status = TerminalOutput(out), Status("flying", "survey", note="a note that is much longer than a line")
    block.show(status)
    height, first = out.getvalue().count("\n"), out.getvalue()
    assert "\x1b" not in first
    assert max(map(len, first.splitlines())) == 19
    block.show(status)
    assert out.getvalue() == first + f"\x1b[{height}F\x1b[J" + first
    block.lost("late")
    assert out.getvalue().endswith("no answer: late\n")
    assert out.getvalue().count("\n") == 3 * height + 1
    block.show(status)
    assert f"\x1b[{height + 1}F\x1b[J" in out.getvalue()


def test_elsewhere_it_is_a_line_each_and_trouble_stands_beside_them() -> None:
    out, beside = io.StringIO(), io.StringIO()
    page = LineOutput(out, beside, in_a_line)
    page.show(Status("flying", "survey", battery=0.5, refusals=0))
    page.lost("late")
    assert out.getvalue().startswith("pilot flying  mission survey  mode -  battery 50%  ")
    assert (out.getvalue().count("\n"), beside.getvalue()) == (1, "uav-recon: no answer: late\n")


def test_each_answer_over_the_socket_is_one_that_the_pilot_counts(tmp_path: Path) -> None:
    path, heard, over = tmp_path / "socket", list[str](), threading.Event()

    def serve(word: str) -> dict[str, Any]:
        heard.append(word)
        return {"ok": True, "said": "", "status": Status("flying", "survey").as_json()}

    desk = CommandSocket(path, serve, MonotonicClock())

    def pilot() -> None:
        while not over.wait(0.005):
            desk.poll()

    served, asked = threading.Thread(target=pilot), 0

    def ask() -> Status:
        nonlocal asked
        asked += 1
        if asked > 3:
            raise Enough
        return Status.from_json(send_command(path, "status")["status"])

    served.start()
    page = Seen()
    try:
        with pytest.raises(Enough):
            watch(ask, page, Slept())
    finally:
        over.set()
        served.join()
        desk.close()
    assert (page.told, heard) == (["flying"] * 3, ["status"] * 3)
