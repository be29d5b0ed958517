"""Battery reserve for the way home: length times consumption, and 30 % more (hazard E5).

All values are shares of the battery, 0 to 1, as filtered by BatteryGaugeFilter; the resolution is one hundredth.
"""

from __future__ import annotations

import math
from collections import deque

LAND_AT_SHARE = 0.20  #: land: the autopilot lands there by itself, firmware_params/: the mission must not plan with less
LOW_SHARE = 0.30  #: return: at this charge while consumption cannot be estimated
MARGIN_FACTOR = 1.3  #: return: factor on the charge that the way home is expected to take
SHORTEST_FLIGHT_S = 60.0  #: refuse: a take-off without the charge for this: a climb, a look round and a landing
# Measured on 50 ways home, flown in the hall and in eight houses, 0.5 to 9 m long: 6 s and 1.1 s per metre at most, braking,
# planning and turns on the spot included; 1 to 2 s more for each stop to plan again (four: 13 s for 3.5 m); at most 9 s from
# over the pad to motors off. A narrow passage of a metre or two is flown at 0.2 m/s.
PACE_MPS = 0.6  #: return: mean speed on the way home
AROUND_S = 8.0  #: return: time on the way home that does not depend on its length
LANDING_S = 9.0  #: return: time from over the pad to motors off
_MIN_MPS = 0.05  #: return: the way home is never expected to be slower

_WHILE_S = 30.0  #: return: a gauge is observed for this time before it is used for estimates; until then at LOW_SHARE
_PRIOR_PER_S = 0.002  #: return: consumption of a battery of eight minutes, expected before any is measured
_PRIOR_S = 60.0  #: return: the measured consumption counts as if this time before it had consumed as expected
_FLOOR_PER_S = 0.0005  #: return: a battery of half an hour: no quadrotor of this size hovers on less
_MAX_STEP_SHARE = 0.03  #: reject: a larger step between two values is a jump of the gauge, not consumption
_GRAIN_SHARE = 0.01  #: return: step of the gauge, taken off the recent consumption, so that none is made up
#: refuse: a take-off with less charge: the shortest flight would already end below LAND_AT_SHARE
TAKE_OFF_SHARE = LAND_AT_SHARE + MARGIN_FACTOR * SHORTEST_FLIGHT_S * _PRIOR_PER_S


def flight_s(way_m: float, pace_mps: float) -> float:
    """Return the seconds from the decision to motors off.

    way_m: length of the path. pace_mps: speed limit (m/s).
    """
    return AROUND_S + way_m / max(min(PACE_MPS, pace_mps), _MIN_MPS) + LANDING_S


def min_charge_for(seconds: float, per_s: float) -> float:
    """Return the share that a flight of this duration needs at its start.

    Landing is at LAND_AT_SHARE. per_s: consumption per second.
    """
    return LAND_AT_SHARE + MARGIN_FACTOR * seconds * per_s


class ConsumptionEstimator:
    """Estimates the consumption per second of this flight; call update() in each step.

    The estimate is the mean since the start, with a pessimistic minute before that, or the mean of the last half minute if that
    is greater. It is never below a floor. After a jump of the gauge the measurement restarts, as pessimistic as it was.
    """

    def __init__(self) -> None:
        self._begun_s = math.inf
        self._prior_per_s = _PRIOR_PER_S
        self._first = self._left = math.nan
        self._lately: deque[tuple[float, float]] = deque()  # instants (s) and shares; the first is that at the window's start

    def update(self, now_s: float, left: float, flying: bool) -> None:
        """Add the filtered share; NaN for none. On the ground nothing is consumed."""
        if not flying:
            self._begun_s = math.inf
            self._prior_per_s = _PRIOR_PER_S
        elif not math.isnan(left):
            slipped = abs(left - self._left) > _MAX_STEP_SHARE
            if slipped or self._begun_s == math.inf:
                self._begin(now_s, left)
            self._watch(now_s, left)

    def is_reliable(self, now_s: float) -> bool:
        """Return True if the gauge was observed for long enough without a jump."""
        return now_s - self._begun_s >= _WHILE_S

    def per_s(self, now_s: float) -> float:
        """Return the consumption per second, as a share."""
        if self._begun_s == math.inf:
            return self._prior_per_s
        mean = (self._prior_per_s * _PRIOR_S + self._first - self._left) / (_PRIOR_S + now_s - self._begun_s)
        return max(mean, self._of_late(now_s), _FLOOR_PER_S)

    def _begin(self, now_s: float, left: float) -> None:
        self._prior_per_s = max(self._prior_per_s, self.per_s(now_s))
        self._begun_s = now_s
        self._first = left
        self._lately.clear()

    def _watch(self, now_s: float, left: float) -> None:
        self._left = left
        if not self._lately or left != self._lately[-1][1]:
            self._lately.append((now_s, left))
        while len(self._lately) > 1 and self._lately[1][0] <= now_s - _WHILE_S:
            self._lately.popleft()

    def _of_late(self, now_s: float) -> float:
        """Return the recent consumption, less one step of the gauge, so that none is made up."""
        return (self._lately[0][1] - self._lately[-1][1] - _GRAIN_SHARE) / _WHILE_S if self.is_reliable(now_s) else 0.0
