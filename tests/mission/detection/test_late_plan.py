"""A planner's call that does not return, and one that is late: the mission does not hover for it for ever."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import pytest
from conductor_fixture import Desk

from uav_recon.clock import InlineExecutor
from uav_recon.interfaces import Pending
from uav_recon.mission.conductor import Conductor
from uav_recon.mission.state_machine import Phase
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal

T = TypeVar("T")


class Kept:
    """A call that returns nothing as long as its executor is stuck."""

    def __init__(self, inner: Pending[T], stuck: Callable[[], bool]) -> None:
        self._inner = inner
        self._stuck = stuck

    def done(self) -> bool:
        return not self._stuck() and self._inner.done()

    def result(self) -> object:
        return self._inner.result()


class Sticky:
    """One worker for all calls, as in real time: while it is stuck, nothing that waits in it is done."""

    def __init__(self, desk: Desk) -> None:
        self._inner = InlineExecutor(desk.clock)
        self.stuck = False

    def submit(self, work: Callable[[], T], cost_s: float) -> Pending[T]:
        return Kept(self._inner.submit(work, cost_s), lambda: self.stuck)  # type: ignore[return-value]

    def close(self) -> None:
        pass


@pytest.fixture
def stuck(tmp_path: Path) -> Iterator[tuple[Desk, Sticky]]:
    desk = Desk(tmp_path)
    executor = Sticky(desk)
    desk.conductor = Conductor(desk.stages, desk.channels, desk.parameters, executor, desk.journal)
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    yield desk, executor
    desk.journal.close()


def test_a_planner_that_does_not_answer_is_waited_for_so_long_and_no_longer(stuck: tuple[Desk, Sticky]) -> None:
    desk, executor = stuck
    executor.stuck = True
    desk.run(12.0)  # the look round ends, and the first plan is asked
    assert desk.speed_mps() == 0.0 and desk.intent.goal is Goal.FLY
    begin_s = desk.clock.now_s()
    desk.run(22.0, until=Phase.LANDING)
    assert desk.clock.now_s() - begin_s > 5.0
    desk.run(2.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) == Reason(ReasonCode.PLANNER_SILENT, (20.0,))


@pytest.mark.parametrize("seconds", [5.0, 18.0])
def test_a_planner_that_is_late_is_waited_for(stuck: tuple[Desk, Sticky], seconds: float) -> None:
    desk, executor = stuck
    executor.stuck = True
    desk.run(seconds)
    executor.stuck = False
    desk.run(120.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) is None


@pytest.mark.parametrize("phase", [Phase.RETURN, Phase.RETREAT])
def test_on_the_way_home_too(stuck: tuple[Desk, Sticky], phase: Phase) -> None:
    desk, executor = stuck
    desk.run(8.0)
    desk.planner.no_way_home = phase is Phase.RETREAT
    desk.conductor.requests.return_home()
    executor.stuck = phase is Phase.RETURN
    desk.run(5.0, until=phase)
    executor.stuck = True
    desk.run(21.0, until=Phase.LANDING)


def test_a_call_that_nobody_waits_for_any_more_still_blocks_those_after_it(stuck: tuple[Desk, Sticky]) -> None:
    """One worker: what was asked before the phase changed stands before what is asked now."""
    desk, executor = stuck
    desk.run(4.0)
    executor.stuck = True
    desk.run(15.0)
    desk.conductor.requests.return_home()
    desk.run(1.0, until=Phase.RETURN)
    begin_s = desk.clock.now_s()
    desk.run(21.0, until=Phase.LANDING)
    assert desk.clock.now_s() - begin_s < 19.0, "since the first of them"
