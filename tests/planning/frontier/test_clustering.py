"""Frontier clusters, against scipy; incremental updates against a computation from scratch."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from uav_recon.planning.frontier.cluster_table import FARTHER, OPENING
from uav_recon.planning.frontier.clustering import BLOCK, MAX_EXTENT_M, MIN_CELLS, main_axis
from uav_recon.planning.frontier.frontiers import FACES, Frontiers
from uav_recon.types.maps import FREE, OCCUPIED, TILE, UNKNOWN, GridSpec, VoxelMap

State = NDArray[np.uint8]
AROUND = np.ones((3, 3, 3))


def map_of(state: State, revision: int = 0, changed: NDArray[np.int64] | None = None, epoch: int = 0) -> VoxelMap:
    nx, ny, nz = state.shape
    grid = GridSpec(np.zeros(3), 0.1, (nx, ny, nz))
    whole = VoxelMap.whole(grid, state.copy(), np.zeros_like(state), revision, epoch)
    return whole if changed is None else VoxelMap(grid, whole.state, whole.distance2, changed.copy(), revision, epoch)


def random_state(rng: np.random.Generator, shape: tuple[int, int, int]) -> State:
    """Return blobs of free and occupied space in the unknown, so that frontiers have some size."""
    noise = ndimage.uniform_filter(rng.normal(size=shape), 5)
    return np.where(noise > 0.02, FREE, np.where(noise > -0.02, UNKNOWN, OCCUPIED)).astype(np.uint8)


def contents(frontiers: Frontiers) -> dict[int, tuple[bytes, bytes]]:
    keys = [int(frontiers.table.rows.key[row]) for row in frontiers.rows()]
    found = {key: (c.cells.tobytes(), c.faces.tobytes()) for key, c in zip(keys, frontiers.clusters(), strict=True)}
    assert len(found) == len(keys)
    return found


def brute_faces(state: State, low: NDArray[np.int64], high: NDArray[np.int64]) -> State:
    inside = np.zeros(state.shape, dtype=np.bool_)
    inside[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = True
    unknown = np.pad((state == UNKNOWN) & inside, 1)
    faces = np.zeros(state.shape, dtype=np.uint8)
    for bit, step in enumerate(FACES):
        beside = np.roll(unknown, tuple(-step), axis=(0, 1, 2))[1:-1, 1:-1, 1:-1]
        faces |= np.where(beside & inside & (state == FREE), 1 << bit, 0).astype(np.uint8)
    return faces


def test_clusters_are_the_components_of_each_block_split_to_the_size_of_a_view() -> None:
    rng = np.random.default_rng(0)
    for shape in ((40, 37, 23), (33, 16, 70), (9, 50, 8)):
        state = random_state(rng, shape)
        low, high = rng.integers(0, 3, 3), np.array(shape) - rng.integers(0, 3, 3)
        ignored = (rng.random(shape) < 0.02).astype(np.uint8)
        frontiers = Frontiers()
        frontiers.update(map_of(state), low, high, ignored)
        faces = brute_faces(state, low, high)
        np.testing.assert_array_equal(frontiers.faces, faces)
        cells = (faces > 0) & (ignored == 0)
        whole, count = ndimage.label(cells, structure=AROUND)
        sizes = ndimage.sum_labels(cells, whole, np.arange(count + 1))
        pieces = np.zeros(shape, dtype=np.int64)
        for i in range(0, shape[0], BLOCK):
            for j in range(0, shape[1], BLOCK):
                block = np.s_[i : i + BLOCK, j : j + BLOCK]
                labels, _ = ndimage.label(cells[block], structure=AROUND)
                pieces[block] = np.where(labels > 0, labels + pieces.max(), 0)
        left = cells & (sizes[whole] >= MIN_CELLS)
        for cluster in frontiers.clusters():
            at = tuple(cluster.cells.T)
            assert left[at].all()  # each cell is in one cluster only, and specks are in none
            left[at] = False
            assert len(np.unique(pieces[at])) == 1
            np.testing.assert_array_equal(cluster.faces, faces[at])
            flat = np.ravel_multi_index(at, shape)
            assert (np.diff(flat) > 0).all()
            offsets = cluster.cells - cluster.cells.mean(axis=0)
            _, spread, axes = np.linalg.svd(offsets, full_matrices=False)
            if len(spread) > 2 and spread[0] > spread[1] * (1 + 1e-6):
                assert np.ptp(offsets @ axes[0]) <= MAX_EXTENT_M / 0.1 + 1e-6
        assert not left.any()


def test_incremental_updates_equal_a_computation_from_scratch() -> None:
    rng = np.random.default_rng(1)
    shape = (53, 44, 21)
    low, high = np.array([1, 0, 2]), np.array([52, 44, 20])
    state, ignored = np.zeros(shape, dtype=np.uint8), np.zeros(shape, dtype=np.uint8)
    tiles = np.zeros((-(-shape[0] // TILE), -(-shape[1] // TILE)), dtype=np.int64)
    frontiers, sizes = Frontiers(), []
    for revision in range(1, 60):
        corner = rng.integers(0, np.array(shape) - 6)
        size = rng.integers(1, 14, 3)
        box = tuple(slice(int(a), int(a + s)) for a, s in zip(corner, size, strict=True))
        before = state.copy()
        kind = rng.integers(4)
        state[box] = random_state(rng, state[box].shape) if kind == 3 else [FREE, FREE, OCCUPIED][kind]
        for i, j in np.unique(np.argwhere(before != state)[:, :2] // TILE, axis=0):
            tiles[i, j] = revision
        if revision % 7 == 0:
            touched = rng.integers(0, state.size, 300)
            ignored.ravel()[touched] ^= 1
            frontiers.mark_changed(touched)
        if revision % 3 == 0:
            continue  # this map is skipped
        frontiers.update(map_of(state, revision, tiles), low, high, ignored)
        fresh = Frontiers()
        fresh.update(map_of(state, revision), low, high, ignored)
        np.testing.assert_array_equal(frontiers.faces, fresh.faces)
        assert contents(frontiers) == contents(fresh)
        assert len(frontiers) == len(contents(fresh))
        sizes.append(len(fresh))
        place = rng.uniform(0, shape)
        near = [f.table.nearest(place, 12) for f in (frontiers, fresh)]
        assert frontiers.table.rows.key[near[0]].tolist() == fresh.table.rows.key[near[1]].tolist()
        behind = [
            dict(zip(f.table.rows.key[f.rows()].tolist(), f.table.rows.beyond[f.rows()].tolist(), strict=True))
            for f in (frontiers, fresh)
        ]
        assert behind[0] == behind[1]
    assert max(sizes) > 30


def test_a_cluster_far_from_a_change_keeps_its_row_and_key() -> None:
    rng = np.random.default_rng(2)
    state = random_state(rng, (96, 48, 20))
    low, high, ignored = np.zeros(3, dtype=np.int64), np.array(state.shape), np.zeros(state.shape, dtype=np.uint8)
    frontiers = Frontiers()
    frontiers.update(map_of(state, 1), low, high, ignored)
    rows = {int(frontiers.table.rows.key[row]): int(row) for row in frontiers.rows()}
    far = {key: row for key, row in rows.items() if frontiers.table.rows.centre[row, 0] > 40}
    state[10:20, 10:20] = FREE
    tiles = np.ones((12, 6), dtype=np.int64)
    tiles[:4, :4] = 2
    frontiers.update(map_of(state, 2, tiles), low, high, ignored)
    assert far
    assert all(int(frontiers.table.rows.key[row]) == key for key, row in far.items())


def test_a_few_cells_are_a_frontier_while_connected_to_more_in_the_next_block() -> None:
    state = np.full((2 * BLOCK, BLOCK, 12), OCCUPIED, dtype=np.uint8)
    state[BLOCK - 3 : BLOCK + 9, 5:7, 4] = FREE
    state[BLOCK - 3 : BLOCK + 9, 5:7, 5] = UNKNOWN
    low, high, ignored = np.zeros(3, dtype=np.int64), np.array(state.shape), np.zeros_like(state)
    frontiers = Frontiers()
    frontiers.update(map_of(state, 1), low, high, ignored)
    assert sorted(len(cluster.cells) for cluster in frontiers.clusters()) == [6, 18]
    state[BLOCK + 2, 5:7, 4] = OCCUPIED  # the cells of the first block now touch only two of the second block
    frontiers.update(map_of(state, 2), low, high, ignored)
    assert len(frontiers) == len(frontiers.clusters()) == 0
    state[BLOCK + 2, 5:7, 4] = FREE
    frontiers.update(map_of(state, 3), low, high, ignored)
    assert sorted(len(cluster.cells) for cluster in frontiers.clusters()) == [6, 18]


def test_the_nearest_clusters_are_returned_in_order() -> None:
    rng = np.random.default_rng(3)
    state = random_state(rng, (80, 64, 20))
    frontiers = Frontiers()
    frontiers.update(map_of(state), np.zeros(3, dtype=np.int64), np.array(state.shape), np.zeros_like(state))
    rows = frontiers.rows()
    for _ in range(5):
        place = rng.uniform(0, state.shape)
        away = np.linalg.norm(frontiers.table.rows.centre[rows] - place, axis=1)
        near = rows[np.argsort(away + np.where(frontiers.table.rows.beyond[rows] < OPENING, FARTHER, 0.0))]
        assert frontiers.table.nearest(place, 10).tolist() == near[:10].tolist()
    assert sorted(frontiers.table.nearest(place, len(rows) + 5)) == sorted(rows)


@pytest.mark.parametrize("what", ["epoch", "box", "an older map"])
def test_another_map_starts_from_scratch(what: str) -> None:
    rng = np.random.default_rng(4)
    first, second = (random_state(rng, (30, 30, 15)) for _ in range(2))
    low, high, ignored = np.zeros(3, dtype=np.int64), np.array(first.shape), np.zeros_like(first)
    frontiers, fresh = Frontiers(), Frontiers()
    frontiers.update(map_of(first, 5), low, high, ignored)
    if what == "box":
        second, low = first, np.array([4, 4, 4])
    revision, epoch = (3 if what == "an older map" else 5), (1 if what == "epoch" else 0)
    frontiers.update(map_of(second, revision, epoch=epoch), low, high, ignored)
    fresh.update(map_of(second, revision, epoch=epoch), low, high, ignored)
    assert contents(frontiers) == contents(fresh)


def test_a_tile_records_when_it_last_lost_free_space() -> None:
    state = np.full((24, 24, 8), FREE, dtype=np.uint8)
    low, high, ignored = np.zeros(3, dtype=np.int64), np.array(state.shape), np.zeros_like(state)
    frontiers = Frontiers()
    frontiers.update(map_of(state, 1), low, high, ignored)
    assert (frontiers.closed < 1).all()
    state[9, 17, 3] = OCCUPIED
    frontiers.update(map_of(state, 2), low, high, ignored)
    state[9, 17, 3] = FREE
    frontiers.update(map_of(state, 3), low, high, ignored)
    assert np.argwhere(frontiers.closed == 2).tolist() == [[1, 2]]
    assert (frontiers.closed == 3).sum() == 0


def test_the_main_axis_is_that_of_the_largest_eigenvalue() -> None:
    rng = np.random.default_rng(5)
    cases = [m @ m.T for m in rng.normal(size=(200, 3, 3))]
    cases += [np.diag(d).astype(float) for d in ([2, 1, 0], [1, 2, 2], [3, 3, 3], [0, 0, 5], [4, 4, 1], [4, 1, 4], [0, 0, 0])]
    for m in cases:
        axis = np.array(main_axis(m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2]))
        assert np.linalg.norm(axis) == pytest.approx(1.0)
        np.testing.assert_allclose(m @ axis, np.linalg.eigvalsh(m)[2] * axis, atol=1e-6 * max(1.0, np.abs(m).max()))
