"""Refusals: the one counter of rejected proposals, and what a flight concludes from it.

A mission whose requests are all refused is treated like a silent one.
"""

from __future__ import annotations

import math

MANY_REFUSALS = 3  #: hold: this many refusals within _MANY_WITHIN_S; the mission is ignored for a while
_MANY_WITHIN_S = 1.0  #: hold: time within which MANY_REFUSALS count together
_IGNORED_S = 2.0  #: hold: time for which a refusal counts among many
#: land: a motion flown for this time without a refusal ends the time that land_timeout_s limits; a shorter one precedes many a
#: refusal
_MOTION_S = 1.0


class RefusalCounter:
    """Counter of the proposals that guard, mission input and evasion reject.

    ``total``: since the process began.
    """

    def __init__(self) -> None:
        self.total = 0

    def add(self) -> None:
        """Count one refusal."""
        self.total += 1


class RefusalHistory:
    """The refusals of one flight: how dense they are, and how long nothing else came.

    counter: what was counted before this flight does not matter. quiet_s: refusals farther apart do not belong together.
    """

    def __init__(self, counter: RefusalCounter, *, quiet_s: float) -> None:
        self._counter = counter
        self._quiet_s = quiet_s
        self._dense_total = self._motion_total = counter.total
        self._stamps_s: list[float] = []
        self._moving_since_s = self._first_s = math.inf
        self._last_s = -math.inf

    @property
    def refused_s(self) -> float:
        """Duration in seconds of refusals, however rare, without a motion in between."""
        return max(self._last_s - self._first_s, 0.0)

    def many(self, now_s: float) -> bool:
        """Return True while the newest refusals came close together: call it every step.

        MANY_REFUSALS of the last _IGNORED_S came within _MANY_WITHIN_S.
        """
        if self._counter.total > self._dense_total:
            self._stamps_s.append(now_s)
        self._dense_total = self._counter.total
        self._stamps_s = [at_s for at_s in self._stamps_s if now_s - at_s <= _IGNORED_S]
        dense = zip(self._stamps_s, self._stamps_s[MANY_REFUSALS - 1 :], strict=False)
        return any(last_s - first_s <= _MANY_WITHIN_S for first_s, last_s in dense)

    def update(self, moving: bool, now_s: float) -> None:
        """Update the duration with each setpoint. moving: at this instant a motion is flown."""
        self._moving_since_s = min(self._moving_since_s, now_s) if moving else math.inf
        if now_s - self._moving_since_s >= _MOTION_S or now_s - self._last_s > self._quiet_s:
            self._first_s = math.inf
        if self._counter.total > self._motion_total:
            self._first_s = min(self._first_s, now_s)
            self._last_s = now_s
        self._motion_total = self._counter.total
