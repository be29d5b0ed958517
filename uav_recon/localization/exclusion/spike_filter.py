"""Spike filter: leaves out one pose that the pose before it and the next one contradict.

A spike counts twice in comparisons over windows: as their newest pose, and as their oldest one.
"""

from __future__ import annotations

from uav_recon.types.pose import StampedPose

_LEAP_M = 0.15  #: reject: a pose is held until the next one if it is farther from the last one than this ...
_FASTEST_MPS = 2.0  #: reject: ... and what this speed explains


class SpikeFilter:
    """Passes poses on in order, one that leaps with the next one that is near it."""

    def __init__(self) -> None:
        self._last: StampedPose | None = None
        self._held: StampedPose | None = None

    def forget(self) -> None:
        """Forget all poses: the source has started again."""
        self._last = self._held = None

    def passed(self, pose: StampedPose) -> list[StampedPose]:
        """Return the poses to be compared now, oldest first: none if this one leaps."""
        last, held = self._last, self._held
        if held is None and last is not None and _leaps(last, pose):
            self._held = pose
            return []
        self._last, self._held = pose, None
        spike = held is not None and last is not None and not _leaps(last, pose)
        return [pose] if held is None or spike else [held, pose]


def _leaps(one: StampedPose, other: StampedPose) -> bool:
    """Return True if no vehicle moves from one pose to the other."""
    x, y, z = (other.odom_from_body.translation_m - one.odom_from_body.translation_m).tolist()
    most_m = _LEAP_M + _FASTEST_MPS * abs(other.stamp_s - one.stamp_s)
    return bool(x * x + y * y + z * z > most_m * most_m)
