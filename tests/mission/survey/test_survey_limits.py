"""The reason for the way home names the spent limit first, then the request, then the battery."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conductor_fixture import Desk

from uav_recon.mission.battery.battery_policy import BatteryPolicy
from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.survey.survey_limits import SurveyLimits
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

REQUESTED = Reason(ReasonCode.OPERATOR_RETURN)


@pytest.fixture()
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.journal.close()


def limits_of(desk: Desk, views: int, begun_s: float) -> tuple[SurveyLimits, MissionLog]:
    parameters = dataclasses.replace(desk.parameters, views=5, max_flight_s=60.0)
    takeoff, log = desk.conductor._actions.takeoff, MissionLog(desk.journal, 5, views)
    takeoff.begun_s = begun_s
    return SurveyLimits(parameters, takeoff, BatteryPolicy(FlightTrack(0.0), np.zeros(3), 0.35), log), log


def test_spent_views_come_first(desk: Desk) -> None:
    limits, _ = limits_of(desk, 5, 10.0)
    assert limits.views_left == 0
    assert limits.return_reason(100.0, REQUESTED) == Reason(ReasonCode.VIEWS_SPENT, (5,))


def test_then_the_flight_time_and_the_request(desk: Desk) -> None:
    limits, _ = limits_of(desk, 4, 10.0)
    assert limits.flight_s(70.1) == pytest.approx(60.1)
    assert limits.return_reason(70.1, REQUESTED) == Reason(ReasonCode.TIME_SPENT, (60.0,))
    assert limits.return_reason(69.9, REQUESTED) == REQUESTED


def test_else_it_is_the_battery(desk: Desk) -> None:
    limits, _ = limits_of(desk, 4, np.inf)
    assert limits.flight_s(70.0) == -np.inf
    assert limits.return_reason(70.0, None) == limits.battery.return_reason()


def test_a_reason_to_stop_leaves_nothing(desk: Desk) -> None:
    limits, log = limits_of(desk, 4, 10.0)
    before = limits.nothing_left
    log.stop(REQUESTED)
    assert [before, limits.nothing_left] == [False, True]
    assert log.note == REQUESTED and log.stop_reason is not None
    assert log.stop_reason.codes()[0] == ReasonCode.OPERATOR_RETURN
