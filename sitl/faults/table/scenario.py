"""One scenario of the fault table: the fault, its onset, and the limits of the flight."""

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
from sitl.faults.injectors.pose_stream import AlteredPoses, claiming
from sitl.faults.judges.invariants import USUAL, Room
from sitl.faults.judges.reaction_metrics import Measure
from sitl.scene.scene import HULL_RADIUS_M

Arena = Literal["hall", "pen", "stage", "corridor", "gallery", "room"]
ON_THE_WAY = Onset()
CASES = 12  # no scenario has more different cases
SHORT_VIEWS = 30  # for a flight that has to complete within the observed time; the first 18 may all be taken near the pad


@dataclass(frozen=True)
class Limit:
    """Limit on a measure: at most, or at least.

    ardupilot: the limit for ArduPilot, where it differs.
    """

    name: str
    measure: Measure
    limit: float
    unit: str
    at_least: bool = False
    ardupilot: float | None = None

    def limit_of(self, autopilot: str) -> float:
        """Return the limit for an autopilot."""
        return self.ardupilot if autopilot == "ardupilot" and self.ardupilot is not None else self.limit

    def holds(self, figure: float, autopilot: str) -> bool:
        """Return whether a value meets the limit; NaN never does."""
        limit = self.limit_of(autopilot)
        return figure >= limit - 1e-9 if self.at_least else figure <= limit + 1e-9

    def badness(self, figure: float, autopilot: str) -> float:
        """Return the used share of the limit, for finding the worst; above 1 it is violated."""
        limit = self.limit_of(autopilot)
        if math.isnan(figure):
            return math.inf
        if self.at_least:
            return limit / figure if figure > 0 else math.inf
        return figure / limit if limit > 0 else 1.0 + figure if figure > 0 else 0.0


@dataclass(frozen=True)
class Scenario:
    """One scenario.

    injectors: those of the n-th flight; the cases of a scenario are cycled.
    limits: its limits, beside the general limits.
    why: reason why it cannot be flown in lockstep.
    live: injectors in real time, if it can be flown there.
    observe_s: time of observation after the fault began; observe_after_disarm_s: after disarming.
    times: factor of the number of flights in lockstep.
    variant: of the planner.
    camera: fast, or small where colour matters.
    poses: source of the poses, as in `sim --pose`.
    claimed_m: standard deviation that the source claims for its positions, per axis, from boot on; None: its true one of 1 cm.
    radii_m: radii of the hull; they are cycled.
    room: limits on the surroundings.

    With a real firmware those scenarios can be flown whose injectors need only what that firmware offers.
    """

    id: str
    hazard: str
    injection: str
    injectors: Callable[[int], Sequence[Injector]] = lambda n: ()
    limits: tuple[Limit, ...] = ()
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
    poses: str = "stream"
    claimed_m: float | None = None
    radii_m: tuple[float, ...] = (HULL_RADIUS_M,)
    room: Room = USUAL
    observe_after_disarm_s: float = AFTER_DISARM_S

    def radius_m(self, number: int) -> float:
        """Return the hull radius (m) of its n-th flight."""
        return self.radii_m[number % len(self.radii_m)]

    def injectors_of(self, number: int, live: bool) -> Sequence[Injector]:
        """Return the injectors of its n-th flight, in lockstep or in real time."""
        return self.live(number) if live and self.live is not None else self.injectors(number)

    def needs(self, number: int, live: bool) -> Capabilities:
        """Return the capabilities that the injectors of its n-th flight need."""
        return functools.reduce(
            operator.or_, (injector.needs for injector in self.injectors_of(number, live)), Capabilities.NOTHING
        )

    def flown(self, live: bool) -> bool:
        """Return whether it can be flown, in lockstep or in real time."""
        return self.live is not None if live else not self.why

    def flown_by(self, offers: Capabilities) -> bool:
        """Return whether it can be flown in real time with a firmware of these capabilities."""
        there_is_one = self.live is not None or not self.why
        return there_is_one and all(self.needs(n, live=True) in offers for n in range(CASES))


def standing_conditions(claimed_m: float | None) -> Sequence[Injector]:
    """Return what acts on a flight from boot on, before and beside its fault.

    claimed_m: as in Scenario.
    """
    return [] if claimed_m is None else [AlteredPoses(claiming(claimed_m))]


@dataclass(frozen=True)
class ScenarioVerdict:
    """Verdict of one flight.

    figures: a value for each limit. broken: messages of the violated general limits.
    """

    figures: tuple[float, ...]
    broken: tuple[str, ...]

    def passed(self, scenario: Scenario, autopilot: str) -> bool:
        """Return whether all limits are met."""
        held = all(limit.holds(figure, autopilot) for limit, figure in zip(scenario.limits, self.figures, strict=True))
        return held and not self.broken


def judge(scenario: Scenario, evidence: FlightEvidence, broken: Sequence[str]) -> ScenarioVerdict:
    """Evaluate the limits of a scenario for one flight.

    broken: the result of invariants.violations(). A flight whose fault never began does not pass.
    """
    if evidence.onset_s == math.inf:
        return ScenarioVerdict(tuple(math.nan for _ in scenario.limits), (*broken, "the fault's onset condition was never met"))
    return ScenarioVerdict(tuple(float(limit.measure(evidence)) for limit in scenario.limits), tuple(broken))
