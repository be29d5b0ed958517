"""Odometry of the embedded SLAM: the tracker's state, propagated by the inertial samples.

No filter stands behind the tracker. Its state after each frame is a node; the present is the newest node propagated by the
samples since, an earlier instant lies on the path between two nodes.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, replace

import numpy as np

from uav_recon.localization.fusion.error_release import ErrorRelease
from uav_recon.localization.fusion.filter_pose_gates import PoseRejection
from uav_recon.localization.fusion.imu_sample_gate import ImuSampleGate
from uav_recon.localization.fusion.inertial_check import InertialCheck
from uav_recon.localization.fusion.pose_stream_health import most_quality
from uav_recon.localization.slam.kept_map import KeptMap, NoKeptMap
from uav_recon.localization.slam.motion_filter import PredictedMotion, propagate
from uav_recon.localization.slam.moving_parts import MovingParts
from uav_recon.localization.slam.place_errors import PLACE
from uav_recon.localization.slam.slam_tracker import SlamTracker
from uav_recon.localization.slam.track_start import OdomAt
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_KEPT_S = 2.0  #: reject: late frames are possible for this time
_LATE_S = 0.25  #: hold: the newest accepted frame is older: the vehicle stops while its velocity is known
#: hold: the newest accepted frame is older: the place counts as lost, and pose_timeout_s and pose_land_s run
_SILENT_S = 1.5
_SILENT_BLIND_S = 1.0  #: hold: the same without an accelerometer
_SILENT_FLOW_S = 5.0  #: hold: the same while optical flow measures the motion to each frame
_UNSURE_S = 3.5  #: hold: the place has been uncertain for longer than a way back to a view that shows it takes, and ...
_UNSURE_M = 0.08  #: hold: ... its standard deviation against the track is larger: it counts as lost
_SURE_FRAMES = 3  #: hold: number of sure frames in a row that end this time: one alone may fit by chance before a bare wall
_FADES_S = 0.5  #: hold: quality falls to zero within this time after the place is lost
#: reject: after a loss, a place that does not fit dead reckoning until this many frames are accepted
_RETURN_FRAMES = 8
_JUMP_M = 0.15  #: reject: such a place is farther from dead reckoning than this, and odom restarts there
#: internal: a frame after a gap, or after one that was wrong, moves odometry at once by no more
_STEP_M = 0.03
_LEFT_M = 0.05  #: retreat: while more than this of an error found after a gap is not yet in odometry
_POSITION_SIGMA_M = 0.01
_ROTATION_SIGMA_RAD = math.radians(0.3)


@dataclass(frozen=True, slots=True, eq=False)
class _Node:
    """The tracker's state at what a frame shows. pose: None if it was not accepted."""

    stamp_s: float
    motion: PredictedMotion
    odom_from_body: Pose
    pose: StampedPose | None


class ViewOdometry:
    """Odometry of any recent instant from the tracked frames. Not thread-safe.

    world_from_tracker: None: known with the first add_pose(). ``newest_pose``: of the newest accepted frame, in the tracker's
    frame; ``newest_pose_s``: its stamp, -inf before the first. ``shown`` (3, 3): share of its place that the view has
    determined, in the tracker's axes. ``rejected``: counts of inertial samples. ``check``: of the inertial sensors.
    ``kept_map``: the map of an earlier flight, in which this one is looked for.
    """

    def __init__(
        self, tracker: SlamTracker, world_from_tracker: Pose | None = None, kept_map: KeptMap | NoKeptMap | None = None
    ) -> None:
        self.tracker = tracker
        self.kept_map = kept_map or NoKeptMap()
        self.rejected: Counter[PoseRejection] = Counter()
        self.check = InertialCheck(tracker.gyro.at)
        self._gate = ImuSampleGate(self.rejected)
        self._moving = MovingParts()
        self.source_excluded = False
        self.confirmed_s = -math.inf
        self.newest_pose_s = -math.inf
        self._world_from_tracker = world_from_tracker
        self._nodes: deque[_Node] = deque()
        self.newest_pose: StampedPose | None = None
        self.shown: FloatArray = np.eye(3)
        self._release = ErrorRelease()
        self._reset_counter = 0
        self._sure_s = -math.inf  # stamp of the newest frame in a row of sure ones
        self._sure_frames = _SURE_FRAMES
        self._returning = 0  # frames that must still be accepted after a loss

    def add_imu(self, samples: list[ImuSample], now_s: float = math.inf) -> None:
        """Add inertial samples, oldest first; invalid ones are counted and dropped."""
        self.tracker.add_imu(self._gate.valid(samples, now_s))

    def track(self, frame: Frame, body_from_depth: Pose) -> StampedPose | None:
        """Track a frame. Return the body's pose at what it shows, None if it is not known.

        What moves in the view is left out of it.
        """
        pose = self.tracker.track(frame, body_from_depth, self._still(frame, body_from_depth))
        state = self.tracker.state
        if state is None:
            return None
        stamp_s = state.stamp_s
        if self._nodes and stamp_s <= self._nodes[-1].stamp_s:
            return None
        before = self.odom_at(stamp_s) if self._goes_on(stamp_s) else None
        if pose is not None:
            self._accept(pose)
            self.shown = self.tracker.determined
            self._check_inertial(pose)
            if self.sure:
                self.kept_map.look(frame, pose.odom_from_body @ body_from_depth)
        self._nodes.append(_Node(stamp_s, state.motion, state.odom_from_body, pose))
        self._continue(before)
        while stamp_s - self._nodes[0].stamp_s > _KEPT_S:
            self._nodes.popleft()
        return pose

    def _still(self, frame: Frame, body_from_depth: Pose) -> Frame:
        """Return a frame without the parts that move against the predicted pose."""
        if not self._nodes or frame.stamp_s <= self._nodes[-1].stamp_s:
            return frame
        motion, attitude = self._propagated(self._nodes[-1], frame.stamp_s)
        return self._moving.without(frame, Pose(attitude.quat_wxyz, motion.place_m) @ body_from_depth)

    @property
    def moved_s(self) -> float:
        """Stamp of the newest frame of which a large part moved; -inf before the first."""
        return self._moving.moved_s

    @property
    def sure(self) -> bool:
        """True if the newest frames in a row were sure of the place, and odometry is there."""
        there = self.newest_pose is not None and self.newest_pose.health is PoseHealth.GOOD
        return self._sure_frames >= _SURE_FRAMES and there

    def restart(self, odom_at: OdomAt) -> None:
        """Begin a new map at the next frame, from other odometry; see SlamTracker.restart."""
        self.tracker.restart(odom_at)
        self.check.forget()
        self._moving.forget()
        self._nodes.clear()
        self.newest_pose = None
        self._returning, self._sure_frames, self._sure_s = 0, _SURE_FRAMES, -math.inf

    def add_pose(self, pose: StampedPose, now_s: float) -> bool:
        """Take a pose of track() in the world: odometry is in the world from then on.

        Return False for another pose.
        """
        tracked = (node.pose for node in reversed(self._nodes) if node.pose is not None)
        same = next((own for own in tracked if own.stamp_s == pose.stamp_s), None)
        if same is not None:
            self._world_from_tracker = pose.odom_from_body @ same.odom_from_body.inverse()
        return same is not None

    def add_view(self, now_s: float) -> None:
        """Do nothing: each frame was taken when it was tracked."""

    def odom_at(self, stamp_s: float) -> StampedPose | None:
        """Return the body's pose at an instant.

        None before the first pose in the world, and too long ago.
        """
        world, newest = self._world_from_tracker, self.newest_pose
        if world is None or newest is None or not self._nodes or stamp_s < self._nodes[0].stamp_s:
            return None
        k = next(n for n in range(len(self._nodes) - 1, -1, -1) if self._nodes[n].stamp_s <= stamp_s)
        motion, attitude = self._propagated(self._nodes[k], stamp_s)
        if k + 1 < len(self._nodes):
            motion, attitude = self._towards(self._nodes[k], self._nodes[k + 1], motion, attitude, stamp_s)
        age_s = stamp_s - self.newest_pose_s
        left_m = self._release.left_m(stamp_s)
        health, reason = self._health(stamp_s, newest, float(np.linalg.norm(left_m)))
        pose, turn = world @ Pose(attitude.quat_wxyz, motion.place_m), world.rotation()
        sigma2 = np.diag([_POSITION_SIGMA_M**2] * 3 + [_ROTATION_SIGMA_RAD**2] * 3)
        sigma2[PLACE, PLACE] += turn @ motion.place_covariance @ turn.T
        return StampedPose(
            stamp_s,
            Pose(pose.quat_wxyz, pose.translation_m + left_m),
            turn @ motion.velocity_mps,
            sigma2,
            self._quality(health, age_s, newest.quality),
            self._reset_counter,
            0,
            health,
            reason,
        )

    def _accept(self, pose: StampedPose) -> None:
        """Take the pose of an accepted frame."""
        if self.newest_pose is not None and pose.stamp_s - self.newest_pose_s > self._silent_s:
            carried, _ = self._propagated(self._nodes[-1], pose.stamp_s)
            if math.dist(carried.place_m.tolist(), pose.odom_from_body.translation_m.tolist()) > _JUMP_M:
                self._returning = _RETURN_FRAMES
                self._reset_counter = (self._reset_counter + 1) % 256
        self._returning = max(self._returning - 1, 0)
        self._sure_frames = self._sure_frames + 1 if self.tracker.sure else 0
        if self._sure_frames >= _SURE_FRAMES or math.isinf(self._sure_s):
            self._sure_s = pose.stamp_s
        self.newest_pose, self.newest_pose_s = pose, pose.stamp_s

    def _check_inertial(self, pose: StampedPose) -> None:
        """Compare the inertial sensors with the track, and leave out those that it contradicts."""
        self.check.update(pose.stamp_s, pose.odom_from_body, self.tracker.determined, self.tracker.step_sigma_m)
        accelerometer, gyro = self.check.accelerometer, self.check.gyro
        if accelerometer.fault or accelerometer.right(pose.stamp_s):
            self.tracker.accelerometer_used = not accelerometer.fault
        self.tracker.gyro.used = not gyro.fault

    def _goes_on(self, stamp_s: float) -> bool:
        """Return True if odometry goes on from its prediction where a frame is a step away from it.

        After a gap always, else with all inertial sensors: without them each frame is a step, and odometry would lag behind.
        """
        return stamp_s - self.newest_pose_s > _LATE_S or (bool(self._nodes) and self._sensor_fault() is None)

    def _continue(self, before: StampedPose | None) -> None:
        """Let odometry go on from where it was if the newest frame is a step away.

        The frame need not be accepted. before: odometry without the frame; None if odometry takes the frame at once.
        """
        if before is None or self._world_from_tracker is None or before.reset_counter != self._reset_counter:
            return
        node = self._nodes[-1]
        found = self._world_from_tracker @ Pose(node.odom_from_body.quat_wxyz, node.motion.place_m)
        step_m = before.odom_from_body.translation_m - found.translation_m
        left_m = self._release.left_m(node.stamp_s)
        if float(np.linalg.norm(step_m - left_m)) > _STEP_M:
            self._release.begin(node.stamp_s, step_m)

    def _propagated(self, node: _Node, stamp_s: float) -> tuple[PredictedMotion, Pose]:
        """Return motion and attitude at an instant after a node, by dead reckoning."""
        step_s = stamp_s - node.stamp_s
        track = self.tracker.gyro.between(node.stamp_s, stamp_s)
        turned = self.tracker.gyro.turned(node.stamp_s, stamp_s)
        attitude = node.odom_from_body
        if turned is not None:
            attitude = attitude @ Pose.from_rotation_vector(turned, np.zeros(3))
        used = track if self.tracker.accelerometer_used else None
        return propagate(node.motion, step_s, node.odom_from_body, used), attitude

    def _towards(
        self, node: _Node, after: _Node, motion: PredictedMotion, attitude: Pose, stamp_s: float
    ) -> tuple[PredictedMotion, Pose]:
        """Return motion and attitude between two nodes; the path ends at the later one."""
        share = (stamp_s - node.stamp_s) / (after.stamp_s - node.stamp_s)
        end, end_attitude = self._propagated(node, after.stamp_s)
        off = after.motion.state - end.state
        turn = share * (after.odom_from_body @ end_attitude.inverse()).rotation_vector()
        turned = Pose.from_rotation_vector(turn, np.zeros(3)) @ attitude
        return replace(motion, state=motion.state + share * off), Pose(turned.quat_wxyz, np.zeros(3))

    def _health(self, stamp_s: float, newest: StampedPose, left_m: float) -> tuple[PoseHealth, Reason | None]:
        age_s = stamp_s - self.newest_pose_s
        late = Reason(ReasonCode.NO_POSE, (max(age_s, 0.0),))
        if age_s > self._silent_s or stamp_s - self._nodes[-1].stamp_s > _SILENT_S or self._returning:
            return PoseHealth.LOST, late
        unsure_s = _SILENT_FLOW_S if self._flow else _UNSURE_S
        unsure = self._sure_frames < _SURE_FRAMES and self.tracker.step_sigma_m > _UNSURE_M
        if unsure and stamp_s - self._sure_s > unsure_s:
            return PoseHealth.LOST, newest.health_reason or late
        if age_s > _LATE_S:
            return PoseHealth.DEGRADED, late
        if newest.health is not PoseHealth.GOOD:
            return newest.health, newest.health_reason
        if left_m > _LEFT_M:
            return PoseHealth.DEGRADED, Reason(ReasonCode.PLACE_UNSURE, (left_m,))
        fault = self._sensor_fault()
        return (PoseHealth.GOOD, None) if fault is None else (PoseHealth.DEGRADED, fault)

    def _sensor_fault(self) -> Reason | None:
        """Return the reason why not all inertial sensors are used, None if they are."""
        if self._gate.gyro_frozen:
            return Reason(ReasonCode.IMU_FROZEN)
        if self.tracker.gyro.at(self._nodes[-1].stamp_s) is None:
            return Reason(ReasonCode.AUTOPILOT_GYRO if self._gate.without_accelerometer else ReasonCode.NO_IMU)
        if not self.tracker.gyro.used:
            return Reason(ReasonCode.GYRO_REJECTED)
        if self._gate.accelerometer_frozen:
            return Reason(ReasonCode.ACCELEROMETER_FROZEN)
        return None if self.tracker.accelerometer_used else Reason(ReasonCode.ACCELEROMETER_REJECTED)

    @property
    def _silent_s(self) -> float:
        if self._flow:
            return _SILENT_FLOW_S
        return _SILENT_S if self.tracker.accelerometer_used else _SILENT_BLIND_S

    @property
    def _flow(self) -> bool:
        """True while another source knows the motion, but for moments."""
        return self._nodes[-1].stamp_s - self.tracker.moved_outside_s < _LATE_S

    def _quality(self, health: PoseHealth, age_s: float, source: int) -> int:
        share = min(1.0, max(0.0, (self._silent_s + _FADES_S - age_s) / _FADES_S))
        return min(most_quality(health), math.ceil(source * share))
