"""Unknown volume beyond a frontier, against a count face by face; openings rank before gaps."""

from __future__ import annotations

import numpy as np
from box_world import voxel_map

from uav_recon.planning.frontier.cluster_table import FARTHER, OPENING
from uav_recon.planning.frontier.frontiers import FACES, Frontiers
from uav_recon.planning.frontier.unknown_volume import DEPTH, SHALLOW, unknown_volume
from uav_recon.types.frames import ByteArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN


def counted(state: ByteArray, cells: IntArray, low: IntArray, high: IntArray) -> int:
    """Count the unknown voxels beyond the cells (N, 3)."""
    total = 0
    for cell in cells:
        for step in FACES:
            for n in range(1, DEPTH + 1):
                at = cell + n * step
                if (at < low).any() or (at >= high).any() or state[tuple(at)] != UNKNOWN:
                    break
                total += n > SHALLOW
    return total


def test_unknown_voxels_straight_behind_each_unknown_face_are_counted() -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        shape = tuple(rng.integers(6, 24, 3))
        state = rng.choice([UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, FREE, OCCUPIED], shape).astype(np.uint8)
        low, high = rng.integers(0, 3, 3), np.array(shape) - rng.integers(0, 3, 3)
        frontiers = Frontiers()
        frontiers.update(voxel_map(state), low, high, np.zeros_like(state))
        for cluster in frontiers.clusters():
            flat = np.ravel_multi_index(tuple(cluster.cells.T), shape)
            assert unknown_volume(state, frontiers.faces, flat, low, high) == counted(state, cluster.cells, low, high)


def test_a_gap_in_front_of_a_wall_ranks_after_nearby_openings() -> None:
    state = np.full((260, 24, 9), OCCUPIED, dtype=np.uint8)
    state[1:-1, 10:14, 1:8] = FREE  # a corridor along x
    gap_x, near_x, far_x = 20, 66, 162
    for x, deep in ((gap_x, 1), (near_x, DEPTH), (far_x, DEPTH)):
        state[x : x + 6, 14 : 14 + deep, 2:7] = UNKNOWN
    frontiers = Frontiers()
    frontiers.update(voxel_map(state), np.zeros(3, dtype=np.int64), np.array(state.shape), np.zeros_like(state))
    table = frontiers.table
    rows = table.nearest(np.array([gap_x + 3.0, 12.0, 4.0]), 10)
    assert [round(float(x)) for x in table.rows.centre[rows, 0]] == [near_x + 3, gap_x + 3, far_x + 3]
    assert table.rows.beyond[rows].tolist() == [30 * (DEPTH - SHALLOW), 0, 30 * (DEPTH - SHALLOW)]
    assert 0 < OPENING < 30 * (DEPTH - SHALLOW)
    assert near_x - gap_x < FARTHER < far_x - gap_x
