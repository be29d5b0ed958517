"""The way home is as long as the breadcrumbs, and shorter where the map shows that nothing is in between."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from uav_recon.mission.battery.return_distance import return_distance_m
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, VoxelMap

GRID = GridSpec(np.zeros(3), 0.1, (80, 80, 20))
CLEARANCE_M = 0.4
WAYS = arrays(np.float64, st.tuples(st.integers(2, 120), st.just(3)), elements=st.floats(0.0, 8.0))


def room(*walls: tuple[slice, slice, slice], known: bool = True) -> VoxelMap:
    """8 x 8 m and 2 m high, with walls; distances are whatever keeps 0.4 m from them along x."""
    state = np.full(GRID.shape, FREE if known else 0, np.uint8)
    distance2 = np.full(GRID.shape, 225 if known else 0, np.uint8)
    for wall in walls:
        state[wall] = OCCUPIED
        near = tuple(slice(max((s.start or 0) - 3, 0), (s.stop or 999) + 3) for s in wall)
        distance2[near] = 0
    return VoxelMap.whole(GRID, state, distance2, 1)


def corner() -> FloatArray:
    """Home at (1, 1), along the one side and the other of a square: 6 m and 6 m."""
    legs = [(7.0, 7.0 - 0.2 * k, 1.0) for k in range(30)] + [(7.0 - 0.2 * k, 1.0, 1.0) for k in range(31)]
    return np.array(legs)


def test_without_a_map_and_in_the_unknown_it_is_the_way_that_was_flown() -> None:
    assert return_distance_m(corner(), None, CLEARANCE_M) == pytest.approx(12.0)
    assert return_distance_m(corner(), room(known=False), CLEARANCE_M) == pytest.approx(12.0)


def test_in_the_open_it_is_the_straight_line() -> None:
    assert return_distance_m(corner(), room(), CLEARANCE_M) == pytest.approx(6.0 * 2**0.5)


def test_round_a_wall_it_is_the_way_round_it() -> None:
    pillar = (slice(25, 45), slice(35, 80), slice(0, 20))
    there = return_distance_m(corner(), room(pillar), CLEARANCE_M)
    assert 6.0 * 2**0.5 < there <= 12.0


def test_no_way_is_no_length() -> None:
    assert return_distance_m(np.zeros((1, 3)), room(), CLEARANCE_M) == 0.0
    assert return_distance_m(np.zeros((3, 3)), room(), CLEARANCE_M) == 0.0


@settings(deadline=None)
@given(WAYS, st.booleans())
def test_never_longer_than_what_was_flown_and_never_shorter_than_the_straight_line(way: FloatArray, walled: bool) -> None:
    voxels = room((slice(30, 40), slice(0, 60), slice(0, 20))) if walled else room()
    flown_m = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    straight_m = float(np.linalg.norm(way[-1] - way[0]))
    assert straight_m - 1e-9 <= return_distance_m(way, voxels, CLEARANCE_M) <= flown_m + 1e-9
