from __future__ import annotations

import numpy as np
from hall import room_around, voxel_map
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.motion.clearance import ClearanceMap, blocked, clearances_at
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, OCCUPIED

NO_BOX = (np.full(3, -np.inf), np.full(3, np.inf), 0.0)


def rooms_at(space: ClearanceMap, points: FloatArray) -> FloatArray:
    out = np.empty(len(points))
    clearances_at(space, points, out)
    return out


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_room_is_the_distance_but_for_the_voxels(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = np.where(rng.random((30, 25, 20)) < 0.004, OCCUPIED, FREE)
    voxels = voxel_map(state)
    points = rng.uniform([-5.2, -5.2, -0.2], [-1.8, -2.3, 2.2], (400, 3))
    found, true = rooms_at(ClearanceMap.of(voxels, *NO_BOX), points), room_around(points, voxels)
    index = voxels.grid.index(points)
    inside = voxels.grid.contains(index)
    i, j, k = np.where(inside[:, None], index, 0).T
    free = inside & (voxels.state[i, j, k] == FREE)
    assert np.all(found[~free] == 0.0) and np.all(found[free] > 0.0)
    near = free & (true < 0.9)  # the field saturates at 1.1 m
    assert np.all(np.abs(found[near] - true[near]) <= 0.088)  # half a voxel's diagonal


def test_nothing_is_blocked_in_the_open_and_everything_is_in_a_wall() -> None:
    state = np.full((40, 40, 20), FREE)
    state[20:22] = OCCUPIED
    space = ClearanceMap.of(voxel_map(state), *NO_BOX)
    way = np.column_stack([np.linspace(-4.4, -1.6, 200), np.full(200, -3.0), np.ones(200)])
    bad = blocked(space, way, 0, 0.3)
    assert way[bad, 0].min() > -3.35 and way[bad, 0].max() <= -2.5
    assert bad[np.abs(way[:, 0] + 2.9) < 0.1].any()
    assert not blocked(space, way[:60], 0, 0.3).any()
    assert not blocked(space, way, 170, 0.3).any()


def test_the_border_of_the_box_counts_as_a_border() -> None:
    voxels = voxel_map(np.full((30, 30, 30), float(FREE)))
    low = voxels.grid.origin_world_m + 1.0
    space = ClearanceMap.of(voxels, low, low + 1.2, 0.35)
    points = low + np.array([[0.0, 0.6, 0.6], [-0.02, 0.6, 0.6], [0.1, 0.6, 0.6], [0.6, 0.6, 1.25], [-0.9, 0.6, 0.6]])
    np.testing.assert_allclose(rooms_at(space, points)[:4], [0.35, 0.33, 0.45, 0.30], atol=1e-9)
    assert 0.0 < rooms_at(space, points)[4] < 1e-3  # free, and far outside
    way = np.column_stack([np.linspace(low[0] + 0.6, low[0] - 0.2, 100), np.full((100, 2), low[1] + 0.6)])
    outside = blocked(space, way, 0, 0.34)
    assert outside[-1] and way[np.argmax(outside), 0] >= low[0] - 0.04


def test_a_motion_out_of_a_tight_spot_leads_no_deeper_into_it() -> None:
    state = np.full((40, 40, 20), FREE)
    state[20:22] = OCCUPIED
    space = ClearanceMap.of(voxel_map(state), *NO_BOX)
    out = np.column_stack([np.linspace(-3.2, -4.4, 120), np.full(120, -3.0), np.ones(120)])
    deeper = np.vstack([np.column_stack([np.linspace(-3.2, -3.1, 11), np.full(11, -3.0), np.ones(11)]), out - [-0.1, 0.0, 0.0]])
    assert rooms_at(space, out[:1])[0] < 0.3
    assert not blocked(space, out, 0, 0.3).any()
    bad = blocked(space, deeper, 0, 0.3)
    assert bad.any() and deeper[bad, 0].min() > -3.18
