"""Segments through the known-free mask, against a brute force over every voxel and a fine walk."""

from __future__ import annotations

import numpy as np
import pytest
from guard_rooms import GRID, HULL_HEIGHT_M, HULL_RADIUS_M, OPEN, everything, known_free

from uav_recon.safety.free_space_check import FreeSpaceCheck
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, FreeSpace, VoxelMap


def test_open_space_may_be_flown_and_its_end_may_not() -> None:
    assert OPEN.admits((0.0, 0.0, 1.0), (3.0, 1.0, 1.5))
    assert not OPEN.admits((0.0, 0.0, 1.0), (-1.9, 0.0, 1.0)), "beyond the grid nothing is known"
    assert not OPEN.admits((0.0, 0.0, 1.0), (5.9, 0.0, 1.0))
    assert not OPEN.admits((0.0, 0.0, 1.0), (0.0, 0.0, 3.45))
    assert not OPEN.admits((0.0, 0.0, 1.0), (0.0, -2.9, 1.0))
    assert OPEN.admits((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))


def test_the_mask_says_what_the_map_says() -> None:
    state = np.random.default_rng(3).integers(0, 3, GRID.shape).astype(np.uint8)
    space = FreeSpace.of(VoxelMap.whole(GRID, state, np.zeros(GRID.shape, np.uint8), 7, 2))
    assert (space.revision, space.map_epoch) == (7, 2)
    assert np.array_equal(np.unpackbits(space.bits)[: state.size].reshape(GRID.shape) == 1, state == FREE)


@pytest.mark.parametrize("from_ghosts", [False, True])
def test_ways_through_a_random_space_are_judged_as_by_a_walk_of_millimetres(from_ghosts: bool) -> None:
    """What the walk meets is refused; what is refused the walk meets with a hull that is half a step wider all round."""
    rng = np.random.default_rng(4)
    free = rng.random(GRID.shape) > 0.004
    space, blocked = known_free(free), GRID.centre(np.argwhere(~free))

    def met(walk: FloatArray, wider_m: float) -> set[int]:
        off = blocked[None] - walk[:, None]
        level = np.hypot(off[..., 0], off[..., 1]) <= HULL_RADIUS_M + wider_m
        return set(np.flatnonzero((level & (np.abs(off[..., 2]) <= HULL_HEIGHT_M / 2 + wider_m)).any(axis=0)).tolist())

    judged = {True: 0, False: 0}
    while sum(judged.values()) < 150:
        start = rng.uniform([-1.5, -2.5, -0.5], [5.5, 2.5, 3.0])
        end = start + rng.uniform(-0.6, 0.6, 3) * rng.choice([0.01, 1.0, 1.0], 3)
        held = met(start[None], 0.0)
        if bool(held) is not from_ghosts or not (np.all(end > [-1.75, -2.75, -0.85]) and np.all(end < [5.75, 2.75, 3.35])):
            continue
        answer = space.admits(tuple(start.tolist()), tuple(end.tolist()))
        judged[answer] += 1
        walk = np.linspace(start, end, int(np.ceil(np.linalg.norm(end - start) / 0.001)) + 1)
        approached = any((blocked[voxel] - start) @ (end - start) > 1e-9 for voxel in held)
        if answer:
            assert not approached
            assert met(walk, -1e-7) <= held
        else:
            assert approached or met(walk, 0.0005) - held
    assert min(judged.values()) > 20


def test_a_way_that_grazes_a_voxel_between_two_half_voxels_is_refused() -> None:
    free = everything()
    free[30, 30, 20] = False  # its centre at 1.05, 0.05, 1.05
    a, b = (1.028, 0.24, 1.05), (1.072, 0.24, 1.05)  # 0.19 m beside it in the middle; at both ends 0.1913 m
    space = FreeSpaceCheck(FreeSpace(GRID, np.packbits(free), 1, 0), 0.191, HULL_HEIGHT_M)
    assert space.admits(a, a)
    assert space.admits(b, b)
    assert not space.admits(a, b)
    assert not space.admits((1.05, 0.24, 1.3), (1.05, 0.24, 1.05))
    assert space.admits((1.05, 0.2411, 1.3), (1.05, 0.2411, 0.8))


def test_a_leg_aslant_touches_of_a_column_what_it_passes_within_its_radius() -> None:
    """45 degrees up: the column stands 0.5 m on, is within 0.2 m from 0.3 to 0.7 m, and the hull reaches 0.1 m up and down."""
    for k, may in ((12, True), (13, False), (18, False), (19, True)):
        free = everything()
        free[25, 30, k] = False  # its centre at 0.55, 0.05
        answer = known_free(free).admits((0.05, 0.05, 0.051), (1.05, 0.05, 1.051))
        assert answer is may, k


def test_a_ghost_beside_a_hovering_vehicle_may_be_left_but_not_approached() -> None:
    free = everything()
    free[21, 30, 20] = False  # its centre at 0.15, 0.05, 1.05
    space = known_free(free)
    here = (0.0, 0.05, 1.05)
    assert space.admits(here, (-0.3, 0.05, 1.05))
    assert space.admits(here, (0.0, 0.05, 1.4))
    assert space.admits(here, here)
    assert not space.admits(here, (0.01, 0.05, 1.05))
    assert not space.admits((-0.3, 0.05, 1.05), here)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [-1, 1])
def test_the_hull_comes_as_near_as_its_size(axis: int, side: int) -> None:
    free = everything()
    free[30, 30, 20] = False
    centre = GRID.centre(np.array([30, 30, 20]))
    space, reach = known_free(free), (HULL_RADIUS_M, HULL_RADIUS_M, HULL_HEIGHT_M / 2)[axis]
    for beyond, may in ((0.001, True), (-0.001, False)):
        place, away = centre.copy(), centre.copy()
        place[axis] += side * (reach + beyond)
        away[axis] += side * (reach + 0.3)
        assert space.admits(tuple(away.tolist()), tuple(place.tolist())) is may


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [-1, 1])
def test_the_outermost_voxels_are_known_and_beyond_them_nothing_is(axis: int, side: int) -> None:
    """A millimetre either side of where the hull begins to touch the centre of a voxel that would lie outside the grid."""
    reach_m = (HULL_RADIUS_M, HULL_RADIUS_M, HULL_HEIGHT_M / 2)[axis]
    outside = np.array(GRID.shape) // 2
    outside[axis] = -1 if side < 0 else GRID.shape[axis]
    middle = GRID.centre(np.array(GRID.shape) // 2)
    for beyond_m, may in ((0.001, True), (-0.001, False)):
        place = middle.copy()
        place[axis] = GRID.centre(outside)[axis] - side * (reach_m + beyond_m)
        assert OPEN.admits(tuple(middle.tolist()), tuple(place.tolist())) is may


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_voxel_that_the_hull_just_touches_is_touched(axis: int, side: int) -> None:
    free = everything()
    free[30, 30, 20] = False
    place = GRID.centre(np.array([30, 30, 20]))
    away = place.copy()
    place[axis] += side * (HULL_RADIUS_M, HULL_RADIUS_M, HULL_HEIGHT_M / 2)[axis]
    away[axis] += side * 0.6
    assert not known_free(free).admits(tuple(away.tolist()), tuple(place.tolist()))


def test_of_a_ghost_the_rounding_of_a_place_is_no_approach() -> None:
    free = everything()
    free[21, 30, 20] = False  # its centre at 0.15, 0.05, 1.05
    assert known_free(free).admits((0.0, 0.05, 1.05), (1e-12, 0.05, 1.05))
    assert not known_free(free).admits((0.0, 0.05, 1.05), (2e-10, 0.05, 1.05))


def test_each_leg_of_a_way_counts() -> None:
    free = everything()
    free[40, 40, 25] = False  # its centre at 2.05, 1.05, 1.55
    space = known_free(free)
    first, blocked, last = (0.0, 0.0, 1.0), (2.0, 1.0, 1.5), (3.0, -1.0, 1.0)
    assert space.admits(first, last)
    assert not space.admits(first, blocked, last)
    assert not space.admits(first, last, blocked)
    assert space.admits(first, last, first)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [-1, 1])
def test_far_beyond_the_grid_nothing_is_known_either(axis: int, side: int) -> None:
    """From outside to farther outside: what the hull touches at the start does not count, what it comes to does."""
    place = GRID.centre(np.array(GRID.shape) // 2)
    place[axis] = GRID.centre(np.array(GRID.shape) * (1 + side) // 2)[axis] + side * 1.0
    farther = place.copy()
    farther[axis] += side * 0.5
    assert not OPEN.admits(tuple(place.tolist()), tuple(farther.tolist()))
    assert OPEN.admits(tuple(place.tolist()), tuple(place.tolist()))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("radius_m", "height_m"), [(0.25, 0.25), (0.33, 0.1)])
def test_a_hull_of_any_size_passes_a_voxel_by_or_does_not(axis: int, side: int, radius_m: float, height_m: float) -> None:
    free = everything()
    free[30, 30, 20] = False
    centre = GRID.centre(np.array([30, 30, 20]))
    space = FreeSpaceCheck(FreeSpace(GRID, np.packbits(free), 1, 0), radius_m, height_m)
    for beyond_m, may in ((0.001, True), (-0.001, False)):
        a = centre.copy()
        a[axis] += side * (radius_m + beyond_m)
        a[1 - axis] -= 0.7
        b = a.copy()
        b[1 - axis] += 1.4
        assert space.admits(tuple(a.tolist()), tuple(b.tolist())) is may
        over = centre + np.array([0.0, 0.0, side * (height_m / 2 + beyond_m)])
        start, end = over.copy(), over.copy()
        start[axis] -= 0.7
        end[axis] += 0.7
        assert space.admits(tuple(start.tolist()), tuple(end.tolist())) is may
