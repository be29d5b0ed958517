"""A view promised by a trajectory is met by the first frame at or after its instant."""

from __future__ import annotations

import numpy as np

from uav_recon.mission.trajectory.view_schedule import ViewSchedule
from uav_recon.types.trajectory import Trajectory


def trajectory(views_s: list[float], start_s: float = 10.0) -> Trajectory:
    zeros, flat = np.zeros((2, 3)), np.zeros(2)
    return Trajectory(start_s, 1.0, zeros, zeros, zeros, flat, flat, flat, np.array(views_s), 0, 1)


def test_the_first_frame_after_the_instant_is_the_view() -> None:
    schedule = ViewSchedule(late_s=0.5)
    schedule.expect(trajectory([1.0, 2.0]), 10.0)
    assert [schedule.take(s) for s in (10.9, 11.05, 11.15, 12.0)] == [False, True, False, True]


def test_one_frame_serves_two_instants_between_frames() -> None:
    schedule = ViewSchedule(late_s=0.5)
    schedule.expect(trajectory([1.0, 1.02]), 10.0)
    assert schedule.take(11.1)
    assert not schedule.take(11.2)


def test_a_view_that_no_frame_met_is_given_up() -> None:
    schedule = ViewSchedule(late_s=0.5)
    schedule.expect(trajectory([1.0]), 10.0)
    assert schedule.waiting(11.4)
    assert not schedule.waiting(11.6)


def test_a_stopped_trajectory_promises_no_later_views() -> None:
    schedule = ViewSchedule(late_s=0.5)
    schedule.expect(trajectory([1.0, 2.0]), 10.0)
    schedule.cancel_after(11.5)
    assert schedule.take(11.2)
    assert not schedule.take(12.1)


def test_a_way_left_in_motion_keeps_the_views_before_the_parting() -> None:
    schedule = ViewSchedule(late_s=0.5)
    schedule.expect(trajectory([1.0, 2.0, 3.0]), 10.0)
    schedule.expect(trajectory([0.9], start_s=12.0), 12.5)
    assert [schedule.take(s) for s in (11.0, 12.0, 12.6, 12.9, 13.0, 13.1)] == [True, True, False, True, False, False]
