"""What of the battery is to be left for the way home (HAZARDS, E5): its length, times what flying burns, and 30 % more.

All of it in shares of the battery, 0 to 1, as the gauge is believed (Charge): a hundredth is its grain.
"""

from __future__ import annotations

import math
from collections import deque

LAND_AT = 0.20  # the autopilot lands there by itself, firmware_params/: nothing below it is the mission's to spend
LOW = 0.30  # where it returns while nothing can be reckoned
MARGIN = 1.3
SPENT_S = 60.0  # of a flight of nothing but a climb, a look round and a landing
# Of 50 ways home, flown in the hall and in eight houses, 0.5 to 9 m long: 6 s and 1.1 s a metre at most, brake, thought and
# turns on the spot included; 1 to 2 s more for each stop to think again (four: 13 s for 3.5 m); at most 9 s from over the pad
# to motors off. A narrow passage of a metre or two goes at 0.2 m/s.
PACE_MPS, AROUND_S, LANDING_S = 0.6, 8.0, 9.0
_MIN_MPS = 0.05

_WHILE_S = 30.0  # so long a gauge is watched before it is reckoned with
_PRIOR_PER_S, _PRIOR_S = 0.002, 60.0  # a battery of eight minutes, as if it had burnt so for the first minute
_FLOOR_PER_S = 0.0005  # of half an hour: no quadrotor of this size hovers on less
_SLIP = 0.03  # no motor burns that from one word to the next: the gauge's own
_GRAIN = 0.01


def flight_s(way_m: float, pace_mps: float) -> float:
    """Seconds from the decision to motors off, for a way of that length at no more than that pace (m/s)."""
    return AROUND_S + way_m / max(min(PACE_MPS, pace_mps), _MIN_MPS) + LANDING_S


def min_charge_for(seconds: float, per_s: float) -> float:
    """The share that is to be there before so many seconds of flight, if each burns per_s: landing is at LAND_AT."""
    return LAND_AT + MARGIN * seconds * per_s


TAKE_OFF = min_charge_for(SPENT_S, _PRIOR_PER_S)  # below it no flight is worth beginning


class ConsumptionEstimator:
    """How much flying burns a second, this flight; to be told what is believed of the gauge, step by step.

    The mean since it was begun, with a pessimistic minute before that, or the last half minute's where that is more. Never
    below a floor. Where the gauge slips, the measure begins anew, as pessimistic as it was.
    """

    def __init__(self) -> None:
        self._begun_s, self._prior_per_s = math.inf, _PRIOR_PER_S
        self._first = self._left = math.nan
        self._lately: deque[tuple[float, float]] = deque()  # instants (s) and shares; the first one held as the while began

    def update(self, now_s: float, left: float, flying: bool) -> None:
        """The believed share; NaN for none. On the ground nothing is burnt."""
        if not flying:
            self._begun_s, self._prior_per_s = math.inf, _PRIOR_PER_S
        elif not math.isnan(left):
            slipped = abs(left - self._left) > _SLIP
            if slipped or self._begun_s == math.inf:
                self._begin(now_s, left)
            self._watch(now_s, left)

    def reckoned(self, now_s: float) -> bool:
        """Whether it was watched for a while, without a slip."""
        return now_s - self._begun_s >= _WHILE_S

    def per_s(self, now_s: float) -> float:
        """Share a second."""
        if self._begun_s == math.inf:
            return self._prior_per_s
        mean = (self._prior_per_s * _PRIOR_S + self._first - self._left) / (_PRIOR_S + now_s - self._begun_s)
        return max(mean, self._of_late(now_s), _FLOOR_PER_S)

    def _begin(self, now_s: float, left: float) -> None:
        self._prior_per_s = max(self._prior_per_s, self.per_s(now_s))
        self._begun_s, self._first = now_s, left
        self._lately.clear()

    def _watch(self, now_s: float, left: float) -> None:
        self._left = left
        if not self._lately or left != self._lately[-1][1]:
            self._lately.append((now_s, left))
        while len(self._lately) > 1 and self._lately[1][0] <= now_s - _WHILE_S:
            self._lately.popleft()

    def _of_late(self, now_s: float) -> float:
        """A grain less than was read, so that none is made up."""
        return (self._lately[0][1] - self._lately[-1][1] - _GRAIN) / _WHILE_S if self.reckoned(now_s) else 0.0
