"""Depth against earlier views, where a tracker corrects odom.

A fault is what neither the tracker's map nor the odometry of the source explains.
"""

from __future__ import annotations

from uav_recon.localization.calibration.calibration_filter import CalibrationFilter
from uav_recon.localization.consistency.depth_consistency import CorrectedDrift, DepthConsistencyMonitor
from uav_recon.types.camera import Frame
from uav_recon.types.camera_calibration import CameraCalibration, CameraMotion
from uav_recon.types.frames import FloatArray
from uav_recon.types.reason import Reason


class ReconciledConsistency:
    """Compares each frame with earlier views by two odometries.

    One has the frame in the tracker's map, the other in odom as the source gives it.

    The tracker's map wanders by decimetres although the source is honest; odom is wrong although the tracker knows its drift.
    A frame is rejected, and a drift reported, only if both say so. The members are those of DepthConsistencyMonitor.
    """

    def __init__(self) -> None:
        self._mapped, self._plain = DepthConsistencyMonitor(), DepthConsistencyMonitor()

    def rejection(
        self, frame: Frame, motion: CameraMotion | None, reset_counter: int = 0, drift: CorrectedDrift | None = None
    ) -> Reason | None:
        """Return why the frame may not be used for mapping and flight, None if it may.

        motion: in the tracker's map. drift: with the motion in odom as the source gives it.
        """
        in_map = self._mapped.rejection(frame, motion, reset_counter, drift)
        in_odom = self._plain.rejection(frame, motion if drift is None else drift.motion, reset_counter)
        return in_map if in_odom is not None else None

    def forget(self) -> None:
        """Forget all that was seen: odom was wrong for a while."""
        self._mapped.forget()
        self._plain.forget()

    def forget_drift(self) -> None:
        """Forget the drift that was measured: the source of the poses corrects its place."""
        self._mapped.forget_drift()
        self._plain.forget_drift()

    def hold_valid(self, stamp_s: float) -> None:
        """Take odom as valid up to an instant; see DriftRateEstimator.hold_valid()."""
        self._mapped.hold_valid(stamp_s)
        self._plain.hold_valid(stamp_s)

    def drift(self, now_s: float) -> Reason | None:
        """Return the drift of the pose that depth shows in both, None for nothing."""
        in_map = self._mapped.drift(now_s)
        return in_map if self._plain.drift(now_s) is not None else None

    def confirms(self, drift_mps: FloatArray) -> bool:
        """Return True if depth surely shows this drift (3,) of odom, too."""
        return self._mapped.confirms(drift_mps)

    @property
    def calibration(self) -> CameraCalibration:
        """Errors of the depth imager to correct, as far as they are known."""
        return self._mapped.calibration

    @property
    def calibration_filter(self) -> CalibrationFilter:
        """The filter of the camera's errors and of the drift."""
        return self._mapped.calibration_filter

    @property
    def at_rest(self) -> bool:
        """True if the camera has not moved for a while."""
        return self._mapped.at_rest
