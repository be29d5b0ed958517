from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from uav_recon.planning.reconstruction.geodesic_neighbourhood import STRIDE, geodesic_distances, within_geodesic_radius
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED


def _by_graph(state: ByteArray, start: IntArray, limit: float) -> dict[tuple[int, int, int], float]:
    """Return the distances of scipy's Dijkstra over the same nodes, as the oracle."""
    steps = [np.array([i, j, k]) - 1 for i, j, k in np.ndindex(3, 3, 3) if (i, j, k) != (1, 1, 1)]
    nodes = [n for n in np.ndindex(*state.shape) if all((n[d] - start[d]) % STRIDE == 0 for d in range(3))]
    number = {n: m for m, n in enumerate(nodes)}
    rows, columns, lengths = [], [], []
    for n in nodes:
        for step in steps:
            way = [tuple(np.array(n) + m * step) for m in range(1, STRIDE + 1)]
            if way[-1] in number and all(state[v] == FREE for v in way):
                rows.append(number[n])
                columns.append(number[way[-1]])
                lengths.append(STRIDE * float(np.linalg.norm(step)))
    graph = csr_matrix((lengths, (rows, columns)), shape=(len(nodes), len(nodes)))
    distance = dijkstra(graph, indices=number[tuple(int(x) for x in start)])
    return {n: float(d) for n, d in zip(nodes, distance, strict=True) if d <= limit}


@pytest.mark.parametrize("seed", range(6))
def test_the_wave_finds_exact_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = np.where(rng.random((26, 22, 14)) < 0.04 * seed, OCCUPIED, FREE).astype(np.uint8)
    start = rng.integers(0, state.shape)
    state[tuple(start)] = FREE
    limit = float(rng.uniform(4, 40))
    reach, low = geodesic_distances(state, start, limit)
    wanted = _by_graph(state, start, limit)
    found = {tuple(int(x) for x in low + STRIDE * np.array(n)): d for n, d in np.ndenumerate(reach) if d < np.inf}
    assert found.keys() == wanted.keys()
    for node, distance in wanted.items():
        assert found[node] == pytest.approx(distance)


def _room(gap: bool) -> ByteArray:
    state = np.full((60, 40, 30), FREE, dtype=np.uint8)
    state[20] = OCCUPIED  # a wall of one voxel
    if gap:
        state[20, 20:27] = FREE
    state[40:] = OCCUPIED
    return state


def _near(state: ByteArray, start: tuple[int, int, int], limit: float, point: FloatArray, normal: FloatArray) -> bool:
    reach, low = geodesic_distances(state, np.array(start), limit)
    return bool(within_geodesic_radius(state, reach, low, limit, point[None], normal[None])[0])


def test_surface_behind_a_wall_is_near_only_by_the_path_through_a_door() -> None:
    behind, towards_us = np.array([40.0, 5.0, 15.0]), np.array([-1.0, 0.0, 0.0])
    start = (15, 5, 15)
    assert not _near(_room(gap=False), start, 200.0, behind, towards_us)
    assert not _near(_room(gap=True), start, 28.0, behind, towards_us)  # 25 voxels straight through the wall
    assert not _near(_room(gap=True), start, 35.0, behind, towards_us)
    assert _near(_room(gap=True), start, 48.0, behind, towards_us)  # about 41 through the door
    assert _near(_room(gap=True), start, 10.0, np.array([20.0, 5.0, 15.0]), towards_us)


def test_the_far_side_of_a_thin_wall_is_not_near() -> None:
    far_side = np.array([21.0, 5.0, 15.0])
    assert not _near(_room(gap=False), (15, 5, 15), 30.0, far_side, np.array([1.0, 0.0, 0.0]))


def test_the_computed_box_depends_on_the_limit_and_not_on_the_map() -> None:
    state = np.full((700, 700, 32), FREE, dtype=np.uint8)
    reach, low = geodesic_distances(state, np.array([350, 350, 16]), 20.0)
    assert reach.shape == (13, 13, 11)
    assert tuple(low) == (332, 332, 1)
