"""What the upward range finder saw free lately: cones worked out by hand, and the guard that asks."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from guard_rooms import BOUNDS, HULL_RADIUS_M, guard_of, proposal, situation

from uav_recon.safety.free_cone_memory import FreeConeMemory
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.reason_code import ReasonCode

APEX = (1.0, 0.0, 1.0)
HALF_RAD = math.atan(0.25)


def cone(stamp_s: float = 5.0, apex_m: tuple[float, float, float] = APEX, reach_m: float = 2.0) -> FreeCone:
    return FreeCone(stamp_s, 0, np.array(apex_m), np.array([0.0, 0.0, 1.0]), HALF_RAD, reach_m)


def age_s(memory: FreeConeMemory, place_m: tuple[float, float, float], now_s: float) -> float:
    return float(memory.ages_s(np.array([place_m]), now_s)[0])


@pytest.mark.parametrize(
    ("place_m", "inside"),
    [
        ((1.0, 0.0, 1.01), True),
        ((1.0, 0.0, 0.99), False),
        ((1.249, 0.0, 2.0), True),
        ((1.251, 0.0, 2.0), False),
        ((1.0, -0.249, 2.0), True),
        ((1.0, -0.251, 2.0), False),
        ((1.0, 0.0, 2.94), True),
        ((1.0, 0.0, 2.96), False),
        ((1.45, 0.0, 2.9), False),
    ],
)
def test_free_is_inside_the_cone_and_a_margin_before_its_end(place_m: tuple[float, float, float], inside: bool) -> None:
    memory = FreeConeMemory(10.0, before_m=0.05)
    memory.add(cone())
    assert age_s(memory, place_m, 6.0) == (1.0 if inside else math.inf)


def test_the_newest_cone_around_a_place_counts_and_old_ones_do_not() -> None:
    memory = FreeConeMemory(10.0, before_m=0.05)
    place_m = (1.0, 0.0, 2.0)
    assert age_s(memory, place_m, 5.0) == math.inf
    memory.add(cone(5.0))
    memory.add(cone(7.0))
    memory.add(cone(8.0, (3.0, 0.0, 1.0)))
    assert age_s(memory, place_m, 9.0) == 2.0
    assert memory.ages_s(np.array([place_m, (3.0, 0.0, 2.0)]), 9.0).tolist() == [2.0, 1.0]
    assert age_s(memory, place_m, 17.0) == 10.0
    assert age_s(memory, place_m, 17.01) == math.inf


def test_cones_are_stored_apart_and_last_for_the_whole_memory() -> None:
    memory = FreeConeMemory(10.0, before_m=0.05)
    memory.add(cone(5.0))
    memory.add(cone(5.05, (3.0, 0.0, 1.0)))
    assert age_s(memory, (3.0, 0.0, 2.0), 5.1) == math.inf, "it came too early after the one before"
    memory.add(cone(5.07, (3.0, 0.0, 1.0)))
    assert age_s(memory, (3.0, 0.0, 2.0), 5.1) == pytest.approx(0.03)
    for number in range(1, 159):
        memory.add(cone(5.07 + number * 0.0627, (3.0, 0.0, 1.0)))
    assert age_s(memory, (1.0, 0.0, 2.0), 14.9) == pytest.approx(9.9), "160 are kept"
    memory.add(cone(15.04, (3.0, 0.0, 1.0)))
    assert age_s(memory, (1.0, 0.0, 2.0), 15.0) == math.inf, "the oldest makes room"


def test_a_jump_of_odom_ends_it() -> None:
    sight = RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=HULL_RADIUS_M)
    sight.add_cone(cone())
    assert sight.saw_free((1.0, 0.0, 2.0), 6.0)
    sight.forget()
    assert not sight.saw_free((1.0, 0.0, 2.0), 6.0)
    young = RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=HULL_RADIUS_M)
    young.add_cone(cone(0.5))
    young.forget()
    assert not young.saw_free((1.0, 0.0, 2.0), 1.0)


def test_a_cone_of_the_future_has_no_negative_age() -> None:
    sight = RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=HULL_RADIUS_M)
    sight.add_cone(cone(6.0))
    assert sight.ages_s(np.array([(1.0, 0.0, 2.0)]), 5.9).tolist() == [0.0]


@pytest.mark.parametrize(("speed_mps", "seen", "cleared"), [(0.3, True, True), (0.3, False, False), (0.31, True, False)])
def test_a_climb_is_cleared_slowly_where_the_range_finder_saw_free(speed_mps: float, seen: bool, cleared: bool) -> None:
    """The camera looks level. Beside the axis, where a faster climb also asks, the cone is too narrow so near to it."""
    sight = RecentlySeenSpace(blind_memory_s=60.0, vehicle_radius_m=HULL_RADIUS_M)
    guard = guard_of(bounds=dataclasses.replace(BOUNDS, blind_speed_mps=0.3), sight=sight)
    if seen:
        sight.add_cone(cone(9.0, (1.6, 0.0, 1.05)))
    guard.clear(None, situation(10.0, position_m=(1.6, 0.0, 1.0)))
    _, refusal = guard.clear(proposal((1.6, 0.0, 1.0 + 0.5 * speed_mps), (0.0, 0.0, speed_mps)), situation(10.5))
    assert (refusal is None) is cleared, refusal
    if refusal is not None:
        too_fast = speed_mps > 0.3
        assert refusal.reason.code is (ReasonCode.SPEED_OUT_OF_VIEW if too_fast else ReasonCode.NOT_SEEN_RECENTLY)


def test_a_cone_is_stored_a_hundred_and_sixtieth_of_the_memory_after_the_one_before() -> None:
    place_m = (3.0, 0.0, 2.0)
    for apart_s, stored in ((0.99, False), (1.0, True)):
        memory = FreeConeMemory(160.0, before_m=0.05)
        memory.add(cone(5.0))
        memory.add(cone(5.0 + apart_s, (3.0, 0.0, 1.0)))
        assert (age_s(memory, place_m, 7.0) < math.inf) is stored


def test_the_memory_holds_the_last_hundred_and_sixty_cones_for_a_whole_flight() -> None:
    memory = FreeConeMemory(160.0, before_m=0.05)
    for n in range(500):
        memory.add(cone(float(n), (float(n), 0.0, 1.0)))
    places_m = np.array([(float(n), 0.0, 1.01) for n in range(500)])
    ages_s = memory.ages_s(places_m, 499.0)
    assert np.isfinite(ages_s).sum() == 160
    assert ages_s[340:].tolist() == [499.0 - n for n in range(340, 500)]
