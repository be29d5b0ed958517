"""Motion of the depth imager at the stamp of a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

MOMENT_S = 0.03  #: internal: time over which the velocity of the camera is measured


@dataclass(frozen=True, slots=True, eq=False)
class CameraMotion:
    """Pose, velocity (3,) and turn rate (3,) of the depth imager.

    Velocity and rate are in odom axes, m/s and rad/s.
    """

    odom_from_depth: Pose
    velocity_mps: FloatArray
    rate_radps: FloatArray

    @staticmethod
    def at_rest(odom_from_depth: Pose) -> CameraMotion:
        """Return the motion of an imager that does not move."""
        return CameraMotion(odom_from_depth, np.zeros(3), np.zeros(3))

    def earlier(self, by_s: float) -> Pose:
        """Return the pose of the imager by_s before the stamp, or after it where by_s is negative."""
        here = self.odom_from_depth
        turned = Pose.from_rotation_vector(-by_s * self.rate_radps, np.zeros(3))
        return Pose((turned @ here).quat_wxyz, here.translation_m - by_s * self.velocity_mps)

    @staticmethod
    def between(before: Pose, odom_from_depth: Pose, step_s: float) -> CameraMotion:
        """Return the motion from two poses, the second of them step_s after the first."""
        turn = odom_from_depth.rotation() @ before.rotation().T
        # the antisymmetric part of a small rotation is its rotation vector
        turned_rad = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        moved_m = odom_from_depth.translation_m - before.translation_m
        return CameraMotion(odom_from_depth, moved_m / step_s, turned_rad / step_s)
