"""Flight through an opening that only a fine map shows to be wide enough."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hall import CONFIG, straight
from scipy.ndimage import distance_transform_edt

from uav_recon.motion import MotionPlanner
from uav_recon.motion.trajectory_generation import PASSAGE_MPS
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.trajectory import Setpoint, Trajectory

MOTION = MotionPlanner(CONFIG, 0.4, passage_m=0.295)
MIDDLE_M = 0.013


def map_of(width_m: float, origin: list[float], resolution_m: float, shape: tuple[int, int, int], reach: float) -> VoxelMap:
    """Return a map of a wall at x of 1 to 1.1 m with an opening. A voxel that is partly in the wall is occupied."""
    grid = GridSpec(np.array(origin), resolution_m, shape)
    x, y = (grid.origin_world_m[axis] + resolution_m * (np.arange(shape[axis]) + 0.5) for axis in (0, 1))
    half_m = resolution_m / 2 - 1e-6
    wall = (x > 1.0 - half_m) & (x < 1.1 + half_m)
    closed = np.abs(y - MIDDLE_M) > width_m / 2 - half_m
    state = np.full(shape, FREE, dtype=np.uint8)
    state[np.ix_(wall, closed)] = OCCUPIED
    distance = np.minimum(distance_transform_edt(np.pad(state == FREE, 1))[1:-1, 1:-1, 1:-1], reach)
    return VoxelMap.whole(grid, state, np.round(distance**2).astype(np.uint8), 1)


def opening(width_m: float) -> VoxelMap:
    """Return the map with a fine map of the opening in it."""
    fine = map_of(width_m, [0.05, -1.0, 0.9], 0.025, (80, 80, 48), 15.0)
    return dataclasses.replace(map_of(width_m, [-3.0, -3.0, 0.0], 0.1, (80, 60, 30), 11.0), fine=(fine,))


def through(voxels: VoxelMap, aside_m: float = 0.0) -> Trajectory | Reason:
    path = straight([-1.0, 0.3, 1.5], [0.6, MIDDLE_M + aside_m, 1.5], [1.5, MIDDLE_M + aside_m, 1.5], [3.0, -0.5, 1.5])
    return MOTION.plan_from_rest(path, voxels, Setpoint.hold(np.array([-1.0, 0.3, 1.5]), 0.0), 5.0, np.inf, 1)


@pytest.mark.parametrize("width_m", [0.66, 0.7, 0.8])
def test_it_is_flown_slowly_and_in_its_middle(width_m: float) -> None:
    flown = through(opening(width_m), aside_m=0.03)
    assert isinstance(flown, Trajectory), flown
    inside = np.abs(flown.position_m[:, 0] - 1.05) < 0.1
    assert np.linalg.norm(flown.velocity_mps[inside], axis=1).max() <= PASSAGE_MPS + 1e-3
    assert np.abs(flown.position_m[inside, 1] - MIDDLE_M).max() <= max(width_m / 2 - 0.2 - 0.1, 0.03)
    assert np.linalg.norm(flown.velocity_mps, axis=1).max() > 0.5  # and the open before it is not slow


@pytest.mark.parametrize("width_m", [0.5, 0.55])
def test_a_narrower_one_is_refused(width_m: float) -> None:
    assert isinstance(through(opening(width_m)), Reason)


def test_without_its_fine_map_it_is_refused() -> None:
    assert isinstance(through(dataclasses.replace(opening(0.8), fine=())), Reason)


def test_a_motion_through_it_is_blocked_when_it_closes() -> None:
    voxels = opening(0.8)
    flown = through(voxels)
    assert isinstance(flown, Trajectory)
    assert MOTION.is_still_clear(flown, 5.0, voxels)
    assert not MOTION.is_still_clear(flown, 5.0, opening(0.5))
