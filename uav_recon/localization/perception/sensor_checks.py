"""Checks of the sensors against each other: depth against earlier views, axes against poses."""

from __future__ import annotations

from uav_recon.config import LocalizationConfig
from uav_recon.localization.calibration.calibration_filter import CalibrationFilter
from uav_recon.localization.consistency.axis_monitor import AxisMonitor
from uav_recon.localization.consistency.depth_consistency import CorrectedDrift, DepthConsistencyMonitor
from uav_recon.localization.consistency.reconciled_consistency import ReconciledConsistency
from uav_recon.localization.correction.odometry_correction import corrects_drift
from uav_recon.localization.perception.fused_odometry import FusedOdometry
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.camera_calibration import CameraCalibration
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason


class SensorChecks:
    """Rejects frames, finds wrong odometry, and estimates the camera's errors."""

    def __init__(self, config: LocalizationConfig) -> None:
        # poses that come from the frames themselves contain the errors of their mount
        self._consistency = (
            ReconciledConsistency() if corrects_drift(config) else DepthConsistencyMonitor(corrects=config.source != "slam")
        )
        self._axes = AxisMonitor()
        self._excluded = False  # the pose source, at the newest frame

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Add inertial samples, oldest first."""
        self._axes.add_imu(samples)

    def add_pose(self, pose: StampedPose) -> None:
        """Add a pose of the source."""
        self._axes.add_pose(pose)

    def forget_poses(self) -> None:
        """Forget the poses of the source: they were wrong."""
        self._axes.forget()

    def fault(self, now_s: float) -> Reason | None:
        """Return why nobody may fly by the odometry, None for nothing."""
        return self._axes.reason or self._consistency.drift(now_s)

    def rejection(self, frame: Frame, body_from_depth: Pose, odometry: FusedOdometry) -> Reason | None:
        """Return why a frame may not be used, None if it may.

        It is checked with the pose extrapolated to its stamp: its own pose arrives later. Where the source doubts the place,
        earlier views would show nothing but that, and what it finds then is no drift. What was seen until a source was excluded
        is forgotten: the newest of it has wrong poses.
        """
        if odometry.source_excluded and not self._excluded:
            self._consistency.forget()
        self._excluded = odometry.source_excluded
        self._axes.add_frame(frame, body_from_depth)
        self._consistency.hold_valid(odometry.confirmed_s)
        estimate, fused = odometry.fused(frame.stamp_s), odometry.fused_motion(frame.stamp_s)
        if estimate is None or fused is None or estimate.quality == 0:
            return self._consistency.rejection(frame, None)
        if estimate.unsure:
            self._consistency.forget_drift()
            return self._consistency.rejection(frame, None)
        drift = CorrectedDrift(fused, odometry.drift_mps(frame.stamp_s))
        registered = odometry.registered_motion(frame.stamp_s)
        return self._consistency.rejection(frame, registered, estimate.reset_counter, drift)

    def confirms(self, drift_mps: FloatArray) -> bool:
        """Return True if depth surely shows this drift (3,) of odom, too."""
        return self._consistency.confirms(drift_mps)

    @property
    def calibration(self) -> CameraCalibration:
        """Errors of the depth imager to correct, as far as they are known."""
        return self._consistency.calibration

    @property
    def calibration_filter(self) -> CalibrationFilter:
        """The filter of the camera's errors and of the drift."""
        return self._consistency.calibration_filter

    @property
    def at_rest(self) -> bool:
        """True if the camera has not moved for a while."""
        return self._consistency.at_rest
