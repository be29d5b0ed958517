"""Faults of the pose stream, as a tracking system would cause them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from sitl.faults.injectors.base import InjectionContext, Injector
from sitl.faults.mavlink_proxy import DelayedItems
from sitl.geometry.quaternion import from_yaw, multiply, yaw_of
from sitl.world.pose_tracker import PoseRecord

Change = Callable[[PoseRecord, float], PoseRecord]


class PoseSilence(Injector):
    """No pose for a while."""

    def __init__(self, for_s: float = 1e9) -> None:
        self._for_s = for_s

    def pose(self, since_s: float, record: PoseRecord) -> DelayedItems[PoseRecord]:
        """Drop the pose until for_s."""
        return [] if since_s < self._for_s else [(0.0, record)]


class AlteredPoses(Injector):
    """Wrong poses between two times, up to count of them."""

    def __init__(self, change: Change, from_s: float = 0.0, for_s: float = 1e9, count: int = 1 << 30) -> None:
        self._change = change
        self._from_s = from_s
        self._until_s = from_s + for_s
        self._left = count

    def pose(self, since_s: float, record: PoseRecord) -> DelayedItems[PoseRecord]:
        """Change the pose while the fault lasts."""
        if not self._from_s <= since_s < self._until_s or self._left <= 0:
            return [(0.0, record)]
        self._left -= 1
        return [(0.0, self._change(record, since_s))]


class ThinnedPoses(Injector):
    """At most rate_hz poses a second."""

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._next_s = 0.0

    def pose(self, since_s: float, record: PoseRecord) -> DelayedItems[PoseRecord]:
        """Drop the poses in between."""
        if since_s < self._next_s:
            return []
        self._next_s = since_s + self._period_s
        return [(0.0, record)]


class LatePoses(Injector):
    """Poses that arrive delay_s later."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s

    def pose(self, since_s: float, record: PoseRecord) -> DelayedItems[PoseRecord]:
        """Delay the pose; its time stamp is correct."""
        return [(self._delay_s, record)]


class CoastingPoses(Injector):
    """Poses whose translation goes on at one velocity for a while.

    Rotation and variance are honest. share: of the true velocity as the fault begins; 0: the translation stands still.
    """

    def __init__(self, for_s: float, share: float = 1.0) -> None:
        self._for_s = for_s
        self._share = share
        self._velocity_mps = np.zeros(3)
        self._first: PoseRecord | None = None

    def begin(self, at: InjectionContext) -> None:
        """Take the velocity of the vehicle."""
        self._velocity_mps = self._share * np.array(at.world.flyer.truth().velocity)

    def pose(self, since_s: float, record: PoseRecord) -> DelayedItems[PoseRecord]:
        """Replace the position until for_s; then it is right again at once."""
        if since_s >= self._for_s:
            return [(0.0, record)]
        first = self._first = self._first or record
        position_m = first.position_m + self._velocity_mps * (record.stamp_s - first.stamp_s)
        return [(0.0, dataclasses.replace(record, position_m=position_m))]


class RestartedSource(Injector):
    """A source that starts again.

    Its frame begins at the place and heading of the first pose of the fault. counted: the reset counter is one higher from
    then on.
    """

    def __init__(self, counted: bool) -> None:
        self._counted = counted
        self._first: PoseRecord | None = None

    def pose(self, since_s: float, record: PoseRecord) -> DelayedItems[PoseRecord]:
        """Express the pose in the frame of the restarted source."""
        first = self._first = self._first or record
        w, x, y, z = first.quat_wxyz.tolist()
        back = map_turned(-math.degrees(yaw_of((w, x, y, z))))
        moved_back = dataclasses.replace(record, position_m=record.position_m - first.position_m)
        counter = record.reset_counter + (1 if self._counted else 0)
        return [(0.0, dataclasses.replace(back(moved_back, since_s), reset_counter=counter))]


def claiming(deviation_m: float) -> Change:
    """Return a change of the claimed standard deviation of the position, per axis."""
    return lambda record, _: dataclasses.replace(record, variance=np.array([*[deviation_m**2] * 3, *record.variance[3:]]))


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Change:
    """Return a change that shifts the position in odom, in metres."""
    return lambda record, _: dataclasses.replace(record, position_m=record.position_m + np.array([x, y, z]))


def drifting(x: float = 0.0, y: float = 0.0, z: float = 0.0, max_m: float = 3.0) -> Change:
    """Return a change that shifts the position by a growing distance, in m/s, up to max_m."""

    def change(record: PoseRecord, since_s: float) -> PoseRecord:
        drift_s = min(since_s, max_m / math.hypot(x, y, z))
        return dataclasses.replace(record, position_m=record.position_m + np.array([x, y, z]) * drift_s)

    return change


def scaled(factor: float) -> Change:
    """Return a change to a source whose ways are too long by a factor."""
    return lambda record, _: dataclasses.replace(record, position_m=record.position_m * factor)


def turned(degrees: float) -> Change:
    """Return a change that rotates the heading."""
    turn = from_yaw(math.radians(degrees))

    def change(record: PoseRecord, _: float) -> PoseRecord:
        w, x, y, z = (float(v) for v in record.quat_wxyz)
        return dataclasses.replace(record, quat_wxyz=np.array(multiply(turn, (w, x, y, z))))

    return change


def map_turned(degrees: float) -> Change:
    """Return a change that rotates all of odom about its origin.

    A loop closure does that to a tracker without a map frame.
    """
    turn, angle = turned(degrees), math.radians(degrees)
    c, s = math.cos(angle), math.sin(angle)
    spin = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return lambda record, since_s: dataclasses.replace(turn(record, since_s), position_m=spin @ record.position_m)


def other_origin(yaw_deg: float = 0.0, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Change:
    """Return a change to a source whose origin is not the take-off pad.

    yaw_deg, x, y, z: heading and position (m) of the pad in the source's frame.
    """
    turn, move = map_turned(yaw_deg), moved(x, y, z)
    return lambda record, since_s: move(turn(record, since_s), since_s)


def stamped(shift_s: float) -> Change:
    """Return a change that shifts the time stamp, as another clock does."""
    return lambda record, _: dataclasses.replace(record, stamp_s=record.stamp_s + shift_s)


class FrozenPose(Injector):
    """Every pose with the time stamp of the first one."""

    def __init__(self) -> None:
        self._stamp_s = math.nan

    def pose(self, since_s: float, record: PoseRecord) -> DelayedItems[PoseRecord]:
        """Replace the time stamp; the position is correct."""
        self._stamp_s = record.stamp_s if math.isnan(self._stamp_s) else self._stamp_s
        return [(0.0, dataclasses.replace(record, stamp_s=self._stamp_s))]


def invalid(kind: str) -> Change:
    """Return a change that makes a field invalid.

    kind: "nan place", "inf place", "nan turn", "zero turn", "long turn", "nan variance" or "nan stamp".
    """
    bad = {"nan": math.nan, "inf": math.inf, "zero": 0.0, "long": 1.7}
    word, field = kind.split()

    def change(record: PoseRecord, _: float) -> PoseRecord:
        value = bad[word]
        if field == "place":
            return dataclasses.replace(record, position_m=np.array([value, 0.0, 1.0]))
        if field == "turn":
            quat = record.quat_wxyz * value if word == "long" else np.full(4, value)
            return dataclasses.replace(record, quat_wxyz=quat)
        if field == "variance":
            return dataclasses.replace(record, variance=np.full(6, value))
        return dataclasses.replace(record, stamp_s=value)

    return change
