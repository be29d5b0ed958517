"""An autopilot that hears nothing any more flies on for a second: the way has room for it."""

from __future__ import annotations

import numpy as np
import pytest
from hall import CLEARANCE_M, CONFIG, HALL, paths, room, room_around, straight, wall
from hypothesis import given, settings

from uav_recon.motion import MotionPlanner
from uav_recon.motion.bounds import RUN_ON_MPS, run_on_m
from uav_recon.types.maps import VoxelMap
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Setpoint, Trajectory

HULL_M = 0.20
MOTION = MotionPlanner(CONFIG, CLEARANCE_M, hull_m=HULL_M)
HEEDLESS = MotionPlanner(CONFIG.model_copy(update={"run_on_s": 0.0}), CLEARANCE_M, hull_m=HULL_M)
BEFORE_A_WALL = room(wall([3.0, -5.0, 0.0], [3.1, 5.0, 3.0]))
SMOOTHING_MPS = 0.12  # of what is 0.2 s before and behind


def flown(path: ViewPath, voxels: VoxelMap, motion: MotionPlanner = MOTION) -> Trajectory:
    trajectory = motion.through(path, voxels, Setpoint.hold(path.waypoints_world[0][0], 0.0), 5.0, 0.4, 7)
    assert isinstance(trajectory, Trajectory), trajectory
    return trajectory


def too_fast_mps(trajectory: Trajectory, voxels: VoxelMap) -> float:
    """By how much any sample is faster than what the straight way on from there has room for, by brute force."""
    worst_mps = 0.0
    for place, velocity in zip(trajectory.position_m[::8], trajectory.velocity_mps[::8], strict=True):
        speed = float(np.linalg.norm(velocity))
        if speed <= RUN_ON_MPS:
            continue
        ahead_m = np.arange(0.0, 3.0, 0.02)
        met = np.flatnonzero(room_around(place + ahead_m[:, None] * velocity / speed, voxels) <= HULL_M + 0.05)
        way_m = float(ahead_m[met[0]]) if len(met) else np.inf
        speeds = np.linspace(RUN_ON_MPS, speed, 50)
        most = max((v for v in speeds if run_on_m(float(v), CONFIG.run_on_s) <= way_m), default=RUN_ON_MPS)
        worst_mps = max(worst_mps, speed - float(most))
    return worst_mps


def test_a_wall_is_flown_towards_with_room_for_a_second_of_silence() -> None:
    path = straight([-3.0, 0.0, 1.2], [2.5, 0.0, 1.2])
    assert too_fast_mps(flown(path, BEFORE_A_WALL, HEEDLESS), BEFORE_A_WALL) > 0.3, "without it"
    trajectory = flown(path, BEFORE_A_WALL)
    assert too_fast_mps(trajectory, BEFORE_A_WALL) <= SMOOTHING_MPS
    assert np.linalg.norm(trajectory.velocity_mps, axis=1).max() > 0.9, "in the open as fast as ever"


def test_what_lies_beside_the_way_and_behind_it_slows_nothing() -> None:
    beside = room(wall([-5.0, 0.7, 0.0], [5.0, 0.8, 3.0]), wall([-3.7, -5.0, 0.0], [-3.6, 5.0, 3.0]))
    path = straight([-3.0, 0.0, 1.2], [2.5, 0.0, 1.2])
    assert flown(path, beside).duration_s == pytest.approx(flown(path, beside, HEEDLESS).duration_s)


@settings(max_examples=40, deadline=None)
@given(path=paths())
def test_no_way_is_flown_any_faster(path: ViewPath) -> None:
    assert too_fast_mps(flown(path, HALL), HALL) <= 2 * SMOOTHING_MPS
