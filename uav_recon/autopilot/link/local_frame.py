"""Odom in the local frame of an autopilot that navigates by itself.

Its local frame has its own origin and heading, and jumps where its estimate is reset; odom has its origin at the pad and never
jumps. Setpoints leave, and estimates arrive, through local_from_odom.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from itertools import pairwise

import numpy as np

from uav_recon.autopilot.mavlink.messages import Attitude, LocalPosition
from uav_recon.types.frames import FloatArray, frozen
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.trajectory import Setpoint

_AVERAGED_S = 1.0  #: internal: time constant of local_from_odom
_STEP_M = 0.1  #: internal: a larger change of local_from_odom is a reset of either side, and is taken over at once
_STEP_RAD = math.radians(4.0)  #: internal: likewise for the heading


class LocalFrame:
    """Measures local_from_odom: turn about the vertical and translation, None until it is known.

    Odometry and the autopilot's own poses are compared at the stamps of the latter; their delays do not matter.
    """

    def __init__(self) -> None:
        self._odom: deque[StampedPose] = deque(maxlen=16)
        self._own: deque[StampedPose] = deque(maxlen=16)
        self._measured_s = -math.inf
        self.local_from_odom: Pose | None = None

    def add_odometry(self, pose: StampedPose) -> None:
        """Process a pose in odom."""
        if self._odom and (pose.reset_counter != self._odom[-1].reset_counter or pose.stamp_s <= self._odom[-1].stamp_s):
            self._odom.clear()
        self._odom.append(pose)
        while self._own and self._own[0].stamp_s <= pose.stamp_s:
            self._compare(self._own.popleft())

    def add_estimate(self, pose: StampedPose) -> None:
        """Process a pose in the local frame. It is compared once odometry has passed its stamp."""
        self._own.append(pose)

    def _compare(self, own: StampedPose) -> None:
        for before, after in pairwise(self._odom):
            if before.stamp_s <= own.stamp_s <= after.stamp_s:
                share = (own.stamp_s - before.stamp_s) / (after.stamp_s - before.stamp_s)
                self._update(own, *_between(before.odom_from_body, after.odom_from_body, share))
                return

    def _update(self, own: StampedPose, odom_m: FloatArray, odom_yaw_rad: float) -> None:
        """Take over a step at once, and anything smaller slowly."""
        turn_rad, local_m = own.odom_from_body.yaw_rad() - odom_yaw_rad, own.odom_from_body.translation_m
        last, share = self.local_from_odom, 1.0
        if last is not None:
            off_m, off_rad = local_m - last.apply(odom_m), math.remainder(turn_rad - last.yaw_rad(), math.tau)
            if math.hypot(*off_m.tolist()) <= _STEP_M and abs(off_rad) <= _STEP_RAD:
                share = min(max(own.stamp_s - self._measured_s, 0.0) / _AVERAGED_S, 1.0)
            turn_rad, local_m = last.yaw_rad() + share * off_rad, last.apply(odom_m) + share * off_m
        self._measured_s = own.stamp_s
        self.local_from_odom = _frame(turn_rad, odom_m, local_m)


def moved(setpoint: Setpoint, local_from_odom: Pose) -> Setpoint:
    """Return a setpoint of odom in the local frame, whose vertical is the same."""
    turn = local_from_odom.rotation()
    return Setpoint(
        local_from_odom.apply(setpoint.position_m),
        turn @ setpoint.velocity_mps,
        turn @ setpoint.acceleration_mps2,
        setpoint.yaw_rad + local_from_odom.yaw_rad(),
        setpoint.yaw_rate_radps,
        setpoint.camera_pitch_down_rad,
    )


def in_odom(message: LocalPosition | Attitude, local_from_odom: Pose | None) -> LocalPosition | Attitude:
    """Return a position or attitude of the local frame in odom.

    It is unchanged while that frame is not known.
    """
    odom_from_local = (local_from_odom or Pose.identity()).inverse()
    if isinstance(message, Attitude):
        return replace(message, quat_wxyz=(odom_from_local @ Pose(message.quat_wxyz, np.zeros(3))).quat_wxyz)
    position_m, velocity_mps = odom_from_local.apply(message.position_m), odom_from_local.rotation() @ message.velocity_mps
    return replace(message, position_m=frozen(position_m), velocity_mps=frozen(velocity_mps))


def _between(before: Pose, after: Pose, share: float) -> tuple[FloatArray, float]:
    """Return position and heading between two poses."""
    place_m = before.translation_m + share * (after.translation_m - before.translation_m)
    turn_rad = math.remainder(after.yaw_rad() - before.yaw_rad(), math.tau)
    return place_m, before.yaw_rad() + share * turn_rad


def _frame(turn_rad: float, odom_m: FloatArray, local_m: FloatArray) -> Pose:
    """Return the frame that is turned by turn_rad and takes one point to another."""
    turned = Pose.from_yaw(turn_rad, local_m)
    return Pose(turned.quat_wxyz, local_m - turned.rotation() @ odom_m)
