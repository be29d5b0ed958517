"""Filter of the battery gauge: the plausible remaining charge (hazard E5)."""

from __future__ import annotations

import math
from collections import deque

_LASTS_S = 3.0  #: reject: a fall of the gauge that lasts for less: a sag under load, or a wrong value
#: reject: a larger rise: no battery is charged in flight, but a voltage gauge recovers this much of a sag
_MAX_RISE_SHARE = 0.10
_LOST_S = 5.0  #: return: no plausible value of the battery for longer


class BatteryGaugeFilter:
    """The filter of one mission; call update() with every value, step by step.

    ``left`` (share, 0 to 1; NaN before the first value) is the greatest value of the last seconds. So a fall counts once it has
    lasted, whether small or large, and a value too high to be true is ignored.
    """

    def __init__(self) -> None:
        self._window: deque[tuple[float, float]] = deque()  # (start (s), share); the first is the value at the window's start
        self._received_s = -math.inf
        self.left = math.nan

    def lost(self, now_s: float) -> bool:
        """Return True if no plausible value came for too long.

        False for a battery that never reported a value.
        """
        return bool(self._window) and now_s - self._received_s > _LOST_S

    def update(self, now_s: float, share: float, flying: bool) -> None:
        """Add the gauge's value, NaN for none. On the ground the battery may have been changed."""
        if not flying:
            self._window.clear()
            self.left = math.nan
        if not 0.0 <= share <= 1.0 or share > self.left + _MAX_RISE_SHARE:  # NaN is rejected
            return
        self._received_s = now_s
        if not self._window or share != self._window[-1][1]:
            self._window.append((now_s, share))
        while len(self._window) > 1 and self._window[1][0] <= now_s - _LASTS_S:
            self._window.popleft()
        self.left = max(share for _, share in self._window)
