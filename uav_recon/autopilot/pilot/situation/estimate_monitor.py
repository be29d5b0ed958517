"""Estimate monitor: the autopilot's estimate against the poses that it is fed.

Position, velocity, vertical and heading are compared. An autopilot whose estimate differs from the odometry follows its
setpoints beside the path, and reports that all is well (PX4 issues 17466 and 22196). One whose heading differs turns its level
corrections by that angle (PX4 issue 14840): it circles around its setpoint, and from about 45 degrees on wider and wider. The
height of the odometry is also compared with that of the setpoints, which finds whatever else keeps the vehicle from its height.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Setpoint

_MAX_POSITION_M = 0.15  #: hold: the autopilot's position is farther off the poses for _HOLD_S; honest at most 0.04 m
_MAX_VELOCITY_MPS = 0.2  #: hold: its mean velocity is farther off that of the poses for _HOLD_S; honest at most 0.09 m/s
_MAX_HEIGHT_M = 0.3  #: hold: the vehicle is farther above or below its setpoints for _HOLD_S; honest at most 0.07 m
_HOLD_S = 1.0  #: hold: duration of one of these deviations, without a break
_LAND_S = 3.0  #: land: duration of one of these deviations, without a break
#: land: the vehicle is this far above or below its setpoints, or beside one at rest, while position or velocity exceeds its
#: limit: it moves on, and paths keep 0.3 m from the floor
_LEAVES_M = 0.15
_LEAVES_S = 0.2  #: land: duration of that excess
_MAX_OFFSET_M = 0.2  #: refuse: the autopilot's position is farther off on the ground: setpoints are flown off by this offset
_MAX_TILT_RAD = math.radians(15.0)  #: refuse: its vertical is farther off that of the poses on the ground; honest: 2 degrees
_MAX_HEADING_RAD = math.radians(10.0)  #: hold: its heading is farther off the poses' for _HOLD_S; honest: 2.1 degrees
#: land: its heading is farther off for _LEAVES_S. In the air 10 degrees cost 0.09 m beside the path, 20 cost 0.20 m, 30 cost
#: 0.50 m, and 45 diverge; a landing from rest stays within 0.17 m even at 90
_TURNED_RAD = math.radians(20.0)
_STEADY_S = 3.0  #: refuse: its heading was off by _MAX_HEADING_RAD within this time on the ground: it may turn slowly
_AVERAGED_S = 1.0  #: internal: time constant of the offset on the ground
#: hold: nothing is compared for this time after a sensor of odometry was excluded, or odometry was dead reckoning
_SETTLES_S = 1.5
_DOUBTS = (ReasonCode.PLACE_UNSURE, ReasonCode.NO_POSE)  # odometry is dead reckoning
_EXCLUSIONS = (ReasonCode.SOURCE_EXCLUDED, ReasonCode.ACCELEROMETER_REJECTED, ReasonCode.GYRO_REJECTED)
_WINDOW_S = 0.5  #: internal: time over which velocities are averaged
_PAST_S = 1.0  #: internal: poses and estimates are kept for this time, until they can be compared
_ARRIVED_M = 0.1  #: internal: the height is compared with the setpoints once the climb has come this close to its end
_CLIMB_MPS = 0.05  #: internal: setpoints that rise faster are those of a climb


class EstimateMonitor:
    """Compares each estimate with the poses before and after it, at its own stamp.

    A constant offset of position is legal: it is measured on the ground. ArduPilot keeps one in height if it got its origin
    elsewhere. One of heading is not.
    """

    def __init__(self, link: VehicleLink) -> None:
        self._link = link
        self._boot_ms = -1
        self._poses: deque[tuple[float, FloatArray, float]] = deque()  # stamp, position, heading
        self._estimates: deque[_Estimate] = deque()
        self._attitude: FloatArray | None = None  # the newest that was compared
        self._turned_s = -math.inf  # when the heading was last too far off on the ground
        self._window: deque[tuple[float, FloatArray, FloatArray]] = (
            deque()
        )  # instant, position by the poses, estimated velocity
        self._offset_m: FloatArray | None = None
        self._flying = self._climbed = self._arrived = False
        self._compared_s = -math.inf
        self._excluded = False  # a sensor of odometry, at the newest pose
        self._settled_s = -math.inf
        self._off_height_m = self._off_hold_m = 0.0
        self._position = _Deviation(_MAX_POSITION_M)
        self._velocity = _Deviation(_MAX_VELOCITY_MPS)
        self._height = _Deviation(_MAX_HEIGHT_M)
        self._tilt = _Deviation(_MAX_TILT_RAD)
        self._heading = _Deviation(_MAX_HEADING_RAD)
        self._turned = _Deviation(_TURNED_RAD)

    @property
    def hold_reason(self) -> Reason | None:
        """Reason to hold, None for none."""
        return self._lasting(_HOLD_S, height_s=_HOLD_S)

    @property
    def land_reason(self) -> Reason | None:
        """Reason to land, None for none.

        A deviation that already moves the vehicle from its height or hold does not wait, nor does a heading that is far off.
        """
        if self._turned.for_s >= _LEAVES_S:
            return self._heading_reason
        leaves = max(self._off_height_m, self._off_hold_m) > _LEAVES_M
        return self._lasting(_LEAVES_S if leaves else _LAND_S, height_s=_LAND_S)

    @property
    def ground_fault(self) -> Reason | None:
        """Reason not to arm: the offset on the ground is too large, or the axes are others."""
        if self._tilt.for_s >= _HOLD_S:
            return Reason(ReasonCode.AXES_ATTITUDE, (math.degrees(self._tilt.value),))
        if not self._flying and self._compared_s - self._turned_s <= _STEADY_S:
            return self._heading_reason
        off_m = 0.0 if self._offset_m is None else float(np.linalg.norm(self._offset_m))
        return Reason(ReasonCode.ESTIMATE_POSITION, (off_m,)) if off_m > _MAX_OFFSET_M else None

    def begin(self) -> None:
        """Start a flight: the offset is now that of the ground."""
        self.forget()
        self._flying, self._climbed, self._arrived = True, False, False

    def forget(self) -> None:
        """Forget what was compared, as after a jump of odom; the offset remains."""
        self._poses.clear()
        self._estimates.clear()
        self._window.clear()
        self._off_height_m = self._off_hold_m = 0.0
        for deviation in (self._position, self._velocity, self._height, self._heading, self._turned):
            deviation.end()

    def land(self) -> None:
        """End a flight: the offset is measured again."""
        self.forget()
        self._flying = False
        self._offset_m = None

    def update(self, pose: StampedPose | None, now_s: float) -> None:
        """Compare what is new. pose: the newest one that was fed.

        While two autopilots use one id, nothing is compared: the estimate may be of either.
        """
        self._add_pose(pose)
        if pose is not None and not self._flying:
            self._tilt.update(_tilt_rad(pose.odom_from_body, self._link.telemetry.estimate.quat_wxyz), now_s)
        if self._link.status.duplicate_autopilot:
            self.forget()
            return
        self._add_estimate(now_s)
        while self._estimates and self._poses and self._estimates[0].stamp_s <= self._poses[-1][0]:
            self._compare(self._estimates.popleft())
        while self._estimates and now_s - self._estimates[0].stamp_s > _PAST_S:
            self._estimates.popleft()

    def update_setpoint(self, setpoint: Setpoint | None, now_s: float) -> None:
        """Compare the newest pose with the newest setpoint: height, and place at a hold.

        The height counts after the climb. A vehicle that is behind a climb or a descent is late, and not off its height.
        """
        if setpoint is None or not self._poses:
            return
        x_m, y_m = (self._poses[-1][1] - setpoint.position_m)[:2].tolist()
        self._off_hold_m = 0.0 if np.any(setpoint.velocity_mps) else math.hypot(x_m, y_m)
        off_m, up_mps = float(self._poses[-1][1][2] - setpoint.position_m[2]), float(setpoint.velocity_mps[2])
        self._climbed = self._climbed or up_mps > _CLIMB_MPS
        self._arrived = self._arrived or (self._climbed and abs(up_mps) < _CLIMB_MPS and abs(off_m) < _ARRIVED_M)
        late = off_m * up_mps < 0.0
        self._off_height_m = abs(off_m) if self._arrived else 0.0
        self._height.update(0.0 if late else self._off_height_m, now_s)

    def _add_pose(self, pose: StampedPose | None) -> None:
        if pose is None or (self._poses and pose.stamp_s <= self._poses[-1][0]):
            return
        if pose.health in (PoseHealth.LOST, PoseHealth.WRONG):  # the failsafe acts on them, and the autopilot need not follow
            self.forget()
            return
        code = None if pose.health_reason is None else pose.health_reason.code
        excluded = code in _EXCLUSIONS
        # odometry moves to where the vehicle is, and the autopilot follows
        if code in _DOUBTS or (excluded and not self._excluded):
            self._settled_s = pose.stamp_s + _SETTLES_S
        self._excluded = excluded
        if pose.stamp_s < self._settled_s:
            self.forget()
            return
        self._poses.append((pose.stamp_s, pose.odom_from_body.translation_m, pose.odom_from_body.yaw_rad()))
        while self._poses[-1][0] - self._poses[0][0] > _PAST_S:
            self._poses.popleft()

    def _add_estimate(self, now_s: float) -> None:
        """Keep a new estimate.

        Its heading is that of an attitude which arrived since the estimate before, NaN without one.
        """
        new, stamp_s = self._link.telemetry.estimate, self._link.estimate_s(now_s)
        if new.boot_ms == self._boot_ms:
            return
        self._boot_ms = new.boot_ms
        heading_rad = math.nan if new.quat_wxyz is self._attitude else Pose(new.quat_wxyz, new.position_m).yaw_rad()
        self._attitude = new.quat_wxyz
        if abs(stamp_s - now_s) <= _PAST_S:  # False for NaN
            self._estimates.append(_Estimate(stamp_s, new.position_m, new.velocity_mps, heading_rad))

    def _compare(self, estimate: _Estimate) -> None:
        """Compare an estimate that lies between two poses."""
        stamp_s = estimate.stamp_s
        later = next((k for k, (at_s, _, _) in enumerate(self._poses) if at_s >= stamp_s), 0)
        if later == 0:
            return
        (begin_s, begin_m, begin_rad), (end_s, end_m, end_rad) = self._poses[later - 1], self._poses[later]
        part = (stamp_s - begin_s) / (end_s - begin_s)
        fed_m = begin_m + part * (end_m - begin_m)
        off_m = estimate.position_m - fed_m
        if not self._flying:
            share = 1.0 if self._offset_m is None else min(max(stamp_s - self._compared_s, 0.0) / _AVERAGED_S, 1.0)
            before = off_m if self._offset_m is None else self._offset_m
            self._offset_m = before + share * (off_m - before)
        self._compared_s = stamp_s
        self._compare_heading(estimate, begin_rad + part * math.remainder(end_rad - begin_rad, math.tau))
        if self._flying:
            offset_m = np.zeros(3) if self._offset_m is None else self._offset_m
            self._position.update(float(np.linalg.norm(off_m - offset_m)), stamp_s)
            self._compare_velocity(stamp_s, fed_m, estimate.velocity_mps)

    def _compare_heading(self, estimate: _Estimate, fed_rad: float) -> None:
        """Compare the headings.

        An offset on the ground counts too: it turns every correction in the level.
        """
        if math.isnan(estimate.heading_rad):
            return
        off_rad = abs(math.remainder(estimate.heading_rad - fed_rad, math.tau))
        self._heading.update(off_rad, estimate.stamp_s)
        self._turned.update(off_rad, estimate.stamp_s)
        if off_rad > _MAX_HEADING_RAD:
            self._turned_s = estimate.stamp_s

    def _compare_velocity(self, stamp_s: float, fed_m: FloatArray, velocity_mps: FloatArray) -> None:
        """Compare the mean estimated velocity with the distance that the poses moved meanwhile."""
        self._window.append((stamp_s, fed_m, velocity_mps))
        while stamp_s - self._window[0][0] > _WINDOW_S:
            self._window.popleft()
        begin_s, begin_m, _ = self._window[0]
        if stamp_s - begin_s < 0.8 * _WINDOW_S:
            return
        mean_mps = np.mean([velocity for _, _, velocity in self._window], axis=0)
        self._velocity.update(float(np.linalg.norm(mean_mps - (fed_m - begin_m) / (stamp_s - begin_s))), stamp_s)

    @property
    def _heading_reason(self) -> Reason:
        return Reason(ReasonCode.ESTIMATE_HEADING, (math.degrees(self._heading.value),))

    def _lasting(self, least_s: float, height_s: float) -> Reason | None:
        """Return the estimate's deviation that has lasted least_s, or the height's for height_s."""
        if self._heading.for_s >= least_s:
            return self._heading_reason
        if self._position.for_s >= least_s:
            return Reason(ReasonCode.ESTIMATE_POSITION, (self._position.value,))
        if self._velocity.for_s >= least_s:
            return Reason(ReasonCode.ESTIMATE_VELOCITY, (self._velocity.value,))
        return Reason(ReasonCode.OFF_HEIGHT, (self._height.value,)) if self._height.for_s >= height_s else None


def _tilt_rad(odom_from_body: Pose, quat_wxyz: FloatArray) -> float:
    """Return the angle between the vertical of a pose and that of an attitude, in body axes."""
    ups = odom_from_body.rotation()[2], Pose(quat_wxyz, np.zeros(3)).rotation()[2]
    return math.acos(max(min(float(ups[0] @ ups[1]), 1.0), -1.0))


@dataclass(frozen=True, slots=True, eq=False)
class _Estimate:
    """An estimate of the autopilot: position and velocity (3,) in odom, heading.

    heading_rad: NaN without a new attitude.
    """

    stamp_s: float
    position_m: FloatArray
    velocity_mps: FloatArray
    heading_rad: float


class _Deviation:
    """A deviation, and the time in seconds for which it has exceeded its limit without a break."""

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self.end()

    def end(self) -> None:
        """Start again within the limit."""
        self.value = self.for_s = 0.0
        self._since_s = math.inf

    def update(self, value: float, stamp_s: float) -> None:
        """Record the deviation at an instant."""
        self.value = value
        self._since_s = min(self._since_s, stamp_s) if value > self._limit else math.inf
        self.for_s = stamp_s - self._since_s if value > self._limit else 0.0
