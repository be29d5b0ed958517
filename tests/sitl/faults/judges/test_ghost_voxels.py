"""A body moved along a row of voxels, beside a wall."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.faults.judges.ghost_voxels import ghost_voxels, hole_voxels
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, GridSpec, VoxelMap

GRID = GridSpec(np.zeros(3), 0.1, (30, 10, 10))
HALF_M = (0.1, 0.1, 0.4)
WALK = np.array([[x, 0.45, 0.45] for x in np.arange(0.5, 2.5, 0.05)])
WALL = np.array([[2.0, y, z] for z in np.arange(0.0, 1.0, 0.02) for y in (0.0, 0.45, 1.0)], np.float32)
NONE = np.zeros((0, 3), np.float32)


def _known(*occupied: tuple[int, int, int], rest: int = FREE) -> VoxelMap:
    state: NDArray[np.uint8] = np.full(GRID.shape, rest, np.uint8)
    for index in occupied:
        state[index] = OCCUPIED
    return VoxelMap.whole(GRID, state, np.zeros(GRID.shape, np.uint8), 1)


def test_only_what_the_body_swept_is_left_of_it() -> None:
    known = _known((10, 4, 4), (10, 8, 4), (10, 4, 9), (2, 4, 4))
    assert ghost_voxels(known, None, WALK, HALF_M, NONE) == 1


def test_the_true_surface_is_not_left_of_it() -> None:
    known = _known((17, 4, 4), (18, 4, 4), (20, 4, 4), (23, 4, 4))
    scene = np.concatenate([WALL, WALL - np.array([2.0, 0.0, 0.0], np.float32)])
    assert ghost_voxels(known, None, WALK, HALF_M, scene) == 1, (
        "0.25 m from the wall; the next one is 0.15 m off, the last outside"
    )


def test_what_was_occupied_before_is_not_left_of_it() -> None:
    before = _known((10, 4, 4)).state
    assert ghost_voxels(_known((10, 4, 4), (11, 4, 4)), before, WALK, HALF_M, NONE) == 1


def test_unknown_voxels_that_were_known_before_are_holes() -> None:
    nowhere = _known(rest=UNKNOWN)
    assert hole_voxels(nowhere, nowhere.state, WALK, HALF_M, NONE) == 0
    assert hole_voxels(nowhere, _known().state, WALK, HALF_M, NONE) > 100
