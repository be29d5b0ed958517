"""Flyable space that is updated incrementally equals flyable space computed from scratch."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from uav_recon.mapping.occupancy.distance_field import distance2_to_not_free
from uav_recon.planning.free_space.flyable_space import FlyableSpace, height_measure
from uav_recon.planning.paths.segments import segment_is_open
from uav_recon.types.frames import ByteArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, TILE, UNKNOWN, GridSpec, VoxelMap

EVERY_NEIGHBOUR = np.ones((3, 3, 3))
RESOLUTION_M = 0.1


class ChangingMap:
    """Map whose boxes are overwritten.

    Distance field and tile revisions are computed from scratch.
    """

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.grid = GridSpec(np.array([-1.0, 2.0, 0.0]), RESOLUTION_M, shape)
        self.state = np.zeros(shape, dtype=np.uint8)
        self.revision = 0
        self.epoch = 0
        self._tile_revision = np.zeros((-(-shape[0] // TILE), -(-shape[1] // TILE)), dtype=np.int64)
        self._distance2 = self._field()

    def _field(self) -> ByteArray:
        distance = ndimage.distance_transform_edt(np.pad(self.state == FREE, 1))[1:-1, 1:-1, 1:-1]
        return np.asarray(np.minimum(np.round(distance**2), 121).astype(np.uint8))

    def paint(self, low: IntArray, high: IntArray, value: int) -> None:
        before, before2 = self.state.copy(), self._distance2
        self.state[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = value
        self._distance2 = self._field()
        self.revision += 1
        differs = (before != self.state) | (before2 != self._distance2)
        for i, j in {(int(i) // TILE, int(j) // TILE) for i, j in np.argwhere(differs.any(axis=2))}:
            self._tile_revision[i, j] = self.revision

    def paint_randomly(self, rng: np.random.Generator) -> None:
        largest = np.maximum(np.array(self.grid.shape) * rng.uniform(0.05, 0.5), 2)
        low = rng.integers(0, self.grid.shape)
        self.paint(low, low + rng.integers(1, largest.astype(int) + 1), int(rng.choice([FREE, FREE, OCCUPIED, UNKNOWN])))

    def voxels(self) -> VoxelMap:
        return VoxelMap(self.grid, self.state, self._distance2, self._tile_revision, self.revision, self.epoch)


def flyable(voxels: VoxelMap, clearance_m: float, low: IntArray, high: IntArray) -> ByteArray:
    inside = np.zeros(voxels.state.shape, dtype=bool)
    inside[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
    needed = (clearance_m / RESOLUTION_M + 0.5 - 1e-3) ** 2
    return np.pad((voxels.state == FREE) & inside & (voxels.distance2 >= needed), 1).astype(np.uint8)


def connected(mask: ByteArray, cell: int) -> ByteArray:
    labels, _ = ndimage.label(mask, structure=EVERY_NEIGHBOUR)
    return np.asarray((labels == labels.ravel()[cell]) & (mask > 0)).astype(np.uint8)


@pytest.mark.parametrize("seed", range(12))
def test_incremental_updates_equal_a_computation_from_scratch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(int(n) for n in rng.integers(5, 45, 3))
    world = ChangingMap((shape[0], shape[1], shape[2]))
    low, high = rng.integers(0, 3, 3), np.array(shape) - rng.integers(0, 3, 3)
    clearance_m = float(rng.choice([0.04, 0.1, 0.15]))
    space = FlyableSpace(world.grid, clearance_m, low, high)
    stood = 0
    world.paint(np.array([0, 0, 0]), np.array(shape), FREE)
    for _ in range(40):
        world.paint_randomly(rng)
        if rng.random() < 0.05:
            world.epoch += 1
        if rng.random() < 0.3:
            continue  # some maps are skipped
        before_mask, before_reachable, before = space.mask.copy(), space.reachable.copy(), space.revision
        space.update(world.voxels())
        mask = flyable(world.voxels(), clearance_m, low, high)
        np.testing.assert_array_equal(space.mask, mask)
        np.testing.assert_array_equal(space.known_free, np.pad(world.state == FREE, 1))
        position = world.grid.origin_world_m + rng.uniform(0, 1, 3) * np.array(shape) * RESOLUTION_M
        if mask.any() and rng.random() < 0.5:
            position = space.world_from_padded(rng.choice(np.argwhere(mask)) + 0.5)
        cells = space.locate_vehicle(position)
        if cells is not None:
            np.testing.assert_array_equal(space.reachable, connected(mask, int(cells[-1])))
            stood += 1
        for now, then, revisions in (
            (space.mask, before_mask, space.mask_revision),
            (space.reachable, before_reachable, space.reachable_revision),
        ):
            for i, j in np.argwhere((now != then).any(axis=2)):
                assert revisions[(i - 1) // TILE, (j - 1) // TILE] > before
    assert stood > 3


def test_line_checks_with_leaps_over_open_space_equal_plain_checks() -> None:
    rng = np.random.default_rng(4)
    answers = []
    for _ in range(6):
        world = ChangingMap((50, 40, 24))
        world.paint(np.array([1, 1, 1]), np.array([49, 39, 23]), FREE)
        for _ in range(6):
            low = rng.integers(0, world.grid.shape)
            world.paint(low, low + rng.integers(1, 8, 3), OCCUPIED)
        space = FlyableSpace(world.grid, 0.15, np.array([4, 0, 0]), np.array([48, 33, 24]))
        space.update(world.voxels())
        cells = np.argwhere(space.mask)
        for a, b in cells[rng.integers(len(cells), size=(400, 2))] + rng.random((400, 2, 3)):
            answers.append(segment_is_open(space.mask, *a, *b))
            assert segment_is_open(space.open_samples, *a, *b) == answers[-1]
            assert segment_is_open(space.open_samples, *b, *a) == answers[-1]
    assert 0.1 < np.mean(answers) < 0.9


def rooms(door: bool) -> ChangingMap:
    world = ChangingMap((60, 30, 20))
    world.paint(np.array([1, 1, 1]), np.array([59, 29, 19]), FREE)
    world.paint(np.array([29, 0, 0]), np.array([31, 30, 20]), OCCUPIED)
    if door:
        world.paint(np.array([29, 10, 1]), np.array([31, 20, 19]), FREE)
    return world


def test_a_door_that_closes_and_opens_separates_and_joins_two_rooms() -> None:
    world = rooms(door=True)
    space = FlyableSpace(world.grid, 0.2, np.zeros(3, dtype=np.int64), np.array(world.grid.shape))
    position = world.grid.centre(np.array([8, 15, 10]))
    far = (50, 15, 10)
    for closed in (False, True, False, True):
        world.paint(np.array([29, 10, 1]), np.array([31, 20, 19]), OCCUPIED if closed else FREE)
        space.update(world.voxels())
        assert space.locate_vehicle(position) is not None
        assert bool(space.reachable[far]) is not closed
    assert space.locate_vehicle(world.grid.centre(np.array([50, 15, 10]))) is not None
    assert space.reachable[far]
    assert not space.reachable[9, 16, 11]


def test_revisions_stay_while_the_flyable_space_stays() -> None:
    world = rooms(door=True)
    space = FlyableSpace(world.grid, 0.2, np.zeros(3, dtype=np.int64), np.array(world.grid.shape))
    space.update(world.voxels())
    space.locate_vehicle(world.grid.centre(np.array([8, 15, 10])))
    revision = space.revision
    world.paint(np.array([0, 0, 0]), np.array([2, 2, 2]), OCCUPIED)  # changes the map, but not the flyable space
    space.update(world.voxels())
    space.locate_vehicle(world.grid.centre(np.array([40, 15, 10])))
    assert space.revision == revision
    assert not (space.reachable_revision > revision).any()


def test_the_fence_and_the_clearance_are_kept() -> None:
    world = rooms(door=False)
    space = FlyableSpace(world.grid, 0.35, np.array([0, 5, 0]), np.array([60, 30, 16]))
    space.update(world.voxels())
    open_cells = np.argwhere(space.mask) - 1
    assert len(open_cells)
    # distances are between centres: 0.35 m from any face is at least 4 voxels
    assert open_cells[:, 0].min() == 4
    assert open_cells[:, 1].min() == 5
    assert open_cells[:, 2].max() == 15


def test_a_vehicle_outside_flyable_space_leaves_through_free_space() -> None:
    world = rooms(door=True)
    space = FlyableSpace(world.grid, 0.35, np.zeros(3, dtype=np.int64), np.array(world.grid.shape))
    space.update(world.voxels())
    cells = space.locate_vehicle(world.grid.centre(np.array([2, 15, 10])))
    assert cells is not None
    way = np.stack(np.unravel_index(cells, space.mask.shape), axis=-1) - 1
    np.testing.assert_array_equal(way[0], [2, 15, 10])
    np.testing.assert_array_equal(way[-1], [4, 15, 10])
    assert np.all(np.abs(np.diff(way, axis=0)) <= 1)
    assert all(space.known_free.ravel()[cell] for cell in cells[1:])


def test_a_single_free_voxel_no_free_space_and_positions_outside_have_no_exit() -> None:
    world = ChangingMap((20, 20, 20))
    space = FlyableSpace(world.grid, 0.35, np.zeros(3, dtype=np.int64), np.array(world.grid.shape))
    space.update(world.voxels())
    assert space.locate_vehicle(world.grid.centre(np.array([8, 8, 8]))) is None
    world.paint(np.array([8, 8, 8]), np.array([9, 9, 9]), FREE)
    space.update(world.voxels())
    assert space.locate_vehicle(world.grid.centre(np.array([8, 8, 8]))) is None
    assert space.locate_vehicle(world.grid.centre(np.array([-5, 8, 8]))) is None
    assert space.locate_vehicle(world.grid.centre(np.array([8, 8, 20]))) is None


def test_a_map_of_another_grid_is_refused() -> None:
    world = ChangingMap((20, 20, 20))
    space = FlyableSpace(world.grid, 0.35, np.zeros(3, dtype=np.int64), np.array(world.grid.shape))
    with pytest.raises(ValueError, match="shape"):
        space.update(ChangingMap((20, 20, 21)).voxels())


@pytest.mark.parametrize(("radius_m", "height_m"), [(0.2, 0.2), (0.35, 0.25)])
def test_a_flat_body_keeps_its_clearance_in_every_direction(radius_m: float, height_m: float) -> None:
    """A body at the centre of a flyable voxel, against the nearest point of every voxel that is not free."""
    rng, margin_m = np.random.default_rng(2), 0.12
    clearance_m = radius_m + 0.2
    heights = height_measure(clearance_m, height_m / 2, margin_m, RESOLUTION_M)
    state = np.where(rng.random((50, 50, 30)) < 0.0008, OCCUPIED, FREE).astype(np.uint8)
    grid = GridSpec(np.zeros(3), RESOLUTION_M, (50, 50, 30))
    voxels = VoxelMap.whole(grid, state, distance2_to_not_free(state, 11, heights), 1, heights=heights)
    space = FlyableSpace(grid, clearance_m, np.zeros(3, dtype=np.int64), np.array(grid.shape), heights)
    space.update(voxels)
    cells, blocked = np.argwhere(space.mask[1:-1, 1:-1, 1:-1]), np.argwhere(state != FREE)
    apart_m = np.maximum(np.abs(cells[:, None] - blocked) - 0.5, 0.0) * RESOLUTION_M
    beside_m = np.maximum(np.hypot(apart_m[..., 0], apart_m[..., 1]) - radius_m, 0.0)
    above_m = np.maximum(apart_m[..., 2] - height_m / 2, 0.0)
    least_m = np.hypot(beside_m, above_m).min()
    assert 0.1 <= least_m <= 0.2
    usual = FlyableSpace(grid, clearance_m, np.zeros(3, dtype=np.int64), np.array(grid.shape))
    usual.update(VoxelMap.whole(grid, state, distance2_to_not_free(state, 11), 1))
    assert space.mask.sum() > 1.2 * usual.mask.sum()  # and flies where a ball of its radius would not


def test_opened_voxels_are_flyable_while_they_are_free() -> None:
    world = ChangingMap((20, 20, 12))
    world.paint(np.zeros(3, dtype=int), np.array([20, 20, 12]), FREE)
    world.paint(np.array([9, 0, 0]), np.array([11, 20, 12]), OCCUPIED)
    world.paint(np.array([9, 8, 0]), np.array([11, 13, 12]), FREE)
    space = FlyableSpace(world.grid, 0.3, np.zeros(3, dtype=np.int64), np.array(world.grid.shape))
    space.update(world.voxels())
    here, beyond = world.grid.centre(np.array([4, 10, 6])), (16, 11, 7)
    assert space.locate_vehicle(here) is not None
    assert not space.reachable[beyond]
    way = np.array([np.ravel_multi_index((i, 11, 7), space.mask.shape) for i in range(6, 16)])
    space.set_opened(way)
    space.update(world.voxels())
    assert space.reachable[beyond] and space.reachable.ravel()[way].all()
    world.paint(np.array([9, 8, 0]), np.array([11, 13, 12]), OCCUPIED)  # a door closes
    space.update(world.voxels())
    assert not space.reachable[beyond]
    world.paint(np.array([9, 8, 0]), np.array([11, 13, 12]), FREE)
    space.set_opened(np.zeros(0, dtype=np.int64))
    space.update(world.voxels())
    assert not space.reachable[beyond]
