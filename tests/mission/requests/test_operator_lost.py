"""A mission whose operator goes: no start, a word, the way home, and no hold that outlasts him."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from conductor_fixture import Desk

from uav_recon.mission.state_machine import Phase
from uav_recon.recording.flight_log import read_timeline
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal

WARNED = Reason(ReasonCode.OPERATOR_SILENT, (5.0, 30.0))
RETURNS = Reason(ReasonCode.OPERATOR_LOST_RETURNING, (30.0,))


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path, operator_timeout_s=30.0)
    yield desk
    desk.journal.close()


def test_a_start_waits_for_an_operator_and_says_so(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(3.0)
    assert desk.conductor.phase is Phase.READY
    assert desk.intent.goal is Goal.STANDBY
    assert desk.progress.note == Reason(ReasonCode.OPERATOR_MISSING)
    desk.attended = True
    desk.run(1.0, until=Phase.TAKEOFF)
    desk.run(0.3)
    assert desk.progress.note is None


def flying(desk: Desk) -> None:
    """In the middle of its survey, with views left for minutes."""
    desk.attended = True
    desk.conductor.requests.start()
    desk.planner.settled = False
    desk.run(10.0, until=Phase.SURVEY)
    desk.conductor.requests.hold()  # so that it does not come to an end by itself
    desk.run(1.0)
    desk.attended = False


def test_half_a_minute_of_silence_ends_a_flight_at_home_also_out_of_a_hold(desk: Desk) -> None:
    flying(desk)
    begun_s = desk.clock.now_s()
    desk.run(29.0)
    assert desk.conductor.phase is Phase.HOLD
    assert (desk.intent.note, desk.intent.operator_lost) == (WARNED, False)
    desk.run(2.0, until=Phase.RETURN)
    assert desk.clock.now_s() - begun_s == pytest.approx(30.0, abs=0.2)
    assert (desk.intent.note, desk.intent.operator_lost) == (RETURNS, True)
    desk.run(60.0, until=Phase.DONE)
    assert desk.distance_m() < 0.1
    assert desk.conductor.close(desk.clock.now_s()) is None
    told = read_timeline(desk.folder)
    assert told.outcomes[-1].stop_codes[0] == ReasonCode.OPERATOR_LOST
    assert [record.codes for record in told.refusals] == [
        WARNED.codes(), RETURNS.codes(),
    ]  # fmt: skip


def test_who_comes_back_may_hold_it_and_takes_no_return_back(desk: Desk) -> None:
    flying(desk)
    desk.run(31.0, until=Phase.RETURN)
    desk.attended = True
    desk.conductor.requests.hold()
    desk.run(1.0)
    assert desk.conductor.phase is Phase.HOLD
    assert not desk.intent.operator_lost, "his hold stands at the pilot too"
    desk.conductor.requests.resume()
    desk.run(60.0, until=Phase.DONE)
    assert desk.distance_m() < 0.1


def test_where_nobody_need_attend_nobody_is_missed(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    desk.conductor.requests.start()
    desk.run(120.0, until=Phase.DONE)
    desk.journal.close()
    told = read_timeline(desk.folder)
    assert not [record for record in told.refusals if record.codes[0].startswith("operator-")]
    assert (desk.intent.note, desk.intent.operator_lost) == (None, False)
