"""IMU and barometer of the autopilot: true values plus constant biases and white noise."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from sitl.geometry.quaternion import Vec3

_SAMPLE_S = 0.004


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Standard deviations of a calibrated consumer IMU.

    White noise is per sample of 4 ms; biases are constant during a flight.
    """

    gyro_radps: float = 0.002
    gyro_bias_radps: float = 2e-4
    accel_mps2: float = 0.05
    accel_bias_mps2: float = 0.03
    baro_m: float = 0.03
    baro_bias_m: float = 0.1


class SimulatedImu:
    """Angular rates and specific force with the errors of one device, drawn from the seed.

    Both are in the same body frame, which may be any.
    """

    def __init__(self, seed: int, step_s: float = _SAMPLE_S, noise: ImuNoise | None = None) -> None:
        """Draw the biases. step_s: averaging time of a sample; noise falls with its square root."""
        self._noise = noise or ImuNoise()
        quieter = math.sqrt(_SAMPLE_S / step_s)
        self._gyro_sigma = self._noise.gyro_radps * quieter
        self._accel_sigma = self._noise.accel_mps2 * quieter
        self._random = random.Random(seed)
        gauss = self._random.gauss
        n = self._noise
        self._gyro_bias = tuple(gauss(0.0, n.gyro_bias_radps) for _ in range(3))
        self._accel_bias = tuple(gauss(0.0, n.accel_bias_mps2) for _ in range(3))
        self._baro_bias = gauss(0.0, n.baro_bias_m)

    def read(self, gyro: Vec3, specific_force: Vec3) -> tuple[Vec3, Vec3]:
        """Return the measured angular rates (rad/s) and specific force (m/s^2) for the true ones."""
        gauss = self._random.gauss
        g, a = self._gyro_bias, self._accel_bias
        sg, sa = self._gyro_sigma, self._accel_sigma
        return (
            (gyro[0] + g[0] + gauss(0.0, sg), gyro[1] + g[1] + gauss(0.0, sg), gyro[2] + g[2] + gauss(0.0, sg)),
            (
                specific_force[0] + a[0] + gauss(0.0, sa),
                specific_force[1] + a[1] + gauss(0.0, sa),
                specific_force[2] + a[2] + gauss(0.0, sa),
            ),
        )

    def altitude(self, height_m: float) -> float:
        """Return the barometric height (m) for the true height."""
        return height_m + self._baro_bias + self._random.gauss(0.0, self._noise.baro_m)
