"""The mapper gets the planned views on the track, and while surveying what shows enough that is new."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conductor_fixture import Desk, posed_frame

from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.survey.keyframe_capture import KeyframeCapture
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.mission.trajectory.view_schedule import ViewSchedule
from uav_recon.types.trajectory import Trajectory


@pytest.fixture()
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.journal.close()


class CaptureCase:
    """A vehicle that hovers at x_m while its trajectory, with a view at 10.5 s, hovers over the pad."""

    def __init__(self, desk: Desk, x_m: float = 0.0, views: int = 1) -> None:
        self.log, schedule, track = MissionLog(desk.journal, views), ViewSchedule(), FlightTrack(0.0)
        still, flat = np.zeros((2, 3)), np.zeros(2)
        track.trajectory = Trajectory(10.0, 1.0, still, still, still, flat, flat, flat, np.array([0.5]), 0, 1)
        track.position_world = np.array([x_m, 0.0, 0.0])
        schedule.expect(track.trajectory, 10.0)
        self.keyframes = KeyframeCapture(desk.stages, schedule, track, self.log)


def test_a_planned_view_is_captured_once(desk: Desk) -> None:
    case = CaptureCase(desk, views=3)
    for stamp_s in (10.4, 10.5, 10.6):
        case.keyframes.capture(10.7, posed_frame(stamp_s), surveying=False)
    assert desk.mapper.stamps == [10.5]
    assert case.log.views == 1


def test_no_view_is_captured_off_the_track(desk: Desk) -> None:
    case = CaptureCase(desk, x_m=2.0)
    case.keyframes.capture(10.7, posed_frame(10.5), surveying=False)
    assert desk.mapper.stamps == []


def test_other_frames_are_weighed_while_surveying(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    case = CaptureCase(desk, views=2)
    monkeypatch.setattr(desk.budget, "selects", lambda posed, views_left, explored: views_left == 2)
    case.keyframes.capture(10.2, posed_frame(10.1), surveying=False)
    assert desk.mapper.stamps == []
    for stamp_s in (10.2, 10.3):
        case.keyframes.capture(10.4, posed_frame(stamp_s), surveying=True)
    assert desk.mapper.stamps == [10.2]


def test_the_budget_of_views_is_kept(desk: Desk) -> None:
    case = CaptureCase(desk, views=0)
    case.keyframes.capture(10.7, posed_frame(10.5), surveying=True)
    assert desk.mapper.stamps == [] and case.log.views == 0


def test_a_frame_that_shows_something_that_moves_is_no_view_and_a_planned_one_waits(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = CaptureCase(desk, views=3)
    monkeypatch.setattr(desk.budget, "selects", lambda posed, views_left, explored: True)
    for stamp_s, moves in ((10.4, True), (10.6, True), (10.8, False)):
        monkeypatch.setattr(desk.voxels, "shows_motion", moves)
        case.keyframes.capture(stamp_s, posed_frame(stamp_s), surveying=True)
    assert desk.mapper.stamps == [10.8]
