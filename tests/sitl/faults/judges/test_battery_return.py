"""The reserve of a way home by hand, on a flight there and back."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from made_up_evidence import DT_S, evidence

from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.judges.battery_return import reserve, turned_at
from sitl.faults.table.all_scenarios import SCENARIOS


def there_and_back(share: float, per_s: float, astray_m: float = 0.0) -> FlightEvidence:
    """To 4 m within 8 s, there until 10 s, back over the pad at 14 s, motors off at 18 s. From a share, with a share a second.

    astray_m: at 12 s, 2 m before the pad, it goes out again by this distance.
    """
    e = evidence()
    t = e.stamp_s
    x = np.interp(t, [2.0, 8.0, 10.0, 12.0, 12.3, 14.0], [0.0, 4.0, 4.0, 2.0, 2.0 + astray_m, 0.0])
    place = np.stack([x, np.zeros_like(x), np.interp(t, [0.0, 2.0, 14.0, 17.0], [0.0, 1.0, 1.0, 0.0])], axis=1)
    return dataclasses.replace(e, position_m=place, charge=share - per_s * t)


def test_it_counts_from_where_it_turned_back_waits_included_until_the_motors_stand() -> None:
    e = there_and_back(0.50, 0.01)
    assert turned_at(e) == pytest.approx(4.0)
    assert reserve(e) == pytest.approx((0.50 - 0.08 - 0.20) / 0.10, rel=0.02)


def test_with_less_it_is_less_and_below_one_where_it_did_not_last() -> None:
    assert reserve(there_and_back(0.40, 0.01)) == pytest.approx(1.2, rel=0.02)
    assert reserve(there_and_back(0.36, 0.01)) == pytest.approx(0.8, rel=0.02)
    assert reserve(there_and_back(0.20, 0.01)) < 0.0


def test_round_a_pillar_it_is_the_same_way_and_a_look_elsewhere_begins_another() -> None:
    assert turned_at(there_and_back(0.5, 0.01, astray_m=0.25)) == pytest.approx(4.0)
    assert turned_at(there_and_back(0.5, 0.01, astray_m=0.6)) == pytest.approx(2.6, abs=DT_S)


def test_what_nothing_was_taken_of_lasts_for_ever() -> None:
    assert reserve(there_and_back(0.5, 0.0)) == math.inf
    e = evidence()
    assert reserve(dataclasses.replace(e, armed=np.zeros(len(e.stamp_s), dtype=np.bool_))) == math.inf


def test_row_e5d_wants_a_third_more_than_was_needed_far_from_home() -> None:
    limits = {limit.name: limit for limit in SCENARIOS["E5d"].limits}
    late, soon = there_and_back(0.40, 0.01), there_and_back(0.42, 0.01)
    limit = limits["reserve for the return"]
    assert not limit.holds(limit.measure(late), "px4")
    assert limit.holds(limit.measure(soon), "px4")
    assert not limits["turn-back distance"].holds(turned_at(soon), "px4"), "who never was far away shows nothing"
