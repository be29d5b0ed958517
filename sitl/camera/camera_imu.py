"""IMU of the camera: true motion with rotation, noise, drifting biases and a clock offset."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.camera.camera_errors import CameraErrors
from sitl.geometry.quaternion import Quat, Vec3, rotate

F64 = NDArray[np.float64]
_STREAM = 0x1A0


@dataclass(frozen=True)
class CameraImuSample:
    """One sample as the camera reports it: gyro (3,), rad/s; specific force (3,), m/s^2."""

    stamp_s: float
    gyro_radps: F64
    specific_force_mps2: F64


class CameraImu:
    """Samples of an IMU at a constant rate. Repeatable for a seed.

    White noise of density d has a standard deviation of d sqrt(rate) in each sample, a bias walk w one of w / sqrt(rate) in
    each step (Kalibr's IMU noise model).
    """

    def __init__(self, errors: CameraErrors, rate_hz: float) -> None:
        e = self._errors = errors.imu
        self._rng = np.random.default_rng([errors.seed, _STREAM])
        root = math.sqrt(rate_hz)
        self._rest: F64 = np.repeat([e.gyro_density_rest, e.accel_density_rest], 3) * root
        self._flight: F64 = np.repeat([e.gyro_density_flight, e.accel_density_flight], 3) * root
        self._step: F64 = np.repeat([e.gyro_walk, e.accel_walk], 3) / root
        self._bias: F64 = np.array([*e.gyro_bias_radps, *e.accel_bias_mps2])

    def read(self, true_s: float, gyro: Vec3, specific_force: Vec3, imu_from_body: Quat, motors_on: bool) -> CameraImuSample:
        """Return the next sample for the true motion at true_s.

        gyro: rad/s, specific_force: m/s^2, body FLU.
        """
        white, walk = self._rng.standard_normal((2, 6))
        noise = self._bias + (self._flight if motors_on else self._rest) * white
        self._bias = self._bias + self._step * walk
        return CameraImuSample(
            true_s + self._errors.offset_s,
            np.asarray(rotate(imu_from_body, gyro)) + noise[:3],
            np.asarray(rotate(imu_from_body, specific_force)) + noise[3:],
        )
