"""Rooms of a map with walls worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.planning.tour.rooms import Rooms
from uav_recon.types.frames import ByteArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, GridSpec, VoxelMap

GRID = GridSpec(np.array([0.0, 0.0, -0.2]), 0.1, (84, 44, 28))


def walled(opening_m: float) -> ByteArray:
    """Return two rooms of 4 x 4 m with an opening in the wall at x = 4.1 to 4.2, and a table in the left one."""
    state = np.full(GRID.shape, UNKNOWN, dtype=np.uint8)
    state[2:-2, 2:-2, 2:-2] = FREE
    state[41:43, 2:-2, 2:-2] = OCCUPIED
    half = round(opening_m * 5)
    state[41:43, 22 - half : 22 + half, 2:22] = FREE
    state[10:25, 10:30, 2:10] = OCCUPIED
    return state


def rooms_at(state: ByteArray, *places_m: tuple[float, float, float]) -> list[int]:
    voxels = VoxelMap.whole(GRID, state, np.zeros(GRID.shape, dtype=np.uint8), 1)
    found: list[int] = Rooms(0.0).of(voxels, np.array(places_m)).tolist()
    return found


@pytest.mark.parametrize(("opening_m", "number"), [(0.8, 2), (1.2, 2), (2.0, 1)])
def test_an_opening_as_narrow_as_a_door_parts_two_rooms(opening_m: float, number: int) -> None:
    left, beside_the_wall, over_the_table, right = rooms_at(
        walled(opening_m), (1.0, 3.0, 1.0), (3.9, 0.4, 1.0), (1.5, 2.0, 1.5), (6.0, 3.0, 1.0)
    )
    assert left == beside_the_wall == over_the_table and (left != right) == (number == 2)


def test_without_free_space_no_room_is_known() -> None:
    assert rooms_at(np.full(GRID.shape, UNKNOWN, dtype=np.uint8), (1.0, 1.0, 1.0), (9.0, -3.0, 0.0)) == [0, 0]


def test_a_newer_map_is_read_again() -> None:
    rooms, places = Rooms(0.0), np.array([(1.0, 3.0, 1.0), (6.0, 3.0, 1.0)])
    for revision, opening_m, apart in ((1, 0.8, True), (2, 2.0, False)):
        voxels = VoxelMap.whole(GRID, walled(opening_m), np.zeros(GRID.shape, dtype=np.uint8), revision)
        left, right = rooms.of(voxels, places).tolist()
        assert (left != right) == apart
