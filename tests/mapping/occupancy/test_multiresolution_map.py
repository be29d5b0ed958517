"""Fine maps of places in a coarse map, from the same frames."""

from __future__ import annotations

import numpy as np
from test_occupancy_map import D435I, ROOM, depth_of_box, looking, posed, voxels

from uav_recon.mapping.occupancy.multiresolution_map import FINE_RANGE_M, MAX_FINE_MAPS, MultiResolutionMap
from uav_recon.mapping.occupancy.occupancy_map import OccupancyMap
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec


def fine_map(grid: GridSpec, map_epoch: int) -> OccupancyMap:
    return OccupancyMap(grid, D435I, FINE_RANGE_M, (-2, -3, 0), (6, 3, 3), 1.1, map_epoch)


def test_a_fine_map_shows_where_a_wall_is_to_its_own_voxel() -> None:
    world, pose = MultiResolutionMap(voxels(), fine_map), looking(1.0, 0.0, 1.2)
    frame = posed(depth_of_box(pose, *ROOM), pose)
    assert not world.snapshot().fine
    world.refine([np.array([3.0, 0.0, 1.2])])
    world.refine([np.array([3.1, 0.1, 1.2])])  # the same place
    for _ in range(4):
        world.integrate(frame)
    (fine,) = world.snapshot().fine
    row = fine.state[:, 40, 24]
    x = fine.grid.origin_world_m[0] + 0.025 * (np.arange(80) + 0.5)
    assert (row[(x > 2.2) & (x < 2.95)] == FREE).all()
    assert OCCUPIED in row[np.abs(x - 3.02) < 0.03] and not (row[x > 3.06] == FREE).any()


def test_a_snapshot_is_the_same_object_until_one_of_its_maps_changes() -> None:
    world, pose = MultiResolutionMap(voxels(), fine_map), looking(1.0, 0.0, 1.2)
    frame = posed(depth_of_box(pose, *ROOM), pose)
    world.refine([np.array([2.5, 0.0, 1.2])])
    world.integrate(frame)
    first = world.snapshot()
    assert world.snapshot() is first and first.fine
    away = looking(-1.0, 0.0, 1.2, np.pi)
    for _ in range(3):
        world.integrate(posed(depth_of_box(away, *ROOM), away))
    second = world.snapshot()
    assert second is not first and second.fine == first.fine  # it is neither near nor in view


def test_a_new_epoch_drops_the_fine_maps_and_their_number_is_limited() -> None:
    world = MultiResolutionMap(voxels(), fine_map)
    places = [np.array([0.4 * n, 0.0, 1.0]) for n in range(MAX_FINE_MAPS + 3)]
    world.refine(places)
    first = world.snapshot().fine
    middles = [one.grid.origin_world_m[0] + 1.0 for one in first]
    np.testing.assert_allclose(middles, 0.4 * np.arange(MAX_FINE_MAPS), atol=0.02)
    world.refine(places)
    assert world.snapshot().fine == first  # those that there is no room for push none out
    world.refine([*places[1:MAX_FINE_MAPS], places[-1]])
    assert world.snapshot().fine[:-1] == first[1:] and len(world.snapshot().fine) == MAX_FINE_MAPS
    world.reset(1)
    assert not world.snapshot().fine
    world.refine([np.zeros(3)])
    assert world.snapshot().fine[0].map_epoch == 1
