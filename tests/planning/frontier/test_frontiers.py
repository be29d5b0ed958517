from __future__ import annotations

import numpy as np
from box_world import grid_of, voxel_map

from uav_recon.planning.frontier.frontiers import FACES, Frontiers, fence_box
from uav_recon.planning.frontier.rejection_counts import count_rejected_frontiers
from uav_recon.types.frames import ByteArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, GridSpec
from uav_recon.types.reason_code import ReasonCode

WHOLE = np.zeros(3, dtype=np.int64)


def frontiers_of(state: ByteArray, low: IntArray, high: IntArray, exhausted: ByteArray | None = None) -> Frontiers:
    found = Frontiers()
    found.update(voxel_map(state), low, high, np.zeros_like(state) if exhausted is None else exhausted)
    return found


def test_a_frontier_is_a_free_voxel_with_an_unknown_face_neighbour_inside_the_fence() -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        state = rng.choice([UNKNOWN, FREE, FREE, OCCUPIED], tuple(rng.integers(3, 9, 3))).astype(np.uint8)
        low, high = rng.integers(0, 2, 3), np.array(state.shape) - rng.integers(0, 2, 3)
        faces = frontiers_of(state, low, high).faces
        for cell in np.ndindex(*state.shape):
            inside = bool((np.array(cell) >= low).all() and (np.array(cell) < high).all())
            for bit, step in enumerate(FACES):
                other = np.array(cell) + step
                expected = (
                    inside
                    and state[cell] == FREE
                    and bool((other >= low).all() and (other < high).all())
                    and state[tuple(other)] == UNKNOWN
                )
                assert bool(faces[cell] & (1 << bit)) == expected


def test_rejected_frontiers_are_counted_by_reason() -> None:
    state = np.full((40, 20, 20), FREE, dtype=np.uint8)
    state[0, 2:6, 2:6] = UNKNOWN  # 16 cells: a frontier
    state[39, 2, 2] = UNKNOWN  # too small (one cell with three neighbours, two beside it)
    state[20, 19, 2:14] = UNKNOWN  # looked at without success
    exhausted = np.zeros(state.shape, dtype=np.uint8)
    exhausted[18:23, 17:] = 1
    found = frontiers_of(state, WHOLE, np.array(state.shape), exhausted)
    assert len(found) == 1
    counts = count_rejected_frontiers(state, found.faces, exhausted)
    assert counts == {
        ReasonCode.FRONTIERS_TOO_SMALL: 1,
        ReasonCode.FRONTIERS_VIEWED_WITHOUT_RESULT: 1,
        ReasonCode.FRONTIERS_OUTSIDE_FENCE: 0,
    }


def test_space_beyond_the_fence_is_counted_not_explored() -> None:
    state = np.full((20, 20, 20), FREE, dtype=np.uint8)
    state[15:] = UNKNOWN
    found = frontiers_of(state, WHOLE, np.array([15, 20, 20]))
    assert not found.faces.any()
    assert count_rejected_frontiers(state, found.faces, np.zeros_like(state))[ReasonCode.FRONTIERS_OUTSIDE_FENCE] == 1


def test_the_fence_contains_the_voxels_whose_centres_it_contains() -> None:
    grid = GridSpec(np.array([-0.3, -0.3, -0.3]), 0.1, (30, 30, 30))
    low, high = fence_box(grid, np.array([0.0, 0.04, -9.0]), np.array([1.0, 1.06, 9.0]))
    assert low.tolist() == [3, 3, 0]
    assert high.tolist() == [13, 14, 30]
    centres = grid.centre(np.stack([low, high - 1]))
    assert (centres[:, :2] >= [0.0, 0.04]).all()
    assert (centres[:, :2] <= [1.0, 1.06]).all()
    assert grid_of(np.zeros((3, 3, 3), dtype=np.bool_)).shape == (3, 3, 3)
