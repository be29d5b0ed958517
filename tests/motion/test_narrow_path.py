"""A path that says what its way keeps is held to that: when it is planned, and against every newer map."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hall import MOTION, room, room_around, straight, wall

from uav_recon.motion.motion_planner import NARROW_MPS
from uav_recon.motion.time_scaling import joined
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Setpoint, Trajectory

ROOM_M = 0.2  # in the middle of a gap of three voxels, to the centres of those beside it
SIDES = (wall([1.0, -5.0, 0.0], [1.2, 0.0, 3.0]), wall([1.0, 0.3, 0.0], [1.2, 5.0, 3.0]))
GAP = room(*SIDES)
CLOSER = room(*SIDES, wall([1.0, 0.0, 0.0], [1.2, 0.1, 3.0]))
MIDDLE_M = 0.15


def at(x_m: float) -> Setpoint:
    return Setpoint.hold(np.array([x_m, MIDDLE_M, 1.5]), 0.0)


def narrow(clearance_m: float | None = ROOM_M) -> ViewPath:
    path = straight([-1.0, MIDDLE_M, 1.5], [3.0, MIDDLE_M, 1.5])
    return dataclasses.replace(path, clearance_m=clearance_m)


def through_the_gap() -> Trajectory:
    trajectory = MOTION.plan_from_rest(narrow(), GAP, at(-1.0), 5.0, np.inf, 1)
    assert isinstance(trajectory, Trajectory), trajectory
    return trajectory


def test_a_gap_is_passed_by_who_asks_for_no_more_and_by_nobody_else() -> None:
    trajectory = through_the_gap()
    assert trajectory.clearance_m == ROOM_M
    assert room_around(trajectory.position_m, GAP).min() >= ROOM_M - 0.011
    for clearance_m in (None, ROOM_M + 0.05):
        blocked = MOTION.plan_from_rest(narrow(clearance_m), GAP, at(-1.0), 5.0, np.inf, 1)
        assert isinstance(blocked, Reason)
        assert blocked.code is ReasonCode.PATH_CLEARANCE


def test_it_stays_clear_by_its_own_measure_until_the_map_takes_that_away() -> None:
    trajectory = through_the_gap()
    assert MOTION.is_still_clear(trajectory, 5.0, GAP)
    assert not MOTION.is_still_clear(dataclasses.replace(trajectory, clearance_m=None), 5.0, GAP)
    assert not MOTION.is_still_clear(trajectory, 5.0, CLOSER)


@pytest.mark.parametrize("leave_s", [5.0, 6.5, 1e3], ids=["at rest", "in motion", "past the end"])
def test_a_motion_that_is_left_for_a_narrow_path_is_held_to_that(leave_s: float) -> None:
    begun = MOTION.plan_from_rest(straight([-3.0, MIDDLE_M, 1.5], [-1.0, MIDDLE_M, 1.5]), GAP, at(-3.0), 5.0, np.inf, 1)
    assert isinstance(begun, Trajectory) and begun.clearance_m == 0.35
    here = begun.setpoint_at(leave_s).position_m
    path = dataclasses.replace(straight(here.tolist(), [3.0, MIDDLE_M, 1.5]), clearance_m=ROOM_M)
    left = MOTION.plan_from_motion(path, GAP, begun, leave_s, np.inf, 2)
    assert isinstance(left, Trajectory) and left.clearance_m == ROOM_M
    assert isinstance(
        MOTION.plan_from_motion(dataclasses.replace(path, clearance_m=None), GAP, begun, leave_s, np.inf, 2), Reason
    )


def test_what_is_made_of_a_narrow_motion_keeps_its_measure() -> None:
    trajectory = through_the_gap()
    braked = MOTION.plan_stop(trajectory, 7.0, 2)
    assert braked.clearance_m == ROOM_M
    usual = dataclasses.replace(trajectory, clearance_m=None)
    assert joined(usual, 100, braked, trajectory).clearance_m == ROOM_M


def test_a_narrow_place_is_passed_slowly_and_the_open_before_it_is_not() -> None:
    trajectory = through_the_gap()
    speed, inside = np.linalg.norm(trajectory.velocity_mps, axis=1), np.abs(trajectory.position_m[:, 0] - 1.1) < 0.2
    assert speed[inside].max() <= NARROW_MPS + 1e-3
    assert speed.max() > 0.5
    usual = MOTION.plan_from_rest(narrow(None), room(), at(-1.0), 5.0, np.inf, 1)
    assert isinstance(usual, Trajectory) and np.linalg.norm(usual.velocity_mps, axis=1).max() > 0.5


@pytest.mark.parametrize("aside_m", [-0.045, 0.045])
def test_a_way_along_the_side_of_a_gap_is_flown_in_its_middle(aside_m: float) -> None:
    path = dataclasses.replace(straight([-1.0, MIDDLE_M + aside_m, 1.5], [3.0, MIDDLE_M + aside_m, 1.5]), clearance_m=0.15)
    start = Setpoint.hold(np.array([-1.0, MIDDLE_M + aside_m, 1.5]), 0.0)
    flown = MOTION.plan_from_rest(path, GAP, start, 5.0, np.inf, 1)
    assert isinstance(flown, Trajectory), flown
    inside = np.abs(flown.position_m[:, 0] - 1.1) < 0.1
    assert np.abs(flown.position_m[inside, 1] - MIDDLE_M).max() <= 0.02
    np.testing.assert_allclose(flown.position_m[-1], [3.0, MIDDLE_M + aside_m, 1.5], atol=1e-6)


@pytest.mark.parametrize("aside_m", [-0.1, 0.1])
def test_in_a_wider_one_it_keeps_more_than_usual_where_there_is_so_much(aside_m: float) -> None:
    wide = room(wall([1.0, -5.0, 0.0], [2.0, -0.3, 3.0]), wall([1.0, 0.6, 0.0], [2.0, 5.0, 3.0]))
    path = dataclasses.replace(straight([-1.0, MIDDLE_M + aside_m, 1.5], [4.0, MIDDLE_M + aside_m, 1.5]), clearance_m=0.35)
    flown = MOTION.plan_from_rest(path, wide, Setpoint.hold(np.array([-1.0, MIDDLE_M + aside_m, 1.5]), 0.0), 5.0, np.inf, 1)
    assert isinstance(flown, Trajectory), flown
    inside = np.abs(flown.position_m[:, 0] - 1.5) < 0.5
    assert np.abs(flown.position_m[inside, 1] - MIDDLE_M).max() <= 0.06
