"""A gap in the way: whether a flight passed it, or looked about in its room and said that it does not enter."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from sitl.faults.flight_evidence import FlightEvidence

_THROUGH_M = 0.3  # before the gap or behind it: the hull is out of it
_WENT_M = 0.3  # from the pad: who lands at once has looked at nothing
_TOO_NARROW = re.compile(r"\b[1-9]\d* (too narrow|not reachable)\b")  # counts of the planner's account


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
        return went and bool((x < self.begin_m).all()) and _TOO_NARROW.search(e.stop_reason) is not None
