"""Perception step: inertial samples and late poses in, odometry and posed frames out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from uav_recon.clock import RateKeeper
from uav_recon.config import LocalizationConfig
from uav_recon.geometry import min_range_binning
from uav_recon.geometry.min_range_binning import nearest_in_cells
from uav_recon.interfaces import Clock, DepthCamera, PoseSource
from uav_recon.localization.calibration.camera_mount import Mount
from uav_recon.localization.calibration.kept_calibration import KeptCalibration, NoKeptCalibration
from uav_recon.localization.consistency import axis_monitor, planar_patches
from uav_recon.localization.consistency.depth_consistency import DepthConsistencyMonitor
from uav_recon.localization.fusion import error_propagation
from uav_recon.localization.fusion.inertial_selection import InertialSelection
from uav_recon.localization.perception.frame_intake import FrameIntake
from uav_recon.localization.perception.fused_odometry import FusedOdometry
from uav_recon.localization.perception.odometry_publisher import OdometryPublisher
from uav_recon.localization.perception.perception_channels import PerceptionChannels
from uav_recon.localization.perception.sensor_checks import SensorChecks
from uav_recon.localization.perception.status_report import StatusReport
from uav_recon.localization.slam.kept_map import NoKeptMap
from uav_recon.localization.slam.view_odometry import ViewOdometry
from uav_recon.types.camera import Frame, PosedFrame
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_STATUS_RATE_HZ = 1.0


class Perception:
    """Runs the perception stages in order; call step() at about 100 Hz.

    One step costs about 1 ms, or 10 ms with a frame, which is tracked as it is read. It never blocks.

    A frame waits until a pose at or after its stamp was fused, or config.frame_wait_s. It gets the pose of the instant that it
    shows, and depth at its true scale, as far as the camera's errors are known. A frame is dropped if its own pose is not
    known, if it is rejected as inconsistent, or if it is not newer than all before it: it was mapped already, or its turn has
    passed. The minimum range grid of a frame is published with or without a pose, valid or not: at once, or with a gimbal once
    its angle at the stamp has been measured. A frame that repeats the one before it is none: nothing of it is published.

    view: odometry of the tracked images, None without a tracker. kept: keeps the camera's errors for the next
    flight. remarks: what the camera reports of itself. ``published_frames`` is a counter.
    """

    def __init__(
        self,
        config: LocalizationConfig,
        camera: DepthCamera,
        poses: PoseSource,
        mount: Mount,
        channels: PerceptionChannels,
        clock: Clock,
        *,
        view: ViewOdometry | None = None,
        kept: KeptCalibration | NoKeptCalibration | None = None,
        remarks: Callable[[], tuple[Reason, ...]] = tuple,
    ) -> None:
        warm_up()
        self._poses = poses
        self._mount = mount
        self._channels = channels
        self._clock = clock
        self._kept = kept or NoKeptCalibration()
        self._kept_map = NoKeptMap() if view is None else view.kept_map
        self._inertial = InertialSelection(camera.imu, channels.rates)
        self._intake = FrameIntake(camera, config.frame_wait_s)
        self._odometry = FusedOdometry.of(config, mount, view)
        self._checks = SensorChecks(config)
        self._odometry_publisher = OdometryPublisher(channels.odom, RateKeeper(config.rate_hz, clock.now_s()))
        self._report = StatusReport(poses, self._intake, self._odometry, self._checks, self._kept, self._kept_map, remarks)
        self._status_rate = RateKeeper(_STATUS_RATE_HZ, clock.now_s())
        self.published_frames = 0

    def step(self) -> None:
        """Read new inputs and publish what is due."""
        now_s = self._clock.now_s()
        self._mount.observe()
        self._add_motion(now_s)
        self._odometry.add_view(now_s)
        self._odometry.advance(now_s, self._checks.confirms)
        self._odometry_publisher.step(now_s, self._odometry, self._checks)
        if self._status_rate.due(now_s):
            self._channels.perception.publish(self._report.status(now_s, self.published_frames))
            self._keep(now_s)
        self._admit_frame(now_s)  # after the status: a camera that is gone raises
        self._check_frame(now_s)
        self._publish_frame(now_s)

    def close(self) -> None:
        """Write the camera's errors and the map for the next flight, if they are kept.

        Blocks for up to a second.
        """
        self._kept_map.close()
        self._kept.close(self._checks.calibration_filter)

    @property
    def dropped_frames(self) -> Counter[ReasonCode]:
        """Counts of frames that were not given on, by reason."""
        return self._intake.dropped

    @property
    def published_odom(self) -> int:
        """Count of published odometry."""
        return self._odometry_publisher.published

    def _add_motion(self, now_s: float) -> None:
        """Read inertial samples, then poses."""
        samples = self._inertial.samples(self._clock.now_s)
        self._odometry.add_imu(samples, self._clock.now_s())
        self._checks.add_imu(samples)
        for pose in self._poses.poses():
            self._odometry.add_pose(pose, now_s)
            if self._odometry.source_excluded:
                self._checks.forget_poses()
            else:
                self._checks.add_pose(pose)

    def _keep(self, now_s: float) -> None:
        wrong = self._checks.fault(now_s) is not None
        self._kept_map.update(at_rest=self._checks.at_rest, wrong=wrong)
        self._kept.update(now_s, self._checks.calibration_filter, at_rest=self._checks.at_rest, wrong=wrong)

    def _admit_frame(self, now_s: float) -> None:
        frame = self._intake.admit(now_s)
        if frame is not None:
            self._kept.begin(frame, self._checks.calibration_filter)

    def _check_frame(self, now_s: float) -> None:
        """Publish a frame's nearest returns, and let it wait for its pose if it is accepted."""
        frame = self._intake.next_measured(now_s, self._mount.measured_until_s)
        if frame is None:
            return
        rejection = self._rejection(frame)
        if rejection is None:
            self._intake.accept(now_s, frame)
        else:
            self._intake.drop(now_s, rejection)

    def _rejection(self, frame: Frame) -> Reason | None:
        body_from_depth = self._mount.body_from_depth(frame.stamp_s)
        if body_from_depth is None:
            return None
        rejection = self._checks.rejection(frame, body_from_depth, self._odometry)
        if rejection is not None and rejection.code is ReasonCode.DEPTH_FRAME_REPEATS:
            return rejection
        self._channels.nearby.publish(nearest_in_cells(frame, body_from_depth, consistent=rejection is None))
        return rejection

    def _publish_frame(self, now_s: float) -> None:
        """Publish at most one frame per step.

        A reader of a last-value channel would miss the first of two.
        """
        frame = self._intake.next_placed(now_s, self._odometry.newest_pose_s)
        if frame is None:
            return
        self._odometry.add_frame(frame)
        posed = self._posed(frame)
        if posed is None:
            self._intake.drop(now_s, Reason(ReasonCode.DEPTH_FRAME_UNPLACED))
            return
        self._channels.frames.publish(posed)
        if posed.unsure:
            self._intake.drop(now_s, Reason(ReasonCode.DEPTH_FRAME_UNSURE))
        else:
            self.published_frames += 1

    def _posed(self, frame: Frame) -> PosedFrame | None:
        """Return a frame with the pose of what it shows, None if that is not known.

        Maps are in odom, which never jumps: near obstacles fit the recent map, even if the source corrects its map. The mission
        would have to re-pose its keyframes by StampedPose.correction before it could map in the world.
        """
        calibration = self._checks.calibration
        taken_s = frame.stamp_s - calibration.delay_s
        estimate = self._odometry.corrected(taken_s)
        if estimate is None or estimate.quality == 0:
            return None
        motion = self._odometry.corrected_motion(taken_s)
        if motion is None:
            return None
        return PosedFrame(
            replace(frame, depth_m=calibration.true_depth_m(frame.depth_m)),
            motion.odom_from_depth @ calibration.nominal_from_true,
            estimate.map_epoch,
            estimate.unsure is not None,
            estimate.place_sigma_m,
            calibration,
            motion.velocity_mps,
            motion.rate_radps,
        )


def warm_up() -> None:
    """Compile every kernel of perception."""
    for part in (DepthConsistencyMonitor, planar_patches, error_propagation, min_range_binning, axis_monitor):
        part.warm_up()
