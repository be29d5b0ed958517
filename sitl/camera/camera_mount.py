"""True pose of the camera in the body: the nominal mount and its errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.camera.camera_errors import MountErrors
from sitl.camera.frame_exposure import MountPose
from sitl.geometry.quaternion import IDENTITY, Quat, Vec3, conjugate, from_small_rotation, multiply
from sitl.geometry.transform import body_from_camera, rigid, rotation_from_quat

F64 = NDArray[np.float64]


def small_rigid(rotation_rad: Vec3, translation_m: Vec3) -> F64:
    """Return the 4x4 matrix of a small rotation vector, rad, and a translation, m."""
    return rigid(rotation_from_quat(from_small_rotation(*rotation_rad)), translation_m)


class CameraMount:
    """Depth imager at position_m (3,) in the body, tilted down, with the errors of its mount."""

    def __init__(self, position_m: Vec3, errors: MountErrors) -> None:
        self._position_m = position_m
        self._errors = errors
        self._nominal_from_true = small_rigid(errors.rotation_rad, errors.translation_m)
        self._turn: Quat = IDENTITY

    def turn(self, quat_wxyz: Quat) -> None:
        """Turn the camera with its IMU about the body's origin, body axes, which nobody is told."""
        self._turn = quat_wxyz

    def world_from_depth(self, pose: MountPose) -> F64:
        """Return the true pose (4, 4) of the depth imager, RDF."""
        nominal = body_from_camera(self._position_m, pose.pitch_down_rad + self._errors.gimbal_rad)
        turned = rigid(rotation_from_quat(self._turn), (0.0, 0.0, 0.0)) @ nominal
        return pose.world_from_body @ (turned @ self._nominal_from_true)

    def imu_from_body(self, pitch_down_rad: float) -> Quat:
        """Return the rotation of body vectors into the axes that the IMU takes for the body's.

        The IMU is in the camera and rotated with it. pitch_down_rad: the reported tilt.
        """
        (x, y, z), turned = self._errors.rotation_rad, body_from_camera(self._position_m, pitch_down_rad)[:3, :3]
        fx, fy, fz = (float(row[0]) * x + float(row[1]) * y + float(row[2]) * z for row in turned)
        return multiply(conjugate(from_small_rotation(fx, fy + self._errors.gimbal_rad, fz)), conjugate(self._turn))
