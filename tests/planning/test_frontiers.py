from __future__ import annotations

import numpy as np
from box_world import grid_of

from uav_recon.planning.clusters import MAX_EXTENT_M
from uav_recon.planning.frontiers import FACES, count_outside, fence_box, find_frontiers, split, unknown_faces
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, GridSpec

WHOLE = np.zeros(3, dtype=np.int64)


def test_a_frontier_is_a_free_voxel_with_an_unknown_face_neighbour_inside_the_fence() -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        state = rng.choice([UNKNOWN, FREE, FREE, OCCUPIED], tuple(rng.integers(3, 9, 3))).astype(np.uint8)
        low, high = rng.integers(0, 2, 3), np.array(state.shape) - rng.integers(0, 2, 3)
        faces = unknown_faces(state, low, high)
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


def test_clusters_are_split_until_they_fit_one_view_and_no_cell_is_lost() -> None:
    rng = np.random.default_rng(1)
    cells = np.unique(rng.integers(0, (45, 45, 1), (600, 3)), axis=0)
    parts = split(cells, MAX_EXTENT_M / 0.1)
    assert sorted(map(tuple, np.concatenate(parts))) == sorted(map(tuple, cells))
    for part in parts:
        offsets = part - part.mean(axis=0)
        along = offsets @ np.linalg.svd(offsets, full_matrices=False)[2][0]
        assert np.ptp(along) <= MAX_EXTENT_M / 0.1 + 1e-9


def test_the_census_counts_what_it_leaves_out() -> None:
    state = np.full((40, 20, 20), FREE, dtype=np.uint8)
    state[0, 2:6, 2:6] = UNKNOWN  # 16 cells: a frontier
    state[39, 2, 2] = UNKNOWN  # too small (one cell with three neighbours, two beside it)
    state[20, 19, 2:14] = UNKNOWN  # looked at in vain
    faces = unknown_faces(state, WHOLE, np.array(state.shape))
    exhausted = np.zeros(state.shape, dtype=np.bool_)
    exhausted[18:23, 17:] = True
    census = find_frontiers(faces, exhausted, 0.1)
    assert (len(census.frontiers), census.too_small, census.exhausted) == (1, 1, 1)


def test_space_beyond_the_fence_is_counted_not_explored() -> None:
    state = np.full((20, 20, 20), FREE, dtype=np.uint8)
    state[15:] = UNKNOWN
    faces = unknown_faces(state, WHOLE, np.array([15, 20, 20]))
    assert not faces.any()
    assert count_outside(state, faces) == 1


def test_the_fence_holds_the_voxels_whose_centres_it_holds() -> None:
    grid = GridSpec(np.array([-0.3, -0.3, -0.3]), 0.1, (30, 30, 30))
    low, high = fence_box(grid, np.array([0.0, 0.04, -9.0]), np.array([1.0, 1.06, 9.0]))
    assert low.tolist() == [3, 3, 0]
    assert high.tolist() == [13, 14, 30]
    centres = grid.centre(np.stack([low, high - 1]))
    assert (centres[:, :2] >= [0.0, 0.04]).all()
    assert (centres[:, :2] <= [1.0, 1.06]).all()
    assert grid_of(np.zeros((3, 3, 3), dtype=np.bool_)).shape == (3, 3, 3)
