"""Timer of refusals without motion.

A mission whose requests are all refused is treated like a silent one.
"""

from __future__ import annotations

import math

#: land: a motion flown for this time without a refusal ends the time that land_timeout_s limits; a shorter one precedes many a
#: refusal
_MOTION_S = 1.0


class RefusalTimer:
    """The timer of one flight.

    ``refused_s``: from the first refusal since a motion to the last; 0 if none came for quiet_s.
    """

    def __init__(self, quiet_s: float, refusals: int = 0) -> None:
        self._quiet_s = quiet_s
        self._refusals = refusals
        self._moving_since_s = self._first_s = math.inf
        self._last_s = -math.inf

    @property
    def refused_s(self) -> float:
        """Duration in seconds of refusals, however rare, without a motion in between."""
        return max(self._last_s - self._first_s, 0.0)

    def update(self, refusals: int, moving: bool, now_s: float) -> None:
        """Update the timer.

        refusals: number of refusals. moving: at this instant a motion is flown.
        """
        self._moving_since_s = min(self._moving_since_s, now_s) if moving else math.inf
        if now_s - self._moving_since_s >= _MOTION_S or now_s - self._last_s > self._quiet_s:
            self._first_s = math.inf
        if refusals > self._refusals:
            self._first_s = min(self._first_s, now_s)
            self._last_s = now_s
        self._refusals = refusals
