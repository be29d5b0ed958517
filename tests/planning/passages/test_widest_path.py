"""The widest path, by an independent search: threshold and connected parts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import ndimage

from uav_recon.planning.passages.widest_path import straightened, widest_path
from uav_recon.types.maps import FREE, GridSpec, VoxelMap

ALL_HEIGHTS_M = np.array([-10.0, 10.0])


def random_map(seed: int) -> VoxelMap:
    rng = np.random.default_rng(seed)
    free = rng.random((30, 28, 16)) < 0.97
    distance = np.minimum(ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1, 1:-1], 15.0)
    state = np.where(free, FREE, 0).astype(np.uint8)
    grid = GridSpec(np.array([1.0, -2.0, 0.5]), 0.025, (30, 28, 16))
    return VoxelMap.whole(grid, state, np.round(distance**2).astype(np.uint8), 1)


@pytest.mark.parametrize("seed", range(10))
def test_no_path_is_wider(seed: int) -> None:
    fine = random_map(seed)
    begin, end = fine.grid.centre(np.array([4, 5, 6])), fine.grid.centre(np.array([25, 22, 9]))
    path, clearance_m = widest_path(fine, begin, end, 0.06, ALL_HEIGHTS_M)
    cells = fine.grid.index(path)
    assert np.abs(np.diff(cells, axis=0)).max() == 1
    assert np.linalg.norm(path[0] - begin) <= 0.06 and np.linalg.norm(path[-1] - end) <= 0.06
    least2 = fine.distance2[tuple(cells.T)].min()
    assert clearance_m == pytest.approx(np.sqrt(float(least2)) * 0.025)
    centres = fine.grid.centre(np.stack(np.meshgrid(*map(np.arange, fine.grid.shape), indexing="ij"), axis=-1))
    near = [np.linalg.norm(centres - place, axis=-1) <= 0.06 for place in (begin, end)]
    labels, _ = ndimage.label(fine.distance2 > least2, structure=np.ones((3, 3, 3)))
    assert not set(labels[near[0]].tolist()) & set(labels[near[1]].tolist()) - {0}
    corners = straightened(fine, path, clearance_m)
    np.testing.assert_array_equal(corners[[0, -1]], path[[0, -1]])
    for a, b in itertools.pairwise(corners):
        line = fine.grid.index(np.linspace(a, b, 40))
        assert np.abs(np.diff(fine.grid.index(np.array([a, b])), axis=0)).max() <= 1 or (
            fine.distance2[tuple(line.T)].min() >= (np.sqrt(float(least2)) - 0.5) ** 2
        )


def test_heights_bound_the_path_and_a_wall_ends_it() -> None:
    fine = random_map(3)
    begin, end = fine.grid.centre(np.array([4, 5, 6])), fine.grid.centre(np.array([25, 22, 6]))
    heights_m = 0.5 + np.array([4, 8]) * 0.025
    path, _ = widest_path(fine, begin, end, 0.06, heights_m)
    assert len(path) and heights_m[0] <= path[:, 2].min() and path[:, 2].max() <= heights_m[1]
    walled = fine.distance2.copy()
    walled[15] = 0
    closed = VoxelMap.whole(fine.grid, fine.state, walled, 2)
    path, clearance_m = widest_path(closed, begin, end, 0.06, ALL_HEIGHTS_M)
    assert len(path) == 0 and clearance_m == 0.0
