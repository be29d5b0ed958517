"""Status report of perception: counts of rejections, camera errors, and remarks."""

from __future__ import annotations

from collections.abc import Callable

from uav_recon.interfaces import PoseSource
from uav_recon.localization.calibration.kept_calibration import KeptCalibration, NoKeptCalibration
from uav_recon.localization.pad_origin import PadOrigin
from uav_recon.localization.perception.frame_intake import FrameIntake
from uav_recon.localization.perception.fused_odometry import FusedOdometry
from uav_recon.localization.perception.sensor_checks import SensorChecks
from uav_recon.localization.slam.kept_map import KeptMap, NoKeptMap
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.reason import Reason


class StatusReport:
    """Reads the status of perception from its parts.

    poses: the pose source; the origin of one that begins at the pad is reported. remarks: of the camera.
    """

    def __init__(
        self,
        poses: PoseSource,
        intake: FrameIntake,
        odometry: FusedOdometry,
        checks: SensorChecks,
        kept: KeptCalibration | NoKeptCalibration,
        kept_map: KeptMap | NoKeptMap,
        remarks: Callable[[], tuple[Reason, ...]],
    ) -> None:
        self._pad = poses if isinstance(poses, PadOrigin) else None
        self._intake = intake
        self._odometry = odometry
        self._checks = checks
        self._kept = kept
        self._kept_map = kept_map
        self._remarks = remarks

    def status(self, now_s: float, published_frames: int) -> PerceptionStatus:
        """Return the status at an instant."""
        newest_s, newest = self._intake.newest_drop
        return PerceptionStatus(
            now_s,
            frames=published_frames,
            rejected_frames=tuple(sorted(self._intake.dropped.items())),
            rejected_samples=tuple(sorted((reason.value, count) for reason, count in self._odometry.rejected.items())),
            newest=newest,
            newest_s=newest_s,
            origin=None if self._pad is None else self._pad.reason,
            calibration=self._checks.calibration_filter.summary(),
            camera=self._remarks(),
            kept=self._kept.reason,
            correction=self._odometry.correction,
            earlier_map=self._kept_map.reason,
        )
