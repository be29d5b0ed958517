"""Row G10: two of the table's troubles in one flight; the worse of the two reactions is to win."""

from __future__ import annotations

import dataclasses
import math
import random
from collections.abc import Sequence

from sitl.faults.fault import Onset
from sitl.faults.injectors.base import Injector
from sitl.faults.injectors.delayed import Delayed
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.judges.invariants import USUAL, Room
from sitl.faults.judges.reaction_metrics import Measure
from sitl.faults.table.acceptance_limits import RETURN_ACTS, STREAMS, UNHEARD_LANDS, down, holds, lands
from sitl.faults.table.scenario import Limit, Scenario

PAIRED = ("A1", "B1", "B4", "C1", "D2", "D8", "E1", "E5", "F2", "G2")
APART_S = 1.0  # at most, between the one trouble and the other
REACTIONS = {  # worst first: what of a row's own bars holds whatever else goes wrong
    "E1": (Limit("stream ends", m.streams_after, 0.3, "s"),),
    "D2": (UNHEARD_LANDS, down(30.0)),
    "B1": (lands(1.2), down(30.0)),
    "E5": (Limit("charge left", m.battery_left, 0.10, "", at_least=True), down(160.0)),
    "D8": (RETURN_ACTS, down(120.0)),
    "A1": (holds(0.6),),
}
# PX4 says its mode ten times a second as long as it is asked to, and that does not arrive either: once a second by itself.
UNHEARD = {"D2+E1": (Limit("stream ends", m.streams_after, 1.3, "s", ardupilot=0.3),)}
# Pushed by 2.5 m/s² while it lands by itself, without a word of ours or without a position: it goes where the push
# takes it, and touches nothing.
PUSHED = dict.fromkeys(("B1+F2", "D2+F2"), Room(clear_m=0.0, overshoot_m=1.0))
_WATCHED_S = 60.0  # where neither asks for a reaction


def pair(first: Scenario, second: Scenario) -> Scenario:
    """Both troubles, the dice say which of them begins and how much later the other comes, in the stricter moment of the two,
    on the shorter flight. Held to what the worse of their reactions is held to, counted from its own trouble on.
    """
    by_id = {row.id: row for row in (first, second)}
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
    """Of the n-th flight of the pair."""
    dice = random.Random(f"{first.id}+{second.id} {number}")
    rows = [first, second]
    dice.shuffle(rows)
    waits_s = (0.0, dice.uniform(0.0, APART_S))
    return [
        Delayed(trouble, wait_s, row.id) for row, wait_s in zip(rows, waits_s, strict=True) for trouble in row.injectors(number)
    ]


def _since(row: str, bars: Sequence[Limit]) -> list[Limit]:
    """Each told and measured from the moment on that a row's own trouble began."""
    return [dataclasses.replace(bar, name=f"{bar.name} after {row}", measure=_from(row, bar.measure)) for bar in bars]


def _from(row: str, measure: Measure) -> Measure:
    """NaN where the row's trouble never began."""
    return lambda e: measure(dataclasses.replace(e, onset_s=e.notes[row])) if row in e.notes else math.nan


def _stricter(one: Onset, other: Onset) -> Onset:
    """A moment that both would take."""
    return Onset(
        after_s=(max(one.after_s[0], other.after_s[0]), max(one.after_s[1], other.after_s[1])),
        speed_mps=max(one.speed_mps, other.speed_mps),
    )
