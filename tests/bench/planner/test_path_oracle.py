import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from uav_recon.bench.planner import path_oracle
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, VoxelMap


def test_an_open_line_gives_a_straight_path() -> None:
    mask = np.ones((20, 20, 8), dtype=bool)
    way = path_oracle.shortest_path(mask, np.array([1, 2, 3]), np.array([17, 9, 6]))
    np.testing.assert_allclose(way, [[1.5, 2.5, 3.5], [17.5, 9.5, 6.5]])
    np.testing.assert_allclose(path_oracle.length_of(way), np.sqrt(16**2 + 7**2 + 3**2))


def test_a_path_around_a_wall_touches_the_edge() -> None:
    mask = np.ones((21, 20, 3), dtype=bool)
    mask[10, :15] = False
    way = path_oracle.shortest_path(mask, np.array([5, 2, 1]), np.array([15, 2, 1]))
    # between cell centres: up to (9, 14), by a diagonal step around the wall's end (10, 15), and down from (11, 14)
    np.testing.assert_allclose(path_oracle.length_of(way), 2 * np.hypot(4.0, 12.0) + 2 * np.sqrt(2.0))
    assert mask[tuple(np.floor(way).astype(int).T)].all()


def test_the_path_is_at_most_as_long_as_the_exact_grid_path() -> None:
    rng = np.random.default_rng(4)
    mask = rng.random((7, 6, 5)) > 0.35
    cells = np.argwhere(mask)
    apart = np.abs(cells[:, None] - cells[None]).max(axis=-1)
    lengths = np.where(apart == 1, np.linalg.norm(cells[:, None] - cells[None], axis=-1), 0.0)
    exact = dijkstra(csr_matrix(lengths))
    for start, goal in path_oracle.connected_pairs(mask, 20, 3):
        a, b = (int(np.flatnonzero((cells == end).all(axis=1))[0]) for end in (start, goal))
        pulled = path_oracle.length_of(path_oracle.shortest_path(mask, start, goal))
        assert np.linalg.norm(goal - start) - 1e-9 <= pulled <= exact[a, b] + 1e-9


def test_flyable_voxels_keep_the_clearance_to_all_that_is_not_free() -> None:
    state = np.full((15, 15, 15), FREE, dtype=np.uint8)
    state[7, 7, 7] = OCCUPIED
    voxels = VoxelMap.whole(GridSpec(np.zeros(3), 0.1, state.shape), state, np.zeros_like(state), 1)
    mask = path_oracle.flyable(voxels, 0.25, np.zeros(3, dtype=np.int64), np.array([15, 15, 15]))
    assert not mask[7, 7, 9]
    assert mask[7, 7, 10]  # 0.3 m from centre to centre
    assert not mask[1, 7, 7]  # no space beyond the map is free
    assert not path_oracle.flyable(voxels, 0.25, np.array([11, 0, 0]), np.array([15, 15, 15]))[10].any()
