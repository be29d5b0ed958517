"""The poses of the last moments, for measurements that arrive late."""

from __future__ import annotations

import math
from collections import deque

from uav_recon.types.pose import StampedPose

_PAST_S = 0.5  #: internal: poses are stored for this time, to be matched with measurements


class RecentPoses:
    """Poses by stamp, oldest first."""

    def __init__(self) -> None:
        self._past: deque[StampedPose] = deque()

    def add(self, pose: StampedPose | None, now_s: float) -> None:
        """Store a pose if it is newer than the others, and drop old ones."""
        if pose is not None and pose.stamp_s > self.newest_s:
            self._past.append(pose)
        while self._past and now_s - self._past[0].stamp_s > _PAST_S:
            self._past.popleft()

    @property
    def newest_s(self) -> float:
        """Stamp of the newest pose, -infinity without one."""
        return self._past[-1].stamp_s if self._past else -math.inf

    def at(self, stamp_s: float, beside_s: float) -> StampedPose | None:
        """Return the pose nearest in time, None if it is farther away than ``beside_s``."""
        then = min(self._past, key=lambda past: abs(past.stamp_s - stamp_s), default=None)
        return then if then is not None and abs(then.stamp_s - stamp_s) <= beside_s else None

    def forget(self) -> None:
        """Forget all poses after a jump of odom."""
        self._past.clear()
