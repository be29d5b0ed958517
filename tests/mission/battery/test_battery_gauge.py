"""HAZARDS E5: impossible jumps of the battery's word are not believed, a fall that lasts is, and silence is noticed."""

from __future__ import annotations

import math
from collections.abc import Iterable

import pytest

from uav_recon.mission.battery.battery_gauge import BatteryGaugeFilter

PERIOD_S = 0.05


def told(
    *said: tuple[float, float], charge: BatteryGaugeFilter | None = None, flying: bool = True, begun_s: float = 0.0
) -> BatteryGaugeFilter:
    """A charge that was read at each share for some seconds."""
    charge = charge or BatteryGaugeFilter()
    for k, share in enumerate(_each(said)):
        charge.update(begun_s + k * PERIOD_S, share, flying)
    return charge


def _each(said: Iterable[tuple[float, float]]) -> Iterable[float]:
    return [share for for_s, share in said for _ in range(round(for_s / PERIOD_S))]


def test_of_a_battery_that_never_spoke_nothing_is_known_and_nothing_is_lost() -> None:
    charge = told((30.0, math.nan))
    assert math.isnan(charge.left)
    assert not charge.lost(30.0)


@pytest.mark.parametrize(("for_s", "left"), [(0.05, 0.44), (2.9, 0.44), (3.1, 0.24), (20.0, 0.24)])
def test_a_fall_by_a_fifth_is_believed_once_it_has_lasted(for_s: float, left: float) -> None:
    assert told((5.0, 0.44), (for_s, 0.24)).left == left


def test_a_word_that_comes_and_goes_is_never_believed() -> None:
    assert told((5.0, 0.44), *[(2.0, 0.05), (0.05, 0.44)] * 10).left == 0.44


def test_a_steady_fall_is_followed_three_seconds_late() -> None:
    charge = BatteryGaugeFilter()
    for k in range(400):
        charge.update(k * PERIOD_S, 0.40 - 0.01 * k * PERIOD_S, flying=True)
    assert charge.left == pytest.approx(0.40 - 0.01 * (400 * PERIOD_S - 3.0), abs=0.002)


def test_nobody_charges_a_battery_in_flight() -> None:
    charge = told((5.0, 0.30), (5.2, 0.95))
    assert charge.left == 0.30
    assert charge.lost(10.2), "what cannot be is nothing said"
    assert told((5.0, 0.30), (5.0, 0.39)).left == 0.39, "a sag that ends"


def test_on_the_ground_it_may_be_another_battery() -> None:
    charge = told((5.0, 0.30))
    charge.update(6.0, 0.98, flying=False)
    assert charge.left == 0.98


def test_silence_of_five_seconds_is_a_loss_and_the_next_word_ends_it() -> None:
    charge = told((5.0, 0.80), (10.0, math.nan))
    last_s = 5.0 - PERIOD_S
    assert not charge.lost(last_s + 4.99)
    assert charge.lost(last_s + 5.01)
    charge.update(15.0, 0.79, flying=True)
    assert not charge.lost(15.0)


def test_a_word_after_a_silence_has_to_last_as_well() -> None:
    charge = told((5.0, 0.80))
    charge.update(9.0, 0.10, flying=True)
    assert charge.left == 0.80
    assert told((3.1, 0.10), charge=charge, begun_s=9.05).left == 0.10


@pytest.mark.parametrize("share", [-0.01, 1.01, math.inf, -math.inf, math.nan])
def test_what_is_no_share_is_nothing_said(share: float) -> None:
    charge = told((5.0, 0.80), (6.0, share))
    assert charge.left == 0.80
    assert charge.lost(11.0)
