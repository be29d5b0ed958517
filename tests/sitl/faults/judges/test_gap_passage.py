"""A scenario of a narrow passage is passed by flying through or by a refusal with a reason, never by staying away."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from made_up_evidence import evidence

from sitl.faults import reason_codes as codes
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.table.all_scenarios import SCENARIOS
from sitl.faults.table.arenas import GAP
from sitl.faults.table.scenario import judge

REFUSED = ("frontiers-left", codes.FRONTIERS_NOT_REACHABLE, "frontiers-out-of-view", codes.FRONTIERS_TOO_NARROW)
SPENT = ("views-spent", "frontiers-in-last-plan")


def flown_to(farthest_m: float, stop_codes: tuple[str, ...], aside_m: float = 0.0) -> FlightEvidence:
    """Out along x and home again, aside of the middle where it is farthest."""
    e = evidence(stop_codes=stop_codes)
    away = np.interp(e.stamp_s, [2.0, 8.0, 14.0], [0.0, 1.0, 0.0])
    place = e.position_m.copy()
    place[:, 0], place[:, 1] = farthest_m * away, aside_m * away
    return dataclasses.replace(e, position_m=place)


def passes(e: FlightEvidence) -> bool:
    return judge(SCENARIOS["F6"], e, []).passed(SCENARIOS["F6"], "px4")


def test_flying_through_passes_if_there_is_room_all_the_way() -> None:
    through = flown_to(GAP.end_m + 1.0, SPENT)
    assert passes(through)
    assert passes(dataclasses.replace(through, hull_m=np.full(400, 0.15)))
    assert not passes(dataclasses.replace(through, hull_m=np.full(400, 0.149)))
    assert not passes(dataclasses.replace(through, failsafes=("x",)))


def test_a_refusal_passes_if_it_looked_about_and_says_why_with_counts() -> None:
    assert passes(flown_to(GAP.begin_m - 0.5, REFUSED))
    assert passes(flown_to(GAP.begin_m - 0.5, ("frontiers-left", codes.FRONTIERS_TOO_NARROW)))
    assert passes(flown_to(0.3, REFUSED, aside_m=0.6)), "not where the gap is, but in the room"
    assert not passes(flown_to(0.1, REFUSED)), "on the pad"
    assert not passes(flown_to(GAP.begin_m + 0.3, REFUSED)), "it was inside"


@pytest.mark.parametrize(
    "said", [(), SPENT, ("no-frontiers-left",), ("frontiers-left", "frontiers-outside-fence"), ("frontiers-left",)]
)
def test_a_flight_that_never_came_to_the_gap_or_gives_no_reason_fails(said: tuple[str, ...]) -> None:
    assert not passes(flown_to(0.3, said, aside_m=0.6))
    assert not passes(flown_to(GAP.begin_m - 0.5, said))
    assert not passes(flown_to(GAP.end_m, said)), "half way"
