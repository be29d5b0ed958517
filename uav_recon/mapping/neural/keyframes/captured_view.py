"""Captured view: what stays when poses and errors of the camera become better known."""

from __future__ import annotations

from dataclasses import dataclass, replace

from uav_recon.types.camera_calibration import CameraCalibration, CameraMotion
from uav_recon.types.frames import AnyArray
from uav_recon.types.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class CapturedView:
    """One view as the camera took it.

    given: motion in world of the imager of the config at stamp_s. applied: what the keyframe was corrected for. measured (M,)
    uint16: depth of its first rays without smoothing, in DEPTH_UNIT_M (see ray_records). ray_rad: angle between neighbouring
    rays.
    """

    stamp_s: float
    given: CameraMotion
    applied: CameraCalibration
    measured: AnyArray
    ray_rad: float

    def reposed(self, world_from_depth: Pose) -> CapturedView:
        """Return the view with the pose that its keyframe has in another map."""
        before = self.given
        moved = world_from_depth @ self.applied.pose(before).inverse()
        turn = moved.rotation()
        return replace(
            self,
            given=CameraMotion(moved @ before.odom_from_depth, turn @ before.velocity_mps, turn @ before.rate_radps),
        )
