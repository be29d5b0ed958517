"""What was seen free lately, against views worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from guard_rooms import HULL_RADIUS_M, MOUNT, frame

from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import Pose

HERE = Pose.from_yaw(0.0, np.array([1.0, 0.0, 1.0]))  # the imager at x = 1.1


def looked(range_m: float = 3.0, stamp_s: float = 5.0) -> RecentlySeenSpace:
    sight = RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=HULL_RADIUS_M)
    sight.add(frame(range_m, stamp_s), HERE)
    return sight


@pytest.mark.parametrize(
    ("place", "free"),
    [
        ((2.0, 0.0, 1.0), True),
        ((4.04, 0.0, 1.0), True),
        ((4.06, 0.0, 1.0), False),
        ((0.7, 0.0, 1.0), False),
        ((2.1, 0.94, 1.0), True),
        ((2.1, 0.96, 1.0), False),
        ((2.1, -0.94, 1.0), True),
        ((2.1, -0.96, 1.0), False),
        ((2.1, 0.0, 1.54), True),
        ((2.1, 0.0, 1.56), False),
        ((2.1, 0.0, 0.46), True),
        ((2.1, 0.0, 0.44), False),
        ((0.81, 0.0, 1.0), True),
        ((0.79, 0.0, 1.0), False),
        ((1.0, 0.2, 1.0), True),
        ((1.1, 0.3, 1.0), False),
        ((1.6, 0.46, 1.0), True),
        ((1.6, 0.49, 1.0), False),
        ((1.2, 3.0, 1.0), False),
        ((1.2, -3.0, 1.0), False),
        ((1.2, 0.0, 4.0), False),
        ((1.2, 0.0, -2.0), False),
    ],
)
def test_free_is_before_the_nearest_return_and_where_the_hull_was(place: tuple[float, float, float], free: bool) -> None:
    assert looked().saw_free(place, 6.0) is free


def test_it_forgets() -> None:
    sight = looked()
    assert sight.saw_free((2.0, 0.0, 1.0), 15.0)
    assert not sight.saw_free((2.0, 0.0, 1.0), 15.01)
    sight.add(frame(3.0, 20.0), HERE)
    sight.forget()
    assert not sight.saw_free((2.0, 0.0, 1.0), 20.0)
    assert not sight.saw_free((1.0, 0.0, 1.0), 20.0)
    young = looked(stamp_s=0.5)
    young.forget()
    assert not young.saw_free((2.0, 0.0, 1.0), 1.0)
    assert not young.saw_free((1.0, 0.0, 1.0), 1.0)


@pytest.mark.parametrize(
    ("direction", "longest_s"), [((0, 0, 1), 30), ((0.8, 0, 0.6), 30), ((0.9, 0, 0.43), 10), ((0, 0, -1), 10)]
)
def test_a_steep_climb_may_rely_on_older_views(direction: tuple[float, float, float], longest_s: float) -> None:
    sight, place = looked(), (2.0, 0.0, 1.0)
    assert sight.saw_free(place, 5.0 + longest_s - 0.01, np.array(direction))
    assert not sight.saw_free(place, 5.0 + longest_s + 0.01, np.array(direction))
    assert not sight.saw_free((4.1, 0.0, 1.0), 6.0, np.array(direction))


def test_it_keeps_a_view_of_each_part_of_the_longest_memory() -> None:
    sight = RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=HULL_RADIUS_M)
    for n in range(3000):  # at 30 Hz for 100 s, along y
        sight.add(frame(3.0, n / 30), Pose.from_yaw(0.0, np.array([1.0, n / 300, 1.0])))
    y = np.linspace(9.99 - 3.0, 9.99, 50)  # where it was in the last 30 s
    places = np.column_stack([np.full(50, 1.0), y, np.full(50, 1.0)])
    ages_s = sight.ages_s(places, 2999 / 30, 30.0)
    np.testing.assert_allclose(ages_s, np.maximum((9.99 - y) * 10.0 - HULL_RADIUS_M * 10.0, 0.0), atol=0.2)
    assert (sight.ages_s(places, 2999 / 30)[ages_s > 10.2] == math.inf).all()


def test_no_return_is_not_free() -> None:
    assert not looked(math.nan).saw_free((2.0, 0.0, 1.0), 6.0)


def test_each_cell_speaks_for_itself_and_each_view_counts() -> None:
    ranges = np.full((12, 16), 3.0, dtype=np.float32)
    ranges[:, 8:] = 0.5  # a post to the right
    sight = RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=HULL_RADIUS_M)
    sight.add(MinRangeGrid(5.0, MOUNT, ranges, (0.95, 0.55), 0.9), HERE)
    assert sight.saw_free((2.0, 0.2, 1.0), 6.0)
    assert not sight.saw_free((2.0, -0.2, 1.0), 6.0)
    sight.add(frame(3.0, 6.0), HERE)
    assert sight.saw_free((2.0, -0.2, 1.0), 6.0)
    assert sight.reach_m == pytest.approx(0.25)


def test_more_views_than_it_keeps_push_out_the_oldest() -> None:
    sight = looked()
    turned = Pose.from_yaw(math.pi, np.array([-3.0, 0.0, 1.0]))
    up = np.array([0.0, 0.0, 1.0])
    for n in range(1, 480):
        sight.add(frame(1.0, 5.0 + n * 0.0625), turned)
    assert sight.saw_free((2.0, 0.0, 1.0), 35.0, up)
    sight.add(frame(1.0, 35.0), turned)
    assert not sight.saw_free((2.0, 0.0, 1.0), 35.0, up)


def test_views_are_spread_over_the_memory_so_that_a_fast_camera_does_not_shorten_it() -> None:
    sight = looked()
    turned = Pose.from_yaw(math.pi, np.array([-3.0, 0.0, 1.0]))
    for n in range(1, 400):
        sight.add(frame(1.0, 5.0 + n * 0.02), turned)
    assert sight.saw_free((2.0, 0.0, 1.0), 13.0)
    assert sight.saw_free((-3.5, 0.0, 1.0), 13.0)


def test_a_camera_of_another_size_begins_again() -> None:
    sight = looked()
    sight.add(MinRangeGrid(6.0, MOUNT, np.full((3, 4), 2.0, np.float32), (0.95, 0.55), 0.9), HERE)
    assert sight.saw_free((2.0, 0.0, 1.0), 6.0)
    assert not sight.saw_free((3.5, 0.0, 1.0), 6.0), "the first view is gone"


def test_each_cell_of_each_view_is_judged_by_its_own_return() -> None:
    """Places on the rays through the middles of the cells, worked out by hand, a centimetre either side of where free ends."""
    rng = np.random.default_rng(5)
    ranges = rng.uniform(0.6, 4.0, (12, 16)).astype(np.float32)
    for row, column in rng.integers(0, (12, 16), (60, 2)):
        right, down = 0.95 * (2 * column + 1 - 16) / 16, 0.55 * (2 * row + 1 - 12) / 12
        ray = np.array([1.0, -right, -down]) / math.sqrt(1.0 + right**2 + down**2)
        for yaw_rad, body_m in ((0.0, np.array([1.0, 0.0, 1.0])), (2.0, np.array([-2.0, 3.0, 0.5]))):
            there = Pose.from_yaw(yaw_rad, body_m)
            sight = RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=HULL_RADIUS_M)
            sight.add(MinRangeGrid(5.0, MOUNT, ranges, (0.95, 0.55), 0.9), there)
            for beyond_m, free in ((-0.01, True), (0.01, False)):
                place = there.apply(np.array([0.1, 0.0, 0.0]) + ray * (ranges[row, column] - 0.05 + beyond_m))
                assert sight.saw_free((place[0], place[1], place[2]), 6.0) is free
