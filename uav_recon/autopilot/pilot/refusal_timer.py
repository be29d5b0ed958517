"""Refusals that lead nowhere: a mission that wants nothing but what is refused flies no better than a silent one."""

from __future__ import annotations

import math

_MOTION_S = 1.0  # flown without a refusal for so long is a motion; a moment of one comes before many a refusal


class RefusalTimer:
    """One flight's. ``refused_s``: from the first refusal since a motion to the last; 0 where none came for quiet_s."""

    def __init__(self, quiet_s: float, refusals: int = 0) -> None:
        self._quiet_s, self._refusals = quiet_s, refusals
        self._moving_since_s = self._first_s = math.inf
        self._last_s = -math.inf

    @property
    def refused_s(self) -> float:
        """Seconds for which refusals have come, however seldom, and no motion between them."""
        return max(self._last_s - self._first_s, 0.0)

    def update(self, refusals: int, moving: bool, now_s: float) -> None:
        """refusals: so far. moving: a motion that leads somewhere is flown at this instant."""
        self._moving_since_s = min(self._moving_since_s, now_s) if moving else math.inf
        if now_s - self._moving_since_s >= _MOTION_S or now_s - self._last_s > self._quiet_s:
            self._first_s = math.inf
        if refusals > self._refusals:
            self._first_s, self._last_s = min(self._first_s, now_s), now_s
        self._refusals = refusals
