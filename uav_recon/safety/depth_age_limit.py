"""Oldest depth in motion: one frame missing at the camera's own rate is no refusal.

A camera of 6 Hz that loses one frame shows nothing new for a third of a second. Its rate is measured from the frames with
enough returns; until it is known, and for every faster camera, the configured limit holds.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

_INTERVALS = 8  #: refuse: intervals of which the median is the camera's; one in three may span a missing frame
_WITHIN_S = 5.0  #: refuse: older frames tell nothing of its rate
_SLACK_S = 0.03  #: refuse: jitter of a frame's arrival
LONGEST_S = 0.5  #: refuse: depth older than this in motion, however slow the camera is: 0.45 m at full speed


class DepthInterval:
    """Measures the longest age of depth, in seconds, that one missing frame causes."""

    def __init__(self) -> None:
        self._stamps_s: deque[float] = deque(maxlen=_INTERVALS + 1)
        self._delays_s: deque[float] = deque(maxlen=_INTERVALS + 1)

    def add(self, stamp_s: float, now_s: float) -> None:
        """Record a frame with enough returns, newer than the one before."""
        self._stamps_s.append(stamp_s)
        self._delays_s.append(now_s - stamp_s)

    @property
    def one_missing_s(self) -> float:
        """Age of the newest frame when the next but one arrives, 0 while the rate is not known."""
        stamps_s = list(self._stamps_s)
        if len(stamps_s) <= _INTERVALS or stamps_s[-1] - stamps_s[0] > _WITHIN_S:
            return 0.0
        intervals_s = sorted(later - earlier for earlier, later in pairwise(stamps_s))
        return 2.0 * intervals_s[_INTERVALS // 2 - 1] + max(self._delays_s) + _SLACK_S


def depth_limit_s(timeout_s: float, one_missing_s: float) -> float:
    """Return the age (s) of the oldest depth in motion.

    It is the configured one, or that of one missing frame where this is longer, up to LONGEST_S. Not a number counts as
    unknown.
    """
    known_s = one_missing_s if math.isfinite(one_missing_s) else 0.0
    return max(timeout_s, min(known_s, LONGEST_S))
