"""The fault of one flight and its onset condition, made from a scenario and a flight number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sitl.faults.injectors.base import Injector

AFTER_DISARM_S = 2.0


@dataclass(frozen=True)
class Onset:
    """Condition under which a fault begins.

    after_s: the fault begins at a random time in this interval, counted from the end of the climb; from boot if at_boot is set.
    speed_mps: from that time on it begins once the vehicle flies at this speed or faster, unless at_boot is set.
    needs_view_ahead: only while the camera looks in the direction of travel, so that it can see an obstacle ahead.
    min_view_depth_m: only while nothing is nearer than this before the camera, along its level axis.
    away_m: only at this horizontal distance from the pad or farther.
    """

    after_s: tuple[float, float] = (2.0, 8.0)
    speed_mps: float = 0.4
    at_boot: bool = False
    needs_view_ahead: bool = False
    min_view_depth_m: float = 0.0
    away_m: float = 0.0

    def wait_s(self, share: float) -> float:
        """Return the delay chosen within after_s.

        share: random number from 0 to 1; it selects the point in the interval.
        """
        early_s, late_s = self.after_s
        return early_s + (late_s - early_s) * share


@dataclass(frozen=True)
class Fault:
    """The fault of one flight of a scenario.

    scenario: identifier of the scenario.
    injectors: what the fault consists of.
    onset: when it begins.
    observe_s: the flight is observed for this many seconds after the onset at most.
    observe_after_disarm_s: the flight is observed for this many seconds after the motors have stopped.
    """

    scenario: str
    injectors: Sequence[Injector]
    onset: Onset = Onset()
    observe_s: float = 60.0
    observe_after_disarm_s: float = AFTER_DISARM_S
