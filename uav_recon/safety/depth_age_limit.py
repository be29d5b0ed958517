"""Oldest depth in motion: one frame missing at the camera's own rate is no refusal.

A camera of 6 Hz that loses one frame shows nothing new for a third of a second. Its rate is measured from the frames with
enough returns; until it is known, and for every faster camera, the configured limit holds.
"""

from __future__ import annotations

import math
import statistics
from collections import deque
from itertools import pairwise

#: refuse: frames whose eight intervals tell the camera's, by their lower median: half of them may span a missing one
_FRAMES = 9
_WITHIN_S = 5.0  #: refuse: frames over a longer time tell nothing of its rate
_SLACK_S = 0.03  #: refuse: jitter of a frame's arrival
LONGEST_S = 0.5  #: refuse: depth older than this in motion, however slow the camera is: 0.45 m at full speed


class DepthInterval:
    """Measures the longest age of depth, in seconds, that one missing frame causes."""

    def __init__(self) -> None:
        self._frames: deque[tuple[float, float]] = deque(maxlen=_FRAMES)  # stamp and delay

    def add(self, stamp_s: float, now_s: float) -> None:
        """Record a frame with enough returns, newer than the one before."""
        self._frames.append((stamp_s, now_s - stamp_s))

    @property
    def one_missing_s(self) -> float:
        """Age of the newest frame when the next but one arrives, 0 while the rate is not known."""
        if len(self._frames) < _FRAMES or self._frames[-1][0] - self._frames[0][0] > _WITHIN_S:
            return 0.0
        interval_s = statistics.median_low(later - earlier for (earlier, _), (later, _) in pairwise(self._frames))
        return 2.0 * interval_s + max(delay_s for _, delay_s in self._frames) + _SLACK_S


def depth_limit_s(timeout_s: float, one_missing_s: float) -> float:
    """Return the age (s) of the oldest depth in motion.

    It is the configured one, or that of one missing frame where this is longer, up to LONGEST_S. Not a number counts as
    unknown.
    """
    known_s = one_missing_s if math.isfinite(one_missing_s) else timeout_s
    return max(timeout_s, min(known_s, LONGEST_S))
