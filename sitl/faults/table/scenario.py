"""One row of the hazards' table: what goes wrong, when, and the bars that the flight is held to."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from sitl.camera.d435i import Model
from sitl.faults.fault import AFTER_DISARM_S, Onset
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.injectors.base import Capabilities, Injector
from sitl.faults.judges.invariants import USUAL, Room
from sitl.faults.judges.reaction_metrics import Measure
from sitl.scene.scene import HULL_RADIUS_M

Arena = Literal["hall", "pen", "stage", "corridor", "gallery"]
ON_THE_WAY = Onset()
CASES = 12  # no row has more that differ in kind
SHORT_VIEWS = 18  # of a flight that is to end by itself while it is watched


@dataclass(frozen=True)
class Limit:
    """A figure and what it may be at most, or at least; ardupilot: where that firmware's bar is another."""

    name: str
    measure: Measure
    limit: float
    unit: str
    at_least: bool = False
    ardupilot: float | None = None

    def limit_of(self, autopilot: str) -> float:
        """For a personality."""
        return self.ardupilot if autopilot == "ardupilot" and self.ardupilot is not None else self.limit

    def holds(self, figure: float, autopilot: str) -> bool:
        """NaN never does."""
        limit = self.limit_of(autopilot)
        return figure >= limit - 1e-9 if self.at_least else figure <= limit + 1e-9

    def badness(self, figure: float, autopilot: str) -> float:
        """Share of the bar that is used up; above 1 it is broken. For finding the worst."""
        limit = self.limit_of(autopilot)
        if math.isnan(figure):
            return math.inf
        if self.at_least:
            return limit / figure if figure > 0 else math.inf
        return figure / limit if limit > 0 else 1.0 + figure if figure > 0 else 0.0


@dataclass(frozen=True)
class Scenario:
    """injectors: of the n-th flight, so that cases of a row take turns. bars: the figures beside what holds everywhere. why: it
    cannot be flown in lockstep. live: its injectors in real time, where that is another flight. observe_s: observed
    after the fault began, and observe_after_disarm_s after disarming. times: factor of the number of flights in lockstep.
    radii_m: of the hull, cases take turns. variant: of the planner. camera: fast, or small where colour matters. room: that
    it keeps. A flight with a real firmware is any whose troubles need nothing but what that firmware has.
    """

    id: str
    hazard: str
    injection: str
    injectors: Callable[[int], Sequence[Injector]] = lambda n: ()
    bars: tuple[Limit, ...] = ()
    onset: Onset = ON_THE_WAY
    arena: Arena = "hall"
    observe_s: float = 60.0
    views: int = 40
    tier: str = "T0"
    why: str = ""
    live: Callable[[int], Sequence[Injector]] | None = None
    times: int = 1
    variant: str = "adaptive"
    camera: Model = "fast"
    radii_m: tuple[float, ...] = (HULL_RADIUS_M,)
    room: Room = USUAL
    observe_after_disarm_s: float = AFTER_DISARM_S

    def radius_m(self, number: int) -> float:
        """Of the hull in its n-th flight."""
        return self.radii_m[number % len(self.radii_m)]

    def troubles(self, number: int, live: bool) -> Sequence[Injector]:
        """Those of its n-th flight, in lockstep or in real time."""
        return self.live(number) if live and self.live is not None else self.injectors(number)

    def needs(self, number: int, live: bool) -> Capabilities:
        """All that they want of it."""
        return functools.reduce(operator.or_, (trouble.needs for trouble in self.troubles(number, live)), Capabilities.NOTHING)

    def flown(self, live: bool) -> bool:
        """Whether there is a flight of it, in lockstep or in real time."""
        return self.live is not None if live else not self.why

    def flown_by(self, offers: Capabilities) -> bool:
        """Whether there is one in real time with a real firmware, where a flight has so much to give."""
        there_is_one = self.live is not None or not self.why
        return there_is_one and all(self.needs(n, live=True) in offers for n in range(CASES))


@dataclass(frozen=True)
class ScenarioVerdict:
    """Of one flight: a figure for each bar, and what was broken of what holds everywhere."""

    figures: tuple[float, ...]
    broken: tuple[str, ...]

    def passed(self, row: Scenario, autopilot: str) -> bool:
        """All bars and all of the rest."""
        held = all(bar.holds(figure, autopilot) for bar, figure in zip(row.bars, self.figures, strict=True))
        return held and not self.broken


def judge(row: Scenario, evidence: FlightEvidence, broken: Sequence[str]) -> ScenarioVerdict:
    """Hold a flight to its row. broken: of everywhere.violations(). A trouble that never came is no pass."""
    if evidence.onset_s == math.inf:
        return ScenarioVerdict(tuple(math.nan for _ in row.bars), (*broken, "the moment for the trouble never came"))
    return ScenarioVerdict(tuple(float(bar.measure(evidence)) for bar in row.bars), tuple(broken))
