"""A gap in the way: whether a flight passed it, or looked about in its room and said that it does not enter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.reason_codes import FRONTIERS_NOT_REACHABLE, FRONTIERS_TOO_NARROW

_THROUGH_M = 0.3  # before the gap or behind it: the hull is out of it
_WENT_M = 0.3  # from the pad: who lands at once has looked at nothing
_REFUSALS = {FRONTIERS_TOO_NARROW, FRONTIERS_NOT_REACHABLE}  # of the planner, each with a count above zero


@dataclass(frozen=True)
class Gap:
    """Straight ahead of the pad: where it begins and ends, metres along x; its middle is at y = 0."""

    begin_m: float
    end_m: float

    def clearance(self, e: FlightEvidence) -> float:
        """Least metres between the hull and the scene while any of it is in the gap; inf for a vehicle that stays out."""
        x = np.interp(e.hull_s, e.stamp_s, e.position_m[:, 0])
        inside = (x >= self.begin_m - _THROUGH_M) & (x <= self.end_m + _THROUGH_M)
        return float(e.hull_m[inside].min(initial=math.inf))

    def untried(self, e: FlightEvidence) -> float:
        """1 unless the vehicle truly flew through, or looked about, stayed outside and said why with counts."""
        return float(not (self._passed(e) or self._refused(e)))

    def _passed(self, e: FlightEvidence) -> bool:
        return bool(e.position_m[e.armed, 0].max(initial=0.0) >= self.end_m + _THROUGH_M)

    def _refused(self, e: FlightEvidence) -> bool:
        x, y = e.position_m[e.armed, :2].T
        went = bool((np.hypot(x, y) >= _WENT_M).any())
        return went and bool((x < self.begin_m).all()) and not _REFUSALS.isdisjoint(e.stop_codes)
