"""Perception step: inertial samples and late poses in, odometry and posed frames out."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import replace

from uav_recon.clock import RateKeeper
from uav_recon.geometry import min_range_binning
from uav_recon.geometry.min_range_binning import nearest_in_cells
from uav_recon.interfaces import Channel, Clock, DepthCamera, PoseSource
from uav_recon.localization.calibration.camera_motion import CameraMotion
from uav_recon.localization.calibration.camera_mount import Mount
from uav_recon.localization.calibration.kept_calibration import KeptCalibration
from uav_recon.localization.consistency import axis_monitor, planar_patches
from uav_recon.localization.consistency.axis_monitor import AxisMonitor
from uav_recon.localization.consistency.depth_consistency import CorrectedDrift, DepthConsistencyMonitor
from uav_recon.localization.consistency.reconciled_consistency import ReconciledConsistency
from uav_recon.localization.correction.odometry_correction import NoCorrection, OdometryCorrection
from uav_recon.localization.fusion import error_propagation
from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.localization.fusion.inertial_selection import InertialSelection
from uav_recon.types.camera import Frame, PosedFrame
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import TurnRates

_OLDEST_FRAME_S = 1.0  #: reject: an older frame
_FUTURE_S = 0.01  #: reject: a frame stamped later than the clock by this
_WAITING_FRAMES = 4  #: reject: the oldest of more frames that wait for a pose: at 15 Hz this is more than the longest wait
_ANGLE_WAIT_S = 0.08  #: internal: a frame waits for the angle of the camera's mount at its stamp, not for longer
_STATUS_RATE_HZ = 1.0
_MOMENT_S = 0.03  #: internal: time over which the velocity of the camera is measured


class Perception:
    """Runs the perception stages in order; call step() at about 100 Hz.

    One step costs about 1 ms and never blocks.

    Odometry is published at rate_hz, stamped now, with its health and odom's pose in the world. After the filter's pose_lost_s
    without a pose, a last one with quality 0 is published, and then none until poses arrive again.

    A frame waits until a pose at or after its stamp was fused, or frame_wait_s. It gets the pose of the instant that it shows,
    and depth at its true scale, as far as the camera's errors are known. A frame is dropped if its own pose is not known, if it
    is rejected as inconsistent, or if it is not newer than all before it: it was mapped already, or its turn has passed. The
    minimum range grid of a frame is published with or without a pose, valid or not: at once, or with a gimbal once its angle at
    the stamp has been measured.

    Odometry that depth contradicts has health WRONG; its quality stays, because it is better than none for landing.
    consistency: compares depth with earlier views; None: with poses that do not come from the frames.
    ``published_odom`` and ``published_frames`` are counters, ``dropped_frames`` counts by reason; all of them are published
    once a second, with the origin of the poses, the camera's errors, and remarks(), what the camera says of itself.

    rates: turn rates of the autopilot, which take the place of a camera's IMU that is missing or frozen.
    """

    def __init__(
        self,
        camera: DepthCamera,
        poses: PoseSource,
        fusion: FusionFilter,
        mount: Mount,
        odom: Channel[StampedPose],
        frames: Channel[PosedFrame],
        nearby: Channel[MinRangeGrid],
        status: Channel[PerceptionStatus],
        clock: Clock,
        rate_hz: float = 30.0,
        frame_wait_s: float = 0.2,
        *,
        origin: Callable[[], Reason | None] = lambda: None,
        remarks: Callable[[], tuple[Reason, ...]] = tuple,
        rates: Channel[TurnRates] | None = None,
        kept: KeptCalibration | None = None,
        consistency: DepthConsistencyMonitor | ReconciledConsistency | None = None,
        correction: OdometryCorrection | None = None,
    ) -> None:
        self._camera = camera
        self._poses = poses
        self._fusion = fusion
        self._mount = mount
        self._odom = odom
        self._frames = frames
        self._nearby = nearby
        self._status = status
        self._clock = clock
        self._frame_wait_s = frame_wait_s
        self._origin = origin
        self._remarks = remarks
        self._inertial = InertialSelection(camera.imu, rates)
        self._kept = kept
        self._correction = correction or NoCorrection()
        self._depth_consistency = consistency or DepthConsistencyMonitor()
        self._axes = AxisMonitor()
        warm_up()
        self._rate = RateKeeper(rate_hz, clock.now_s())
        self._status_rate = RateKeeper(_STATUS_RATE_HZ, clock.now_s())
        self._arrived: deque[Frame] = deque()  # wait for the angle of the mount
        self._waiting: deque[Frame] = deque()  # wait for a pose
        self._newest_frame_s = -math.inf  # never later than now: no stamp of another clock can block the frames after it
        self._said_lost = True
        self.published_odom = self.published_frames = 0
        self.dropped_frames: Counter[ReasonCode] = Counter()
        self._newest_drop: tuple[float, Reason | None] = -math.inf, None

    def step(self) -> None:
        """Read new inputs and publish what is due."""
        now_s = self._clock.now_s()
        self._mount.observe()
        samples = self._inertial.samples(self._clock.now_s)
        self._fusion.add_imu(samples, self._clock.now_s())
        self._axes.add_imu(samples)
        self._correction.add_imu(samples)
        for pose in self._poses.poses():
            self._fusion.add_pose(pose, now_s)
            self._axes.add_pose(pose)
        self._correction.advance(now_s, self._depth_consistency.confirms)
        if self._rate.due(now_s):
            self._publish_odom(now_s)
        if self._status_rate.due(now_s):
            self._status.publish(self._status_at(now_s))
            self._keep_calibration(now_s)
        self._take_frame(now_s)  # after the status: a camera that is gone raises
        self._publish_frame(now_s)

    def close(self) -> None:
        """Write the camera's errors for the next flight, if they are kept. Blocks for milliseconds."""
        if self._kept is not None:
            self._kept.close(self._depth_consistency.calibration_filter)

    def _keep_calibration(self, now_s: float) -> None:
        if self._kept is not None:
            monitor = self._depth_consistency
            wrong = self._wrong(now_s) is not None
            self._kept.update(now_s, monitor.calibration_filter, at_rest=monitor.at_rest, wrong=wrong)

    def _wrong(self, now_s: float) -> Reason | None:
        """Return why nobody may fly by the odometry, None for nothing."""
        return self._axes.reason or self._depth_consistency.drift(now_s)

    def _odom_at(self, stamp_s: float) -> StampedPose | None:
        """Return corrected odometry at an instant."""
        estimate = self._fusion.odom_at(stamp_s)
        return None if estimate is None else self._correction.corrected(estimate)

    def _registered_at(self, stamp_s: float) -> StampedPose | None:
        """Return odometry as the tracker's map has it, at an instant."""
        estimate = self._fusion.odom_at(stamp_s)
        return None if estimate is None else self._correction.registered(estimate)

    def _publish_odom(self, now_s: float) -> None:
        estimate = self._odom_at(now_s)
        if estimate is None or (estimate.quality == 0 and self._said_lost):
            return
        wrong = self._wrong(now_s)
        if wrong:
            estimate = replace(estimate, health=PoseHealth.WRONG, why=wrong)
        self._odom.publish(estimate)
        self.published_odom += 1
        self._said_lost = estimate.quality == 0

    def _take_frame(self, now_s: float) -> None:
        frame = self._camera.poll()
        if frame is not None:
            self._admit(frame, now_s)
        if self._arrived and self._arrived[0].stamp_s <= max(self._mount.measured_until_s, now_s - _ANGLE_WAIT_S):
            self._check(self._arrived.popleft(), now_s)

    def _admit(self, frame: Frame, now_s: float) -> None:
        """Take a frame with a stamp that is possible and new."""
        timely = now_s - _OLDEST_FRAME_S <= frame.stamp_s <= now_s + _FUTURE_S
        if not (timely and frame.stamp_s > self._newest_frame_s):
            self._drop(now_s, Reason(ReasonCode.DEPTH_FRAME_STAMP))
            return
        self._newest_frame_s = frame.stamp_s
        if self._kept is not None:
            self._kept.begin(frame, self._depth_consistency.calibration_filter)
        self._arrived.append(frame)

    def _check(self, frame: Frame, now_s: float) -> None:
        """Publish the frame's nearest returns, and let it wait for its pose if it is accepted."""
        body_from_depth = self._mount.body_from_depth(frame.stamp_s)
        if body_from_depth is not None:
            self._axes.add_frame(frame, body_from_depth)
            rejection = self._rejection(frame, body_from_depth)
            self._nearby.publish(nearest_in_cells(frame, body_from_depth, believed=rejection is None))
            if rejection is not None:
                self._drop(now_s, rejection)
                return
        if len(self._waiting) == _WAITING_FRAMES:
            self._waiting.popleft()
            self._drop(now_s, Reason(ReasonCode.DEPTH_FRAME_UNPLACED))
        self._waiting.append(frame)

    def _rejection(self, frame: Frame, body_from_depth: Pose) -> Reason | None:
        """Check the frame with the pose extrapolated to its stamp: its own pose arrives later.

        Where the source doubts the place, earlier views would show nothing but that, and what it finds then is no drift.
        """
        estimate = self._fusion.odom_at(frame.stamp_s)
        if estimate is None or estimate.quality == 0:
            return self._depth_consistency.rejection(frame, None)
        if estimate.unsure:
            self._depth_consistency.forget_drift()
            return self._depth_consistency.rejection(frame, None)
        motion = self._motion(frame.stamp_s, self._correction.registered(estimate), body_from_depth, self._registered_at)
        source = self._motion(frame.stamp_s, estimate, body_from_depth, self._fusion.odom_at)
        drift = CorrectedDrift(source, self._correction.drift_mps(frame.stamp_s))
        return self._depth_consistency.rejection(frame, motion, estimate.reset_counter, drift)

    def _motion(
        self, stamp_s: float, estimate: StampedPose, body_from_depth: Pose, odom_at: Callable[[float], StampedPose | None]
    ) -> CameraMotion:
        """Return the motion of the depth imager at a stamp, from its pose there and a moment before."""
        here = estimate.odom_from_body @ body_from_depth
        before, mount = odom_at(stamp_s - _MOMENT_S), self._mount.body_from_depth(stamp_s - _MOMENT_S)
        if before is None or mount is None or before.reset_counter != estimate.reset_counter:
            return CameraMotion.at_rest(here)
        return CameraMotion.between(before.odom_from_body @ mount, here, _MOMENT_S)

    def _drop(self, now_s: float, reason: Reason) -> None:
        self.dropped_frames[reason.code] += 1
        self._newest_drop = now_s, reason

    def _status_at(self, now_s: float) -> PerceptionStatus:
        frames = tuple(sorted(self.dropped_frames.items()))
        samples = tuple(sorted((reason.value, count) for reason, count in self._fusion.rejected.items()))
        newest_s, newest = self._newest_drop
        calibration = self._depth_consistency.calibration_filter.summary()
        kept = None if self._kept is None else self._kept.reason
        return PerceptionStatus(
            now_s, self.published_frames, frames, samples, newest, newest_s, self._origin(), calibration, self._remarks(), kept,
            self._correction.reason,
        )  # fmt: skip

    def _publish_frame(self, now_s: float) -> None:
        """Publish at most one frame per step.

        A reader of a last-value channel would miss the first of two.
        """
        if not self._waiting:
            return
        frame = self._waiting[0]
        if self._fusion.newest_pose_s < frame.stamp_s and now_s - frame.stamp_s < self._frame_wait_s:
            return
        self._waiting.popleft()
        self._register(frame)
        calibration = self._depth_consistency.calibration
        taken_s = frame.stamp_s - calibration.delay_s
        estimate = self._odom_at(taken_s)
        body_from_depth = self._mount.body_from_depth(taken_s)
        if estimate is None or estimate.quality == 0 or body_from_depth is None:
            self._drop(now_s, Reason(ReasonCode.DEPTH_FRAME_UNPLACED))
            return
        # Maps are in odom, which never jumps: near obstacles fit the recent map, even if the source corrects its map.
        # The mission would have to re-pose its keyframes by estimate.correction before it could map in the world.
        odom_from_depth = estimate.odom_from_body @ body_from_depth @ calibration.nominal_from_true
        unsure = estimate.unsure is not None
        self._frames.publish(PosedFrame(calibration.corrected(frame), odom_from_depth, estimate.map_epoch, unsure))
        if unsure:
            self._drop(now_s, Reason(ReasonCode.DEPTH_FRAME_UNSURE))
        else:
            self.published_frames += 1

    def _register(self, frame: Frame) -> None:
        body_from_depth = self._mount.body_from_depth(frame.stamp_s)
        if body_from_depth is not None:
            self._correction.add_frame(frame, body_from_depth)


def warm_up() -> None:
    """Compile every kernel of perception."""
    for part in (DepthConsistencyMonitor, planar_patches, error_propagation, min_range_binning, axis_monitor):
        part.warm_up()
