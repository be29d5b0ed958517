"""Poses of an autopilot that navigates by itself, built from its messages."""

from __future__ import annotations

import math
from collections import deque
from typing import Protocol

import numpy as np

from uav_recon.autopilot.mavlink.messages import Attitude, LocalPosition, Message, OdometryMessage
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose

_APART_S = 0.1  #: reject: a position without an attitude that is this close to it in time
_JUMP_M = 0.1  #: internal: a position farther off its velocity is a reset of the autopilot's estimate
_TURN_RAD = math.radians(8.0)  #: internal: a heading farther off its turn rate is a reset of the autopilot's estimate
_GAP_S = 0.5  #: internal: after a longer silence no jump can be told
_RATE_HZ = 30.0
_ODOMETRY = 331
_VARIANCE = np.repeat((0.02**2, math.radians(0.5) ** 2), 3)  # m², rad²: of poses that come without one


class PoseReports(Protocol):
    """Builds poses from messages.

    streams_hz: messages (id, rate) to request besides those of the firmware.
    """

    streams_hz: tuple[tuple[int, float], ...]

    def poses(self, message: Message, stamp_s: float) -> list[StampedPose]:
        """Return the poses that a message completes, oldest first.

        stamp_s: of the message, on our clock.
        """
        ...


class LocalPositionPoses:
    """LOCAL_POSITION_NED with the attitude at that instant: what the autopilot flies by.

    The messages have no reset counter: a step that neither velocity nor turn rate explains counts as a reset.
    """

    streams_hz: tuple[tuple[int, float], ...] = ()

    def __init__(self) -> None:
        self._attitudes: deque[tuple[float, Attitude]] = deque(maxlen=8)
        self._waiting: deque[tuple[float, LocalPosition]] = deque(maxlen=4)
        self._last: tuple[StampedPose, FloatArray] | None = None  # with its turn rate
        self._resets = 0

    def poses(self, message: Message, stamp_s: float) -> list[StampedPose]:
        """Return the poses that a message completes, oldest first."""
        if isinstance(message, Attitude):
            self._attitudes.append((stamp_s, message))
        elif isinstance(message, LocalPosition):
            self._waiting.append((stamp_s, message))
        done = []
        while self._waiting and self._attitudes and self._waiting[0][0] <= self._attitudes[-1][0]:
            pose = self._pose(*self._waiting.popleft())
            if pose is not None:
                done.append(pose)
        return done

    def _pose(self, stamp_s: float, position: LocalPosition) -> StampedPose | None:
        """Return the position with the nearest attitude, turned to its instant."""
        at_s, attitude = min(self._attitudes, key=lambda entry: abs(entry[0] - stamp_s))
        if abs(at_s - stamp_s) > _APART_S or (self._last is not None and stamp_s <= self._last[0].stamp_s):
            return None
        rate = np.zeros(3) if attitude.rate_radps is None else attitude.rate_radps
        turned = Pose(attitude.quat_wxyz, np.zeros(3)) @ Pose.from_rotation_vector((stamp_s - at_s) * rate, np.zeros(3))
        pose = Pose(turned.quat_wxyz, position.position_m)
        self._resets += self._jumps(stamp_s, pose, position.velocity_mps)
        stamped = StampedPose(stamp_s, pose, position.velocity_mps, np.diag(_VARIANCE), reset_counter=self._resets % 256)
        self._last = stamped, rate
        return stamped

    def _jumps(self, stamp_s: float, pose: Pose, velocity_mps: FloatArray) -> bool:
        """Return True if a pose does not continue the last one."""
        if self._last is None:
            return False
        last, rate = self._last
        dt_s = stamp_s - last.stamp_s
        moved_m = pose.translation_m - last.odom_from_body.translation_m
        off_m = float(np.linalg.norm(moved_m - 0.5 * dt_s * (velocity_mps + last.velocity_odom_mps)))
        turned_rad = pose.yaw_rad() - last.odom_from_body.yaw_rad() - dt_s * float(rate[2])
        return dt_s <= _GAP_S and (off_m > _JUMP_M or abs(math.remainder(turned_rad, math.tau)) > _TURN_RAD)


class OdometryPoses:
    """ODOMETRY of the autopilot, with its reset counter, quality and covariance."""

    streams_hz: tuple[tuple[int, float], ...] = ((_ODOMETRY, _RATE_HZ),)

    def __init__(self) -> None:
        self._newest_s = -math.inf

    def poses(self, message: Message, stamp_s: float) -> list[StampedPose]:
        """Return the pose of an ODOMETRY that is newer than the last one."""
        if not isinstance(message, OdometryMessage) or stamp_s <= self._newest_s:
            return []
        self._newest_s = stamp_s
        pose = Pose(message.quat_wxyz, message.position_m)
        covariance = np.diag(_VARIANCE if message.variance is None else message.variance)
        return [StampedPose(stamp_s, pose, message.velocity_mps, covariance, message.quality, message.reset_counter)]
