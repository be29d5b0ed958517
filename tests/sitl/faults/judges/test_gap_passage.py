"""A row of a tight passage is passed by flying through or by a refusal in words, never by staying away."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from made_up_evidence import evidence

from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.table.all_scenarios import ROWS
from sitl.faults.table.arenas import GAP
from sitl.faults.table.scenario import judge

REFUSED = "33 frontiers left: 18 not reachable, 8 out of the camera's sight, 2 too narrow"
SPENT = "view budget of 10 spent, 2 frontiers left in the last plan"


def flown_to(farthest_m: float, stop_reason: str, aside_m: float = 0.0) -> FlightEvidence:
    """Out along x and home again, aside of the middle where it is farthest."""
    e = evidence(stop_reason=stop_reason)
    away = np.interp(e.stamp_s, [2.0, 8.0, 14.0], [0.0, 1.0, 0.0])
    place = e.position_m.copy()
    place[:, 0], place[:, 1] = farthest_m * away, aside_m * away
    return dataclasses.replace(e, position_m=place)


def passes(e: FlightEvidence) -> bool:
    return judge(ROWS["F6"], e, []).passed(ROWS["F6"], "px4")


def test_flying_through_passes_if_there_is_room_all_the_way() -> None:
    through = flown_to(GAP.end_m + 1.0, SPENT)
    assert passes(through)
    assert passes(dataclasses.replace(through, hull_m=np.full(400, 0.15)))
    assert not passes(dataclasses.replace(through, hull_m=np.full(400, 0.149)))
    assert not passes(dataclasses.replace(through, failsafes=("x",)))


def test_a_refusal_passes_if_it_looked_about_and_says_why_with_counts() -> None:
    assert passes(flown_to(GAP.begin_m - 0.5, REFUSED))
    assert passes(flown_to(GAP.begin_m - 0.5, "5 frontiers left: 5 too narrow"))
    assert passes(flown_to(0.3, REFUSED, aside_m=0.6)), "not where the gap is, but in the room"
    assert not passes(flown_to(0.1, REFUSED)), "on the pad"
    assert not passes(flown_to(GAP.begin_m + 0.3, REFUSED)), "it was inside"


@pytest.mark.parametrize(
    "said", ["", SPENT, "no frontiers left", "9 frontiers left: 9 outside the fence", "2 frontiers left: 0 too narrow"]
)
def test_a_flight_that_never_came_to_the_gap_or_gives_no_reason_fails(said: str) -> None:
    assert not passes(flown_to(0.3, said, aside_m=0.6))
    assert not passes(flown_to(GAP.begin_m - 0.5, said))
    assert not passes(flown_to(GAP.end_m, said)), "half way"
