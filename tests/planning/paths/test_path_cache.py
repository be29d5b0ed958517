"""Path cache: paths are as short as an exact search finds, and cached paths equal new ones."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from skimage.graph import MCP_Geometric

from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.paths.path_cache import PathCache
from uav_recon.planning.paths.segments import segment_is_open
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, TILE, GridSpec, VoxelMap

STREAM = Path(__file__).parents[4] / "shared" / "streams" / "two_room"
RESOLUTION_M = 0.1


class World:
    """Map of boxes; distance field and tile revisions are computed from scratch."""

    def __init__(self, state: ByteArray) -> None:
        self.grid = GridSpec(np.array([-2.0, 1.0, 0.0]), RESOLUTION_M, (state.shape[0], state.shape[1], state.shape[2]))
        self.state = state
        self.revision = 1
        self._field = self._distance2()
        self._tiles = np.ones((-(-state.shape[0] // TILE), -(-state.shape[1] // TILE)), dtype=np.int64)

    def _distance2(self) -> ByteArray:
        distance = ndimage.distance_transform_edt(np.pad(self.state == FREE, 1))[1:-1, 1:-1, 1:-1]
        return np.asarray(np.minimum(np.round(distance**2), 121).astype(np.uint8))

    def paint(self, low: IntArray, high: IntArray, value: int) -> None:
        before, before2 = self.state.copy(), self._field
        self.state[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = value
        self._field = self._distance2()
        self.revision += 1
        for i, j in np.argwhere(((before != self.state) | (before2 != self._field)).any(axis=2)):
            self._tiles[i // TILE, j // TILE] = self.revision

    def voxels(self) -> VoxelMap:
        return VoxelMap(self.grid, self.state, self._field, self._tiles, self.revision)

    def space(self, clearance_m: float) -> FlyableSpace:
        space = FlyableSpace(self.grid, clearance_m, np.zeros(3, dtype=np.int64), np.array(self.grid.shape))
        space.update(self.voxels())
        return space


def cluttered(rng: np.random.Generator, shape: tuple[int, int, int], boxes: int) -> World:
    state = np.full(shape, FREE, dtype=np.uint8)
    state[[0, -1]], state[:, [0, -1]], state[:, :, [0, -1]] = OCCUPIED, OCCUPIED, OCCUPIED
    for _ in range(boxes):
        size = rng.integers(1, 9, 3)
        if rng.random() < 0.4:
            size[2] = shape[2]
        low = rng.integers(0, shape)
        state[tuple(slice(a, a + b) for a, b in zip(low, size, strict=True))] = OCCUPIED
    return World(state)


def straight(mask: ByteArray, a: FloatArray, b: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether lines from a (3,) to each of b (N, 3) stay in the mask.

    The lines are sampled every 0.2 voxel.
    """
    count = int(np.linalg.norm(b - a, axis=1).max() * 5) + 2
    t = (np.arange(count) + 0.5) / count
    cells = np.floor(a + t[None, :, None] * (b - a)[:, None]).astype(int)
    return np.asarray(mask[cells[..., 0], cells[..., 1], cells[..., 2]].astype(bool).all(axis=1))


def oracle(mask: ByteArray, a: IntArray, b: IntArray) -> tuple[float, float]:
    """Return the lengths of an exact 26-connected path and of the polyline pulled from it.

    The polyline is the shortest one through some of the path's cells.
    """
    search = MCP_Geometric(np.where(mask > 0, 1.0, -1.0), fully_connected=True)
    costs, _ = search.find_costs([tuple(a)], [tuple(b)])
    path = np.array(search.traceback(tuple(b))) + 0.5
    best = np.full(len(path), np.inf)
    best[0] = 0.0
    for n in range(len(path) - 1):
        ahead = path[n + 1 :]
        seen = straight(mask, path[n], ahead)
        seen[0] = True  # a step between neighbours
        reached = best[n] + np.linalg.norm(ahead - path[n], axis=1)
        best[n + 1 :] = np.where(seen, np.minimum(best[n + 1 :], reached), best[n + 1 :])
    return float(costs[tuple(b)]), float(best[-1])


def centres(cells: IntArray) -> FloatArray:
    return np.asarray(cells).reshape(-1, 3) + np.float64(0.5)


def check_polyline(space: FlyableSpace, path_cache: PathCache, i: int, j: int) -> None:
    way = space.padded_from_world(path_cache.path_world(i, j))
    # conversion to world coordinates and back has a rounding error, so a sample on a border may be in either voxel
    nudges = [np.array(nudge) * 1e-9 for nudge in itertools.product((-1, 1), repeat=3)]
    for a, b in itertools.pairwise(way):
        assert any(segment_is_open(space.mask, *(a + nudge), *(b + nudge)) for nudge in nudges)
    for node, end in ((i, way[0]), (j, way[-1])):
        if node:
            np.testing.assert_allclose(end, path_cache._places[node - 1], atol=1e-9)
    length_m = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) * RESOLUTION_M
    assert length_m == pytest.approx(path_cache.lengths_m[i, j], abs=1e-9)
    np.testing.assert_allclose(path_cache.path_world(j, i), path_cache.path_world(i, j)[::-1])
    if len(way) > 1:
        step = way[1] - way[0]
        np.testing.assert_allclose(path_cache.departures[i, j], step / np.linalg.norm(step), atol=1e-9)


def largest_component(mask: ByteArray) -> IntArray:
    labels, _ = ndimage.label(mask, structure=np.ones((3, 3, 3)))
    return np.argwhere(labels == 1 + int(np.argmax(np.bincount(labels[mask > 0])[1:])))


def test_paths_in_clutter_are_open_and_as_short_as_an_exact_search() -> None:
    rng = np.random.default_rng(0)
    excess, over_grid = [], []
    for _ in range(5):
        world = cluttered(rng, (45, 40, 22), 40)
        space = world.space(0.14)
        cells = largest_component(space.mask)
        chosen = cells[rng.integers(len(cells), size=6)]
        start = space.world_from_padded(chosen[0] + 0.5)
        exit_cells = space.locate_vehicle(start)
        assert exit_cells is not None
        path_cache = PathCache(space)
        path_cache.update(exit_cells, start, centres(chosen[1:]))
        for i, j in itertools.combinations(range(6), 2):
            grid_length, pulled = oracle(space.mask, chosen[i], chosen[j])
            if grid_length == 0:
                continue
            length = path_cache.lengths_m[i, j] / RESOLUTION_M
            assert length >= np.linalg.norm(chosen[i] - chosen[j]) - 1e-9
            excess.append(length / pulled - 1)
            over_grid.append(length / grid_length - 1)
            check_polyline(space, path_cache, i, j)
    assert np.mean(excess) < 0.005
    assert np.percentile(excess, 95) < 0.03
    assert np.mean(over_grid) < -0.03  # straight lines are shorter than grid steps


@pytest.mark.shared
def test_paths_in_the_reference_map_are_as_short_as_an_exact_search() -> None:
    reference = np.fromfile(STREAM / "occupancy_reference.i8", dtype=np.int8).reshape(100, 60, 30)
    world = World(reference.astype(np.uint8))
    space = world.space(0.35)
    cells = largest_component(space.mask)
    path_cache = PathCache(space)
    excess = []
    for pair in cells[np.random.default_rng(100).integers(len(cells), size=(100, 2))]:
        start = space.world_from_padded(pair[0] + 0.5)
        exit_cells = space.locate_vehicle(start)
        assert exit_cells is not None
        path_cache.update(exit_cells, start, centres(pair[1:]))
        _, pulled = oracle(space.mask, pair[0], pair[1])
        excess.append(path_cache.lengths_m[0, 1] / RESOLUTION_M / pulled - 1)
        check_polyline(space, path_cache, 0, 1)
    assert np.mean(excess) <= 0.002
    assert np.percentile(excess, 95) <= 0.01


@pytest.mark.parametrize("seed", range(6))
def test_cached_paths_equal_a_new_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = cluttered(rng, (60, 45, 18), 45)
    space = world.space(0.14)
    path_cache = PathCache(space)
    tasks = np.zeros((0, 3))
    remembered = 0
    for _ in range(25):
        low = rng.integers(1, np.array(world.grid.shape) - 1)
        high = np.minimum(low + rng.integers(1, 7, 3), np.array(world.grid.shape) - 1)
        world.paint(low, high, int(rng.choice([FREE, OCCUPIED])))
        space.update(world.voxels())
        cells = largest_component(space.mask)
        start = space.world_from_padded(rng.choice(cells) + 0.5)
        exit_cells = space.locate_vehicle(start)
        assert exit_cells is not None
        open_still = np.array([space.mask[tuple(place.astype(int))] for place in tasks], dtype=bool)
        chosen = cells[rng.integers(len(cells), size=3)]
        tasks = np.concatenate([tasks[open_still][:9], chosen[:1] + 0.5, chosen[1:] + rng.random((2, 3))])
        before = path_cache._known.kept.sum()
        path_cache.update(exit_cells, start, tasks)
        again = PathCache(space)
        again.update(exit_cells, start, tasks)
        np.testing.assert_array_equal(path_cache.lengths_m, again.lengths_m)
        np.testing.assert_array_equal(path_cache.departures, again.departures)
        i, j = rng.integers(0, len(tasks) + 1, 2)
        np.testing.assert_array_equal(path_cache.path_world(int(i), int(j)), again.path_world(int(i), int(j)))
        remembered += int(before > 0)
    assert remembered > 15


@pytest.mark.parametrize("seed", range(4))
def test_a_path_ends_exactly_at_its_view_anywhere_in_a_voxel(seed: int) -> None:
    """Paths squeeze diagonally between single voxels.

    Each path starts and ends exactly at its point, also if that is not a voxel centre.
    """
    rng = np.random.default_rng(seed)
    state = np.where(rng.random((24, 20, 12)) < 0.35, OCCUPIED, FREE).astype(np.uint8)
    space = World(state).space(0.04)
    cells = largest_component(space.mask)
    bends, excess = 0, []
    for _ in range(25):
        chosen = cells[rng.integers(len(cells), size=4)]
        places = np.concatenate([chosen[:1] + 0.5, chosen[1:] + rng.random((3, 3))])
        start = space.world_from_padded(chosen[0] + rng.random(3))
        exit_cells = space.locate_vehicle(start)
        assert exit_cells is not None
        path_cache, centred = PathCache(space), PathCache(space)
        path_cache.update(exit_cells, start, places)
        centred.update(exit_cells, start, centres(chosen))
        for i, j in itertools.combinations(range(5), 2):
            assert np.isfinite(path_cache.lengths_m[i, j])
            check_polyline(space, path_cache, i, j)
            bends += len(path_cache.path_world(i, j)) > 3
            off = sum(float(np.linalg.norm(places[n - 1] - chosen[n - 1] - 0.5)) for n in (i, j) if n)
            excess.append(path_cache.lengths_m[i, j] / RESOLUTION_M - centred.lengths_m[i, j] / RESOLUTION_M - off)
    assert bends > 100
    # in voxels: no longer than via the centre, apart from random differences of the search
    assert np.mean(excess) <= 0.0
    assert np.percentile(excess, 95) <= 2.0


def walled() -> World:
    state = np.full((40, 30, 12), FREE, dtype=np.uint8)
    state[[0, -1]], state[:, [0, -1]], state[:, :, [0, -1]] = OCCUPIED, OCCUPIED, OCCUPIED
    state[19:21, :22] = OCCUPIED
    return World(state)


def test_a_door_that_opens_is_used_and_one_that_closes_is_not() -> None:
    world = walled()
    space = world.space(0.14)
    path_cache = PathCache(space)
    cells = centres(np.array([[10, 8, 6], [32, 8, 6]]))
    start = world.grid.centre(np.array([6, 6, 6]))
    lengths_m = []
    for value in (OCCUPIED, FREE, OCCUPIED):
        world.paint(np.array([19, 3, 1]), np.array([21, 12, 11]), value)
        space.update(world.voxels())
        exit_cells = space.locate_vehicle(start)
        assert exit_cells is not None
        path_cache.update(exit_cells, start, cells)
        lengths_m.append(path_cache.lengths_m[1, 2])
    assert lengths_m[0] == lengths_m[2] > lengths_m[1] + 0.8
    assert lengths_m[1] == pytest.approx(2.2)


def test_nodes_at_the_same_position_have_distance_zero() -> None:
    world = walled()
    space = world.space(0.14)
    start = world.grid.centre(np.array([6, 6, 6]))
    exit_cells = space.locate_vehicle(start)
    assert exit_cells is not None
    path_cache = PathCache(space)
    path_cache.update(exit_cells, start, centres(np.array([[7, 7, 7], [20, 25, 6], [20, 25, 6]])))
    assert path_cache.lengths_m[0, 1] == pytest.approx(0.0)
    assert path_cache.lengths_m[2, 3] == 0.0
    np.testing.assert_array_equal(path_cache.departures[2, 3], np.zeros(3))
    assert len(path_cache.path_world(2, 3)) == len(path_cache.path_world(0, 1)) == 1
    assert path_cache.lengths_m[1, 2] == path_cache.lengths_m[1, 3] == pytest.approx(path_cache.lengths_m[0, 2])


def test_there_is_no_path_through_a_wall() -> None:
    world = walled()
    world.paint(np.array([19, 22, 1]), np.array([21, 29, 11]), OCCUPIED)
    space = world.space(0.14)
    start = world.grid.centre(np.array([6, 6, 6]))
    exit_cells = space.locate_vehicle(start)
    assert exit_cells is not None
    path_cache = PathCache(space)
    path_cache.update(exit_cells, start, centres(np.array([[32, 8, 6], [10, 20, 6]])))
    assert np.isinf(path_cache.lengths_m[0, 1])
    assert np.isfinite(path_cache.lengths_m[0, 2])


def test_a_vehicle_outside_flyable_space_leaves_by_its_exit_cells_first() -> None:
    world = walled()
    space = world.space(0.35)
    start = world.grid.centre(np.array([1, 8, 6]))
    exit_cells = space.locate_vehicle(start)
    assert exit_cells is not None
    assert len(exit_cells) > 1
    path_cache = PathCache(space)
    path_cache.update(exit_cells, start, centres(np.array([[12, 9, 7]])))
    way = path_cache.path_world(0, 1)
    np.testing.assert_allclose(way[0], start)
    np.testing.assert_allclose(way[1 : len(exit_cells)], space.world_from_padded(space.cell_centres(exit_cells[1:])))
    assert path_cache.lengths_m[0, 1] == pytest.approx(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def test_a_map_of_a_new_epoch_starts_from_scratch() -> None:
    world = walled()
    space = world.space(0.14)
    path_cache = PathCache(space)
    start = world.grid.centre(np.array([6, 6, 6]))
    cells = centres(np.array([[10, 8, 6], [32, 8, 6]]))
    for epoch, open_door in ((0, False), (1, True)):
        if open_door:
            world.paint(np.array([19, 3, 1]), np.array([21, 12, 11]), FREE)
        voxels = VoxelMap.whole(world.grid, world.state, world._field, 1, epoch)
        space.update(voxels)
        exit_cells = space.locate_vehicle(start)
        assert exit_cells is not None
        path_cache.update(exit_cells, start, cells)
        assert (path_cache.lengths_m[1, 2] < 2.3) == open_door


def test_any_number_of_tasks_is_accepted() -> None:
    world = walled()
    space = world.space(0.14)
    start = world.grid.centre(np.array([6, 6, 6]))
    exit_cells = space.locate_vehicle(start)
    assert exit_cells is not None
    rng = np.random.default_rng(3)
    open_cells = largest_component(space.mask)
    path_cache = PathCache(space)
    for count in (0, 1, 50):
        path_cache.update(exit_cells, start, centres(open_cells[rng.integers(len(open_cells), size=count)]))
        assert path_cache.lengths_m.shape == (count + 1, count + 1)
        assert np.isfinite(path_cache.lengths_m).all()


@pytest.mark.parametrize("tasks", [33, 40, 80])
def test_a_plan_with_one_more_task_forgets_no_path(tasks: int) -> None:
    world = walled()
    space = world.space(0.14)
    start = world.grid.centre(np.array([6, 6, 6]))
    exit_cells = space.locate_vehicle(start)
    assert exit_cells is not None
    places = centres(largest_component(space.mask)[: tasks + 1])
    path_cache = PathCache(space)
    path_cache.update(exit_cells, start, places[:-1])
    kept = path_cache._known.kept.copy()
    path_cache.update(exit_cells, start, places)
    assert kept.sum() == tasks * (tasks - 1) // 2
    assert path_cache._known.kept.shape == kept.shape
    assert path_cache._known.kept[kept].all()
