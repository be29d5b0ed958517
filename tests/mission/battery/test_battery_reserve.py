"""HAZARDS E5: what the way home needs is its length, times what this flight burns, and 30 % more."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.mission.battery.battery_gauge import BatteryGaugeFilter
from uav_recon.mission.battery.battery_reserve import (
    AROUND_S,
    LAND_AT_SHARE,
    LANDING_S,
    MARGIN_FACTOR,
    PACE_MPS,
    TAKE_OFF_SHARE,
    ConsumptionEstimator,
    flight_s,
    min_charge_for,
)

PERIOD_S = 0.1
WAYS_M = st.floats(0.0, 200.0)
RATES = st.floats(0.0005, 0.02)
SHARES = st.floats(0.0, 1.0)
WORDS = st.lists(st.one_of(SHARES, st.just(math.nan)), max_size=300)


def flown(
    share: float, per_s: float, for_s: float, grain: float = 0.01
) -> tuple[ConsumptionEstimator, BatteryGaugeFilter, float]:
    """A flight with a consumption, read from a gauge in whole hundredths."""
    burn, charge = ConsumptionEstimator(), BatteryGaugeFilter()
    now_s = 0.0
    for k in range(round(for_s / PERIOD_S) + 1):
        now_s = k * PERIOD_S
        charge.update(now_s, round((share - per_s * now_s) / grain) * grain, flying=True)
        burn.update(now_s, charge.left, flying=True)
    return burn, charge, now_s


def test_the_need_of_a_way_by_hand() -> None:
    seconds = flight_s(21.0, math.inf)
    assert seconds == pytest.approx(AROUND_S + 21.0 / PACE_MPS + LANDING_S) == pytest.approx(52.0)
    assert min_charge_for(seconds, 0.001) == pytest.approx(0.20 + 1.3 * 0.052)


def test_where_nothing_fast_is_let_pass_the_way_takes_longer_and_never_for_ever() -> None:
    assert flight_s(12.0, 0.24) == pytest.approx(AROUND_S + 50.0 + LANDING_S)
    assert math.isfinite(flight_s(12.0, 0.0))


@given(WAYS_M, WAYS_M, RATES)
def test_a_far_place_is_left_earlier_than_a_near_one(one_m: float, other_m: float, per_s: float) -> None:
    near_m, far_m = sorted((one_m, other_m))
    near, far = (min_charge_for(flight_s(way_m, math.inf), per_s) for way_m in (near_m, far_m))
    assert near <= far
    assert far - near == pytest.approx(MARGIN_FACTOR * per_s * (far_m - near_m) / PACE_MPS, abs=1e-9)


@given(WAYS_M, RATES, RATES)
def test_what_burns_faster_is_left_earlier_and_never_below_where_it_lands(way_m: float, one: float, other: float) -> None:
    slow, fast = (min_charge_for(flight_s(way_m, math.inf), per_s) for per_s in sorted((one, other)))
    assert LAND_AT_SHARE < slow <= fast


@settings(deadline=None)
@given(st.floats(0.6, 1.0), st.floats(0.0006, 0.005), st.floats(60.0, 120.0))
def test_a_steady_burn_is_met_two_grains_below_at_worst_and_a_pessimistic_minute_above(
    share: float, per_s: float, for_s: float
) -> None:
    burn, _, now_s = flown(share, per_s, for_s)
    most = max((0.12 + per_s * now_s + 0.01) / (60.0 + now_s), per_s + 0.01 / 30.0)
    assert per_s - 0.02 / 30.0 <= burn.per_s(now_s) <= most + 1e-9
    assert burn.is_reliable(now_s)


@settings(deadline=None)
@given(WORDS)
def test_whatever_a_gauge_says_the_figures_are_figures(words: list[float]) -> None:
    charge, burn = BatteryGaugeFilter(), ConsumptionEstimator()
    for k, word in enumerate(words):
        charge.update(0.5 * k, word, flying=True)
        burn.update(0.5 * k, charge.left, flying=True)
        assert 0.0005 <= burn.per_s(0.5 * k) <= 0.2
        assert LAND_AT_SHARE < min_charge_for(flight_s(10.0, math.inf), burn.per_s(0.5 * k)) < 20.0


def test_before_anything_is_measured_a_battery_of_eight_minutes_is_feared() -> None:
    assert ConsumptionEstimator().per_s(0.0) == 0.002
    burn = ConsumptionEstimator()
    burn.update(0.0, 0.9, flying=True)
    assert burn.per_s(0.0) == 0.002
    assert not burn.is_reliable(29.0)


def test_a_gauge_that_stands_still_or_rises_burns_no_less_than_the_floor() -> None:
    burn, _, now_s = flown(0.8, 0.0, 600.0)
    assert burn.per_s(now_s) == 0.0005
    burn, _, now_s = flown(0.5, -0.0005, 300.0)
    assert burn.per_s(now_s) == 0.0005


def test_what_is_drawn_of_late_counts_where_it_is_more() -> None:
    burn, charge, now_s = flown(0.9, 0.0008, 300.0)
    calm = burn.per_s(now_s)
    assert 0.0008 < calm < 0.0011
    for k in range(1, 401):
        charge.update(now_s + k * PERIOD_S, round(0.66 - 0.005 * k * PERIOD_S, 2), flying=True)
        burn.update(now_s + k * PERIOD_S, charge.left, flying=True)
    assert 0.0045 <= burn.per_s(now_s + 40.0) <= 0.0055


def test_where_the_gauge_slips_the_measure_begins_again_as_pessimistic_as_it_was() -> None:
    for per_s, after in ((0.0008, 0.002), (0.005, 0.005)):
        burn, charge, now_s = flown(0.9, per_s, 90.0)
        slipped = round(0.9 - per_s * 90.0 - 0.2, 2)
        for k in range(1, 101):
            charge.update(now_s + k * PERIOD_S, slipped, flying=True)
            burn.update(now_s + k * PERIOD_S, charge.left, flying=True)
        assert burn.per_s(now_s + 3.0) == pytest.approx(after, rel=0.15)
        assert not burn.is_reliable(now_s + 10.0)
        assert burn.is_reliable(now_s + 40.0)


def test_on_the_ground_everything_begins_again() -> None:
    burn, _, now_s = flown(0.9, 0.01, 60.0)
    burn.update(now_s + 1.0, 0.3, flying=False)
    burn.update(now_s + 9.0, 1.0, flying=True)
    assert burn.per_s(now_s + 9.0) == pytest.approx(0.002)
    assert not burn.is_reliable(now_s + 9.0)


def test_what_is_left_of_a_battery_that_may_take_off_covers_a_flight() -> None:
    assert pytest.approx(0.356) == TAKE_OFF_SHARE
