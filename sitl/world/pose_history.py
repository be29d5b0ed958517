"""Recent true poses of the vehicle, interpolated."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

from sitl.geometry.quaternion import Quat, Vec3, normalised

LENGTH_S = 0.5
_SAME_S = 1e-6  # rounding of the clocks of simulator and autopilot


@dataclass(frozen=True, slots=True)
class PastPose:
    """True pose world_from_body at a time, and the gimbal's tilt as the autopilot reports it."""

    stamp_s: float
    position: Vec3
    quat_wxyz: Quat
    gimbal_pitch_down_rad: float


class PoseHistory:
    """True poses of the last LENGTH_S."""

    def __init__(self) -> None:
        self._poses: list[PastPose] = []
        self._stamps_s: list[float] = []

    def add(self, pose: PastPose) -> None:
        """Add a pose; one that is not newer than the last replaces it."""
        if self._stamps_s and pose.stamp_s <= self._stamps_s[-1]:
            self._poses[-1] = pose
            self._stamps_s[-1] = pose.stamp_s
            return
        self._poses.append(pose)
        self._stamps_s.append(pose.stamp_s)
        if self._stamps_s[0] < pose.stamp_s - 2.0 * LENGTH_S:
            old = bisect_right(self._stamps_s, pose.stamp_s - LENGTH_S) - 1
            del self._poses[:old], self._stamps_s[:old]

    def at(self, stamp_s: float) -> PastPose:
        """Return the pose at a time; the oldest before it, the newest, unchanged, from its time on.

        Between two poses the position is interpolated linearly, and the rotation along the chord, which differs from the
        arc by less than 1e-5 rad for poses 10 ms apart. Raises IndexError without a pose.
        """
        after = bisect_right(self._stamps_s, stamp_s)
        if after == 0:
            return self._poses[0]
        if stamp_s >= self._stamps_s[-1] - _SAME_S:
            return self._poses[-1]
        a, b = self._poses[after - 1], self._poses[after]
        share = (stamp_s - a.stamp_s) / (b.stamp_s - a.stamp_s)
        (ax, ay, az), (bx, by, bz) = a.position, b.position
        return PastPose(
            stamp_s,
            (ax + share * (bx - ax), ay + share * (by - ay), az + share * (bz - az)),
            _between(a.quat_wxyz, b.quat_wxyz, share),
            a.gimbal_pitch_down_rad + share * (b.gimbal_pitch_down_rad - a.gimbal_pitch_down_rad),
        )


def _between(a: Quat, b: Quat, share: float) -> Quat:
    sign = 1.0 if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] >= 0.0 else -1.0
    keep, take = 1.0 - share, share * sign
    return normalised(
        (keep * a[0] + take * b[0], keep * a[1] + take * b[1], keep * a[2] + take * b[2], keep * a[3] + take * b[3])
    )
