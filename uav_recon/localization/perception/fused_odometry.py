"""Odometry of any recent instant: fused, corrected, and registered in the tracker's map."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from uav_recon.config import LocalizationConfig
from uav_recon.localization.calibration.camera_mount import Mount
from uav_recon.localization.correction.odometry_correction import OdometryCorrection, correction_of
from uav_recon.localization.exclusion.checked_odometry import CheckedOdometry
from uav_recon.localization.fusion.filter_pose_gates import PoseRejection
from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.localization.motion_estimator import MotionEstimator
from uav_recon.localization.slam.view_odometry import ViewOdometry
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.camera_calibration import MOMENT_S, CameraMotion
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import StampedPose
from uav_recon.types.reason import Reason


class FusedOdometry:
    """Owns the estimator and the correction of its odometry.

    Three odometries of an instant: fused() follows the pose source, corrected() is what is published and mapped with,
    registered() is in the map of the tracker beside the source. Without such a tracker they are equal.
    """

    def __init__(self, fusion: MotionEstimator, correction: OdometryCorrection, mount: Mount) -> None:
        self._fusion = fusion
        self._correction = correction
        self._mount = mount

    @classmethod
    def of(cls, config: LocalizationConfig, mount: Mount, view: ViewOdometry | None = None) -> FusedOdometry:
        """Return the odometry that a config describes, of a body with the camera on this mount.

        view: odometry of the tracked images; None without a tracker.
        """
        fusion: MotionEstimator = FusionFilter(pose_lost_s=config.pose_lost_s)
        if view is not None:
            fusion = view if config.source == "slam" else CheckedOdometry(FusionFilter(pose_lost_s=config.pose_lost_s), view)
        return cls(fusion, correction_of(config, fusion.odom_at), mount)

    @property
    def newest_pose_s(self) -> float:
        """Stamp of the newest fused pose; -inf before the first."""
        return self._fusion.newest_pose_s

    @property
    def source_excluded(self) -> bool:
        """True while the poses of the source are not used because the other sensors contradict them."""
        return self._fusion.source_excluded

    @property
    def confirmed_s(self) -> float:
        """Instant at which the view has last confirmed the source; -inf before.

        It compares their ways over seconds: the source did not drift.
        """
        return self._fusion.confirmed_s

    @property
    def rejected(self) -> Mapping[PoseRejection, int]:
        """Counts of rejected poses and inertial samples."""
        return self._fusion.rejected

    @property
    def correction(self) -> Reason | None:
        """The size of the correction, None for nothing."""
        return self._correction.reason

    def add_imu(self, samples: list[ImuSample], now_s: float) -> None:
        """Add inertial samples, oldest first."""
        self._fusion.add_imu(samples, now_s)
        self._correction.add_imu(samples)

    def add_pose(self, pose: StampedPose, now_s: float) -> None:
        """Fuse a pose of the source at its own stamp."""
        self._fusion.add_pose(pose, now_s)

    def add_frame(self, frame: Frame) -> None:
        """Show a frame to the tracker beside the source, once odometry knows its instant."""
        body_from_depth = self._mount.body_from_depth(frame.stamp_s)
        if body_from_depth is not None:
            self._correction.add_frame(frame, body_from_depth)

    def add_view(self, now_s: float) -> None:
        """Compare what the view has shown since the last call with the pose source."""
        self._fusion.add_view(now_s)

    def advance(self, now_s: float, confirms: Callable[[FloatArray], bool]) -> None:
        """Move the correction; called every step.

        confirms(drift_mps (3,)): whether depth surely shows this drift of odom.
        """
        self._correction.advance(now_s, confirms)

    def fused(self, stamp_s: float) -> StampedPose | None:
        """Return odometry as the filter has it, None if it is not known."""
        return self._fusion.odom_at(stamp_s)

    def corrected(self, stamp_s: float) -> StampedPose | None:
        """Return odometry with the correction of that instant."""
        estimate = self._fusion.odom_at(stamp_s)
        return None if estimate is None else self._correction.corrected(estimate)

    def registered(self, stamp_s: float) -> StampedPose | None:
        """Return odometry as the tracker's map has it."""
        estimate = self._fusion.odom_at(stamp_s)
        return None if estimate is None else self._correction.registered(estimate)

    def drift_mps(self, stamp_s: float) -> FloatArray:
        """Return the drift (3,) of fused odometry against that map, in odom axes; zero if unknown."""
        return self._correction.drift_mps(stamp_s)

    def fused_motion(self, stamp_s: float) -> CameraMotion | None:
        """Return the motion of the depth imager by fused odometry, None if its pose is not known."""
        return self._motion(stamp_s, self.fused)

    def corrected_motion(self, stamp_s: float) -> CameraMotion | None:
        """Return the motion of the depth imager by corrected odometry, None if it is not known."""
        return self._motion(stamp_s, self.corrected)

    def registered_motion(self, stamp_s: float) -> CameraMotion | None:
        """Return the motion of the depth imager in the tracker's map, None if it is not known."""
        return self._motion(stamp_s, self.registered)

    def _motion(self, stamp_s: float, odom_at: Callable[[float], StampedPose | None]) -> CameraMotion | None:
        """Return the motion at a stamp, from the pose there and a moment before."""
        estimate, body_from_depth = odom_at(stamp_s), self._mount.body_from_depth(stamp_s)
        if estimate is None or body_from_depth is None:
            return None
        here = estimate.odom_from_body @ body_from_depth
        before, mount = odom_at(stamp_s - MOMENT_S), self._mount.body_from_depth(stamp_s - MOMENT_S)
        if before is None or mount is None or before.reset_counter != estimate.reset_counter:
            return CameraMotion.at_rest(here)
        return CameraMotion.between(before.odom_from_body @ mount, here, MOMENT_S)
