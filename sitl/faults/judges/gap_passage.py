"""Checks of a gap: it was passed, or seen from outside and reported as not passable."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.reason_codes import FRONTIERS_NOT_REACHABLE, FRONTIERS_TOO_NARROW

_THROUGH_M = 0.3  # at this distance before or behind the gap the hull is outside
_WENT_M = 0.3  # from the pad: a vehicle that lands at once has explored nothing
_REFUSALS = {FRONTIERS_TOO_NARROW, FRONTIERS_NOT_REACHABLE}  # reported by the planner only with a count above zero


@dataclass(frozen=True)
class Gap:
    """Gap straight ahead of the pad.

    begin_m and end_m: its extent along x (m). It is centred on y = 0.
    """

    begin_m: float
    end_m: float

    def clearance(self, e: FlightEvidence) -> float:
        """Return the least distance (m) of the hull to the scene while any part of it is in the gap.

        It returns inf for a vehicle that stays outside.
        """
        x = np.interp(e.hull_s, e.stamp_s, e.position_m[:, 0])
        inside = (x >= self.begin_m - _THROUGH_M) & (x <= self.end_m + _THROUGH_M)
        return float(e.hull_m[inside].min(initial=math.inf))

    def untried(self, e: FlightEvidence) -> float:
        """Return 0 if the gap was passed or properly refused, else 1.

        Passed: the true path leads through the gap. Refused: the vehicle explored, stayed outside and reported the reason
        with its counts.
        """
        return float(not (self._passed(e) or self._refused(e)))

    def _passed(self, e: FlightEvidence) -> bool:
        return bool(e.position_m[e.armed, 0].max(initial=0.0) >= self.end_m + _THROUGH_M)

    def _refused(self, e: FlightEvidence) -> bool:
        x, y = e.position_m[e.armed, :2].T
        went = bool((np.hypot(x, y) >= _WENT_M).any())
        return went and bool((x < self.begin_m).all()) and not _REFUSALS.isdisjoint(e.stop_codes)
