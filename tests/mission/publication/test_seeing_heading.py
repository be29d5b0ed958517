"""The heading in which the camera shows the place, for the pilot: sought again and again, where there is a map of it."""

from __future__ import annotations

import math

from uav_recon.mission.publication.seeing_heading import SeeingHeading
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.types.camera import PosedFrame
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.pose import Pose


class Marks:
    """Shows the place to the north-west only. asked: how often."""

    cells = SurfaceCells.none(0.2)

    def __init__(self) -> None:
        self.asked = 0

    def add(self, posed: PosedFrame) -> bool:
        return False

    def sigma_m(self, world_from_body: Pose, pitch_down_rad: float) -> float:
        return 1.0

    def seeing_yaw_rad(self, world_from_body: Pose, pitch_down_rad: float) -> float | None:
        self.asked += 1
        assert pitch_down_rad == 0.26
        return 2.5 if self.asked < 4 else None


def test_it_is_sought_again_and_again() -> None:
    marks = Marks()
    heading = SeeingHeading(marks, FlightTrack(0.26), 0.26)
    assert [heading.yaw_rad(0.1 * n) for n in range(9)] == [2.5] * 9
    assert marks.asked == 3
    assert heading.yaw_rad(1.0) is None


def test_there_is_none_where_the_place_does_not_depend_on_the_view() -> None:
    assert SeeingHeading(None, FlightTrack(0.26), 0.26).yaw_rad(math.pi) is None
