"""The intent is published in each step, the progress when it is due and at the end."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from conductor_fixture import Desk, posed_frame, vehicle_state

from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.publication.mission_publisher import PROGRESS_PERIOD_S, MissionPublisher
from uav_recon.mission.requests.operator_watchdog import OperatorWatchdog
from uav_recon.mission.state_machine import Phase
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.recording.flight_log import read_timeline
from uav_recon.types.camera import PosedFrame
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.pose import Pose
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


class KnownSurface:
    """A surface whose view shows the place the better the farther the vehicle is; notes the pitch that it is asked for."""

    cells = SurfaceCells.none(0.2)

    def __init__(self) -> None:
        self.pitches_rad: list[float] = []

    def add(self, posed: PosedFrame) -> bool:
        return False

    def sigma_m(self, world_from_body: Pose, pitch_down_rad: float) -> float:
        self.pitches_rad.append(pitch_down_rad)
        return 0.1 - 0.02 * float(world_from_body.translation_m[0])

    def seeing_yaw_rad(self, world_from_body: Pose, pitch_down_rad: float) -> float | None:
        return None


def test_the_predicted_uncertainty_is_that_of_the_view_from_the_vehicle(
    desk: Desk, log: MissionLog, watchdog: OperatorWatchdog
) -> None:
    surface, track = KnownSurface(), FlightTrack(0.0)
    stages = dataclasses.replace(desk.stages, localizability=surface)
    publisher = MissionPublisher(stages, desk.channels, track, log, watchdog, 0.26)
    track.follow(vehicle_state(1.0, x_m=2.0))
    publisher.publish(1.0, Phase.SURVEY, None)
    assert desk.progress.predicted_sigma_m == pytest.approx(0.06)
    assert surface.pitches_rad == [0.26]
    (logged,) = read_timeline(desk.folder).progress
    assert (logged.predicted_sigma_m, logged.measured_sigma_m) == (desk.progress.predicted_sigma_m, None)


def test_the_measured_uncertainty_is_that_of_the_newest_frame(desk: Desk, publisher: MissionPublisher) -> None:
    found = []
    for number, sigma_m in enumerate((None, 0.011, 0.052, math.nan)):
        if sigma_m is not None:
            desk.channels.frames.publish(dataclasses.replace(posed_frame(float(number)), place_sigma_m=sigma_m))
        publisher.publish(float(number), Phase.SURVEY, None)
        found.append(desk.progress.measured_sigma_m)
    assert found == [None, 0.011, 0.052, None]
    assert [sample.measured_sigma_m for sample in read_timeline(desk.folder).progress] == found
    assert desk.progress.predicted_sigma_m is None
