"""How much of the battery is left, as far as its gauge can be believed (HAZARDS, E5)."""

from __future__ import annotations

import math
from collections import deque

_LASTS_S = 3.0  # a fall that is true stays; a sag under load and a word that is wrong do not
_RISE = 0.10  # nobody charges it in flight; a gauge that goes by the voltage takes back so much of a sag
_LOST_S = 5.0


class BatteryGaugeFilter:
    """One mission's. hear() whatever is said, step by step; ``left`` (share, 0 to 1; NaN before any was heard) is the most that
    was said in the last seconds.

    So a fall counts once it has lasted, whatever its size, and what is too much to be true counts as nothing said.
    """

    def __init__(self) -> None:
        self._heard: deque[tuple[float, float]] = deque()  # from when (s) which share was said; the first at the window's begin
        self._received_s = -math.inf
        self.left = math.nan

    def lost(self, now_s: float) -> bool:
        """Whether nothing credible came for too long. Of a battery that never said anything there is nothing to lose."""
        return bool(self._heard) and now_s - self._received_s > _LOST_S

    def update(self, now_s: float, share: float, flying: bool) -> None:
        """The gauge's word, NaN for none. On the ground it may be another battery."""
        if not flying:
            self._heard.clear()
            self.left = math.nan
        if not 0.0 <= share <= 1.0 or share > self.left + _RISE:  # NaN never is
            return
        self._received_s = now_s
        if not self._heard or share != self._heard[-1][1]:
            self._heard.append((now_s, share))
        while len(self._heard) > 1 and self._heard[1][0] <= now_s - _LASTS_S:
            self._heard.popleft()
        self.left = max(share for _, share in self._heard)
