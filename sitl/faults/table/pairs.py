"""Scenario G10: two faults in one flight; the more severe of the two reactions has to win."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Sequence

from sitl.faults.fault import Onset
from sitl.faults.injectors.base import Injector
from sitl.faults.injectors.delayed import Delayed
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.judges.invariants import USUAL, Room
from sitl.faults.table.acceptance_limits import RETURN_ACTS, STREAMS, UNHEARD_LANDS, down, holds, lands
from sitl.faults.table.scenario import Limit, Scenario

PAIRED = ("A1", "B1", "B4", "C1", "D2", "D8", "E1", "E5", "F2", "G2")
APART_S = 1.0  # longest time between the two onsets
REACTIONS = {  # most severe first: limits of a scenario that hold with any second fault
    "E1": (Limit("stream ends", m.streams_after, 0.3, "s"),),
    "D2": (UNHEARD_LANDS, down(30.0)),
    "B1": (lands(1.2, ardupilot=1.9), down(30.0)),
    "E5": (Limit("charge left", m.battery_left, 0.10, "", at_least=True), down(160.0)),
    "D8": (RETURN_ACTS, down(120.0)),
    "A1": (holds(0.6),),
}
# PX4 reports its mode ten times a second only on request, and the request does not arrive either: by default once a second.
UNHEARD = {"D2+E1": (Limit("stream ends", m.streams_after, 1.3, "s", ardupilot=0.3),)}
# Pushed by 2.5 m/s² while it lands by itself, without setpoints or without a position. It drifts with the push, and must
# not touch anything.
PUSHED = dict.fromkeys(("B1+F2", "D2+F2"), Room(clear_m=0.0, overshoot_m=1.0))
_WATCHED_S = 60.0  # where neither fault requires a reaction


def pair(first: Scenario, second: Scenario) -> Scenario:
    """Return the scenario with two faults in one flight.

    A random draw decides which fault begins first and how much later the other one follows. The onset is the stricter of
    the two, and the flight is the shorter of the two. The limits are those of the more severe reaction, measured from its
    own fault on.
    """
    by_id = {scenario.id: scenario for scenario in (first, second)}
    worse = next((by_id[name] for name in REACTIONS if name in by_id), None)
    name = f"{first.id}+{second.id}"
    return Scenario(
        name,
        f"{first.hazard}, {second.hazard}",
        f"{first.injection}; up to {APART_S:g} s before or after it: {second.injection}",
        lambda n: _both(first, second, n),
        (STREAMS, *(_since(worse.id, UNHEARD.get(name, REACTIONS[worse.id])) if worse else ())),
        onset=_stricter(first.onset, second.onset),
        arena=second.arena if first.arena == "hall" else first.arena,
        observe_s=worse.observe_s if worse else _WATCHED_S,
        views=min(first.views, second.views),
        room=PUSHED.get(name, USUAL),
    )


def _both(first: Scenario, second: Scenario, number: int) -> Sequence[Injector]:
    """Return the injectors of the pair's n-th flight."""
    dice = random.Random(f"{first.id}+{second.id} {number}")
    scenarios = [first, second]
    dice.shuffle(scenarios)
    waits_s = (0.0, dice.uniform(0.0, APART_S))
    return [
        Delayed(injector, wait_s, scenario.id)
        for scenario, wait_s in zip(scenarios, waits_s, strict=True)
        for injector in scenario.injectors(number)
    ]


def _since(scenario: str, limits: Sequence[Limit]) -> list[Limit]:
    """Return limits that are named after and measured from the onset of a scenario's own fault."""
    return [
        dataclasses.replace(limit, name=f"{limit.name} after {scenario}", measure=m.from_note(scenario, limit.measure))
        for limit in limits
    ]


def _stricter(one: Onset, other: Onset) -> Onset:
    """Return an onset that meets both conditions."""
    return Onset(
        after_s=(max(one.after_s[0], other.after_s[0]), max(one.after_s[1], other.after_s[1])),
        speed_mps=max(one.speed_mps, other.speed_mps),
    )
