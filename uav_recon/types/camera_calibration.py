"""Errors of a camera against its configuration, and the motion that shows them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import Float32Array, FloatArray
from uav_recon.types.pose import Pose

CALIBRATION_FILE = "calibration.json"  # of a flight folder: errors of the camera that all its views show together
# errors of the depth imager, in the order of geometry.camera_error_row, with the standard deviations of an honest camera
ERROR_SIGMAS = {
    "delay_s": 0.025,
    **{f"rotation_{axis}_rad": math.radians(0.8) for axis in "xyz"},
    "depth_scale": 0.012,
    "width": 0.008,
    **{f"offset_{axis}_m": 0.008 for axis in "xyz"},
}
# of these, what poses that come from the depth images have too, so that no view shows it
HIDDEN_BY_OWN_POSES = frozenset(ERROR_SIGMAS) - {"width"}
# errors of the colour imager against depth, in the order of mapping.neural.keyframes.colour_projection
COLOUR_ERROR_SIGMAS = {
    "colour_delay_s": 0.015,
    "colour_readout_s": 0.02,
    **{f"colour_rotation_{axis}_rad": math.radians(0.5) for axis in "xyz"},
    "colour_width": 0.008,
    **{f"colour_offset_{axis}_m": 0.004 for axis in "xyz"},
}
_SPEED_MPS = 1.0  # at which a difference of delays is judged
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


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """Correction of the depth imager.

    delay_s: time from what a frame shows to its stamp. nominal_from_true: pose of the true imager in that of the config.
    scale: share by which depth is too large. width: share by which the image is too wide: the true focal lengths are
    1 + width times the configured ones.
    """

    delay_s: float
    nominal_from_true: Pose
    scale: float
    width: float = 0.0

    @staticmethod
    def none() -> CameraCalibration:
        """Return the calibration of a camera that is as configured."""
        return CameraCalibration(0.0, Pose.identity(), 0.0)

    @property
    def stretch(self) -> FloatArray:
        """Factors (2,) on bearings and depth that remove width and scale."""
        return np.array([1.0 / (1.0 + self.width), 1.0 / (1.0 + self.scale)])

    def motion(self, odom_from_depth: Pose, velocity_mps: FloatArray, rate_radps: FloatArray) -> CameraMotion:
        """Return the motion of the imager of the config at a stamp: the inverse of pose().

        odom_from_depth: where the true imager was when it saw what the frame shows.
        """
        seen = CameraMotion(odom_from_depth @ self.nominal_from_true.inverse(), velocity_mps, rate_radps)
        return CameraMotion(seen.earlier(-self.delay_s), velocity_mps, rate_radps)

    def difference_m(self, other: CameraCalibration, range_m: float) -> float:
        """Return about how far apart two calibrations show a surface at a range."""
        apart = self.nominal_from_true.inverse() @ other.nominal_from_true
        turned = range_m * float(np.linalg.norm(apart.rotation() - np.eye(3))) / math.sqrt(2.0)
        stretched = range_m * math.hypot(self.scale - other.scale, self.width - other.width)
        return math.hypot(
            float(np.linalg.norm(apart.translation_m)), turned, stretched, _SPEED_MPS * (self.delay_s - other.delay_s)
        )

    def true_depth_m(self, depth_m: Float32Array) -> Float32Array:
        """Return depth at its true scale."""
        return depth_m if self.scale == 0.0 else depth_m / np.float32(1.0 + self.scale)

    def reported_depth_m(self, depth_m: Float32Array) -> Float32Array:
        """Return depth as the camera reports it: the inverse of true_depth_m()."""
        return depth_m if self.scale == 0.0 else depth_m * np.float32(1.0 + self.scale)

    def pose(self, motion: CameraMotion) -> Pose:
        """Return where the true imager was when it saw what the frame shows: odom_from_depth."""
        return motion.earlier(self.delay_s) @ self.nominal_from_true
