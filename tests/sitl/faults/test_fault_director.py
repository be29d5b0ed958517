"""When a flight of the campaign is over."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from sitl.faults.fault import Fault, Onset
from sitl.faults.fault_director import FaultDirector, TruthSample
from sitl.faults.injectors.base import Injector
from sitl.faults.table.all_scenarios import SCENARIOS

TURN_S = 1.0 / 60.0


def watched_s(fault: Fault, lands_s: float, lifts_again_s: float = 1e9) -> tuple[float, bool]:
    """Until when a flight is watched that is up at 1 s, and whether the motors ran at the end."""
    director = FaultDirector([fault], seed=1)
    world = SimpleNamespace(flyer=SimpleNamespace(truth=lambda: None))
    seen: Any = SimpleNamespace(world=world, now_s=0.0, notes={})
    director.context = seen
    director._begun_s = 0.0
    for turn in range(60 * 200):
        now_s = seen.now_s = turn * TURN_S
        armed = 1.0 <= now_s < lands_s or now_s >= lifts_again_s
        director._watch(TruthSample(now_s, (0.0, 0.0, 1.2 if armed else 0.0), (0.0, 0.0, 0.0), 0.0, armed, "OFFBOARD", 0.9))
        if director.over(finished=now_s >= lands_s):
            return now_s, armed
    raise AssertionError("never over")


@pytest.mark.parametrize("stands_s", [2.0, 20.0])
def test_a_landed_vehicle_is_watched_for_as_long_as_its_row_says(stands_s: float) -> None:
    fault = Fault("A7", [Injector()], Onset((1.0, 1.0), speed_mps=0.0), 60.0, stands_s)
    end_s, armed = watched_s(fault, lands_s=12.0)
    assert end_s == pytest.approx(12.0 + stands_s, abs=0.05)
    assert not armed


def test_one_that_starts_its_motors_again_is_seen_to() -> None:
    fault = Fault("A7", [Injector()], Onset((1.0, 1.0), speed_mps=0.0), 60.0, SCENARIOS["A7"].observe_after_disarm_s)
    end_s, armed = watched_s(fault, lands_s=12.0, lifts_again_s=17.0)
    assert armed
    assert end_s == pytest.approx(62.0, abs=0.1)
