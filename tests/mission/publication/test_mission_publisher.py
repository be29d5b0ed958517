"""The intent is published in each step, the progress when it is due and at the end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from conductor_fixture import Desk

from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.publication.mission_publisher import PROGRESS_PERIOD_S, MissionPublisher
from uav_recon.mission.requests.operator_watchdog import OperatorWatchdog
from uav_recon.mission.state_machine import Phase
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal


@pytest.fixture()
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.journal.close()


@pytest.fixture()
def log(desk: Desk) -> MissionLog:
    return MissionLog(desk.journal, 10)


@pytest.fixture()
def watchdog() -> OperatorWatchdog:
    return OperatorWatchdog(10.0)


@pytest.fixture()
def publisher(desk: Desk, log: MissionLog, watchdog: OperatorWatchdog) -> MissionPublisher:
    return MissionPublisher(desk.stages, desk.channels, FlightTrack(0.0), log, watchdog, 0.0)


@pytest.mark.parametrize(
    ("phase", "goal"),
    [
        (Phase.IDLE, Goal.STANDBY), (Phase.READY, Goal.STANDBY), (Phase.TAKEOFF, Goal.FLY), (Phase.HOLD, Goal.FLY),
        (Phase.LANDING, Goal.LAND), (Phase.DONE, Goal.STANDBY), (Phase.YIELDED, Goal.STANDBY),
    ],
)  # fmt: skip
def test_the_goal_follows_from_the_phase(desk: Desk, publisher: MissionPublisher, phase: Phase, goal: Goal) -> None:
    publisher.publish(1.0, phase, None)
    assert desk.intent.goal is goal


def test_the_progress_is_periodic_until_the_end(desk: Desk, publisher: MissionPublisher) -> None:
    stamps_s = []
    for now_s in (1.0, 1.1, 1.0 + PROGRESS_PERIOD_S + 0.01, 1.25):
        publisher.publish(now_s, Phase.SURVEY, None)
        stamps_s.append(desk.progress.stamp_s)
    assert stamps_s == [1.0, 1.0, 1.21, 1.21]
    publisher.publish(1.3, Phase.DONE, None)
    assert (desk.progress.stamp_s, desk.progress.finished) == (1.3, True)


def test_a_lost_operator_and_an_abort_are_in_the_intent(
    desk: Desk, publisher: MissionPublisher, log: MissionLog, watchdog: OperatorWatchdog
) -> None:
    watchdog.update(100.0, 100.0, flying=True)
    watchdog.update(111.0, 100.0, flying=True)
    publisher.publish(111.0, Phase.SURVEY, None)
    assert watchdog.note is not None
    assert desk.intent.operator_lost and desk.intent.note == watchdog.note
    log.aborted = Reason(ReasonCode.OPERATOR_LAND)
    publisher.publish(111.1, Phase.LANDING, None)
    assert desk.intent.note == log.aborted
