"""Where to land, by a map: home while nothing stands there, else the nearest place that is known to be good."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.mission.return_home.landing_site import PATCH_M, REACH_M, STEP_M, LandingSite
from uav_recon.types.frames import ByteArray, FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, GridSpec, VoxelMap

GRID = GridSpec(np.array([-3.0, -4.0, -0.3]), 0.1, (60, 80, 25))
GROUND_M = -0.1
SITE = LandingSite(1.0, GROUND_M, 0.35)


def room() -> ByteArray:
    """Free over a floor whose top is at the ground."""
    state = np.full(GRID.shape, FREE, dtype=np.uint8)
    state[:, :, :2] = OCCUPIED
    return state


def fill(state: ByteArray, low: tuple[float, float, float], high: tuple[float, float, float], value: int = OCCUPIED) -> None:
    first, last = (np.round((np.array(x) - GRID.origin_world_m) / 0.1).astype(int) for x in (low, high))
    state[first[0] : last[0], first[1] : last[1], first[2] : last[2]] = value


def mapped(state: ByteArray) -> VoxelMap:
    distance2 = np.where(state == FREE, 100, 0).astype(np.uint8)
    return VoxelMap.whole(GRID, state, distance2, revision=1)


def gap_m(place: FloatArray, low: tuple[float, float], high: tuple[float, float]) -> float:
    """From a place, level, to a box."""
    out = np.maximum(np.maximum(np.array(low) - place[:2], place[:2] - np.array(high)), 0.0)
    return float(np.hypot(*out))


def test_home_while_nothing_stands_there() -> None:
    state = room()
    np.testing.assert_array_equal(SITE.choose(mapped(state)), [0.0, 0.0, 1.0])
    state[30, 40, 6] = OCCUPIED  # a speckle
    np.testing.assert_array_equal(SITE.choose(mapped(state)), [0.0, 0.0, 1.0])
    state[28, 40, 6] = OCCUPIED  # and another one
    np.testing.assert_array_equal(SITE.choose(mapped(state)), [0.0, 0.0, 1.0])
    fill(state, (0.4, -0.5, -0.1), (0.5, 0.5, 1.0))  # beside the pad, where it stood when it was taken for one
    np.testing.assert_array_equal(SITE.choose(mapped(state)), [0.0, 0.0, 1.0])


@pytest.mark.parametrize("other", [(31, 40, 6), (29, 41, 7), (30, 40, 5)])
def test_not_where_two_voxels_that_touch_say_that_something_stands(other: tuple[int, int, int]) -> None:
    state = room()
    state[30, 40, 6] = state[other] = OCCUPIED
    assert SITE.is_occupied(mapped(state), SITE.home)
    assert np.hypot(*SITE.choose(mapped(state))[:2]) >= PATCH_M / 2 - STEP_M


def test_beside_a_box_as_near_as_may_be() -> None:
    state = room()
    fill(state, (-0.3, -0.3, -0.1), (0.3, 0.3, 0.3))
    place = SITE.choose(mapped(state))
    assert gap_m(place, (-0.3, -0.3), (0.3, 0.3)) >= PATCH_M / 2 - 0.05
    assert np.hypot(*place[:2]) <= 0.3 + PATCH_M / 2 + STEP_M
    assert place[2] == 1.0
    assert not SITE.is_occupied(mapped(state), place)


@pytest.mark.parametrize("spoil", ["unknown above", "no floor", "low ceiling"])
def test_a_place_that_is_not_known_to_be_good_is_none(spoil: str) -> None:
    state = room()
    fill(state, (-0.3, -0.3, -0.1), (0.3, 0.3, 0.3))
    first = SITE.choose(mapped(state))
    x, y = first[:2].tolist()
    if spoil == "unknown above":
        fill(state, (x - 0.1, y - 0.1, 0.4), (x + 0.1, y + 0.1, 0.5), UNKNOWN)
    elif spoil == "no floor":
        fill(state, (x - 0.5, y - 0.5, -0.3), (x + 0.5, y + 0.5, 0.0), UNKNOWN)
    else:
        fill(state, (x - 0.1, y - 0.1, 0.9), (x + 0.1, y + 0.1, 1.1))
    place = SITE.choose(mapped(state))
    assert not np.array_equal(place, first)
    assert not np.array_equal(place, SITE.home)


def test_a_place_that_turned_out_bad_is_not_chosen_again() -> None:
    state = room()
    fill(state, (-0.3, -0.3, -0.1), (0.3, 0.3, 0.3))
    first = SITE.choose(mapped(state))
    assert np.linalg.norm(SITE.choose(mapped(state), (first,)) - first) >= PATCH_M / 2


def test_home_is_the_least_bad_where_there_is_no_other() -> None:
    state = np.full(GRID.shape, OCCUPIED, dtype=np.uint8)
    np.testing.assert_array_equal(SITE.choose(mapped(state)), SITE.home)


def test_no_farther_than_it_may_go() -> None:
    wide = GridSpec(np.array([-8.0, -8.0, -0.3]), 0.1, (160, 160, 25))
    state = np.full(wide.shape, FREE, dtype=np.uint8)
    state[:, :, :2] = OCCUPIED
    x, y = np.meshgrid(np.arange(160) * 0.1 - 7.95, np.arange(160) * 0.1 - 7.95, indexing="ij")
    state[np.hypot(x, y) < REACH_M + 0.2, :6] = OCCUPIED
    voxels = VoxelMap.whole(wide, state, np.where(state == FREE, 100, 0).astype(np.uint8), revision=1)
    np.testing.assert_array_equal(SITE.choose(voxels), SITE.home)


def test_near_where_it_is_on_the_floor_and_not_on_the_table_below() -> None:
    state = room()
    here = np.array([-1.5, 2.0, 1.7])
    near = SITE.near(mapped(state), here)
    assert near is not None
    np.testing.assert_allclose(near, [-1.5, 2.0, 1.0])
    fill(state, (-2.0, 1.5, -0.1), (-1.0, 2.5, 0.7))
    beside = SITE.near(mapped(state), here)
    assert beside is not None
    assert gap_m(beside, (-2.0, 1.5), (-1.0, 2.5)) >= PATCH_M / 2 - 0.05
    assert np.hypot(*(beside - here)[:2]) < 2.0
    again = SITE.near(mapped(state), here, (beside,))
    assert again is not None
    assert np.linalg.norm(again - beside) >= PATCH_M / 2
    state[:, :, :2] = UNKNOWN
    assert SITE.near(mapped(state), here) is None, "no floor is known"
