"""Errors of a real camera against its data sheet and its mount, drawn once per flight.

What the product is told stays nominal: the stream header, the config and the stamps. The simulated camera differs from it by
these numbers. Sources of the sizes: an indoor PX4 vehicle with a D435i (KAIST VIO, calibration in rpng/open_vins
config/kaist_vio: camera 30 ms against the flight controller, IMU noise at rest and in flight), librealsense's calibration
white papers (depth scale), and data sheets of rolling shutter sensors (readout).
"""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sitl.geometry.quaternion import Vec3
from sitl.runtime import atomic_file

FILE_NAME = "camera_errors.json"  # in the flight folder
NO_ERROR: Vec3 = (0.0, 0.0, 0.0)

# half widths of uniform intervals
MOUNT_RAD = math.radians(1.0)
MOUNT_M = 0.010
GIMBAL_RAD = math.radians(1.0)
COLOUR_RAD = math.radians(0.3)
COLOUR_M = 0.005
FOCAL = 0.01
DEPTH_SCALE = 0.015
IMU_OFFSET_S = 0.005
GYRO_BIAS_RADPS = 0.005
ACCEL_BIAS_MPS2 = 0.1
# uniform intervals
AGE_S = (0.0, 0.040)
COLOUR_DELAY_S = (0.0, 0.020)
READOUT_S = (0.015, 0.030)
EXPOSURE_EV_PER_SQRT_S = (0.02, 0.08)
BALANCE_PER_SQRT_S = (0.004, 0.016)
LOSS_GAP_S = (20.0, 60.0)  # of the process, drawn again after each burst
FLIGHT_NOISE = (0.7, 1.3)  # times the noise of a flying frame
# fixed sizes
JITTER_S = 0.005  # standard deviation
JITTER_SIGMAS = 3.0  # the largest jitter
EXPOSURE_EV = 0.3  # bound of the random walk
BALANCE = 0.06  # bound of the random walk of the logarithmic gains of red and blue
LOSS_FRAMES = 5
# Kalibr's units: m/s^2/sqrt(Hz), rad/s/sqrt(Hz), m/s^3/sqrt(Hz), rad/s^2/sqrt(Hz)
REST_ACCEL_DENSITY = 0.00333
REST_GYRO_DENSITY = 5.77e-5
FLIGHT_ACCEL_DENSITY = 0.07
FLIGHT_GYRO_DENSITY = 0.001
ACCEL_WALK = 0.009
GYRO_WALK = 0.0003
_STREAM = 0xE220


@dataclass(frozen=True)
class MountErrors:
    """True pose of the depth imager in the nominal one, in optical axes (RDF).

    rotation_rad: rotation vector nominal_from_true. translation_m. gimbal_rad: true pitch down minus the reported one; 0 for
    a fixed mount.
    """

    rotation_rad: Vec3 = NO_ERROR
    translation_m: Vec3 = NO_ERROR
    gimbal_rad: float = 0.0


@dataclass(frozen=True)
class OpticsErrors:
    """True lenses against the stream's header.

    depth_focal, colour_focal: relative errors of the true focal lengths. depth_scale: relative error of the reported depth.
    colour_rotation_rad, colour_translation_m: true colour imager in the nominal one, as in MountErrors.
    """

    depth_focal: float = 0.0
    depth_scale: float = 0.0
    colour_focal: float = 0.0
    colour_rotation_rad: Vec3 = NO_ERROR
    colour_translation_m: Vec3 = NO_ERROR


@dataclass(frozen=True)
class TimingErrors:
    """True instants of a frame against its stamp.

    age_s: depth was exposed this much before the stamp; jitter_s: standard deviation of an addition for each frame.
    colour_delay_s: the middle row of the colour image was exposed this much after depth. readout_s: from the first row of the
    colour image to the last.
    """

    age_s: float = 0.0
    jitter_s: float = 0.0
    colour_delay_s: float = 0.0
    readout_s: float = 0.0


@dataclass(frozen=True)
class ToneErrors:
    """Exposure and white balance of the colour camera: bounded random walks.

    Rates per square root of a second. exposure_ev: bound, in stops. balance: bound of the logarithmic gains of red and blue.
    """

    exposure_ev: float = 0.0
    exposure_rate_ev: float = 0.0
    balance: float = 0.0
    balance_rate: float = 0.0


@dataclass(frozen=True)
class ImuErrors:
    """Errors of the camera's IMU, body FLU axes, in Kalibr's units.

    *_density_rest: white noise with the motors off; *_density_flight: with the motors on. *_bias: at the start. *_walk: of the
    biases. offset_s: stamp minus true time.
    """

    accel_density_rest: float = 0.0
    accel_density_flight: float = 0.0
    accel_walk: float = 0.0
    accel_bias_mps2: Vec3 = NO_ERROR
    gyro_density_rest: float = 0.0
    gyro_density_flight: float = 0.0
    gyro_walk: float = 0.0
    gyro_bias_radps: Vec3 = NO_ERROR
    offset_s: float = 0.0


@dataclass(frozen=True)
class LossErrors:
    """Bursts of 1 to max_frames lost frames every min_gap_s to max_gap_s; max_frames 0: none."""

    max_frames: int = 0
    min_gap_s: float = 0.0
    max_gap_s: float = 0.0


@dataclass(frozen=True)
class CameraErrors:
    """All errors of one flight's camera. Without arguments: the exact camera.

    seed: of the processes: jitter, random walks, noise and bursts.
    """

    seed: int = 0
    mount: MountErrors = MountErrors()
    optics: OpticsErrors = OpticsErrors()
    timing: TimingErrors = TimingErrors()
    tone: ToneErrors = ToneErrors()
    imu: ImuErrors = ImuErrors()
    loss: LossErrors = LossErrors()

    @staticmethod
    def drawn(seed: int, scale: float = 1.0, gimbal: bool = False) -> CameraErrors:
        """Return the errors of a seed, each multiplied by scale.

        Scale 0 is the exact camera. gimbal: the camera hangs in a gimbal, which has an angle error of its own; no other number
        depends on it. Bursts of lost frames come scale times as often.
        """
        if scale <= 0.0:
            return CameraErrors(seed)
        draw = _Draw(seed, scale)
        mount = MountErrors(draw.vector(MOUNT_RAD), draw.vector(MOUNT_M), draw.within(GIMBAL_RAD) * gimbal)
        optics = OpticsErrors(
            draw.within(FOCAL), draw.within(DEPTH_SCALE), draw.within(FOCAL), draw.vector(COLOUR_RAD), draw.vector(COLOUR_M)
        )
        timing = TimingErrors(draw.between(AGE_S), JITTER_S * scale, draw.between(COLOUR_DELAY_S), draw.between(READOUT_S))
        tone = ToneErrors(
            EXPOSURE_EV * scale, draw.between(EXPOSURE_EV_PER_SQRT_S), BALANCE * scale, draw.between(BALANCE_PER_SQRT_S)
        )
        accel, gyro = draw.between(FLIGHT_NOISE), draw.between(FLIGHT_NOISE)
        imu = ImuErrors(
            REST_ACCEL_DENSITY * accel, FLIGHT_ACCEL_DENSITY * accel, ACCEL_WALK * accel, draw.vector(ACCEL_BIAS_MPS2),
            REST_GYRO_DENSITY * gyro, FLIGHT_GYRO_DENSITY * gyro, GYRO_WALK * gyro, draw.vector(GYRO_BIAS_RADPS),
            draw.within(IMU_OFFSET_S),
        )  # fmt: skip
        return CameraErrors(
            seed, mount, optics, timing, tone, imu, LossErrors(LOSS_FRAMES, LOSS_GAP_S[0] / scale, LOSS_GAP_S[1] / scale)
        )

    def save(self, path: Path) -> None:
        """Write as JSON, atomically."""
        atomic_file.replace(path, (json.dumps(dataclasses.asdict(self), indent=1) + "\n").encode("ascii"))

    @staticmethod
    def load(path: Path) -> CameraErrors:
        """Read the JSON of save(). Raises OSError, ValueError, TypeError or KeyError."""
        tree = json.loads(path.read_text(encoding="ascii"))
        return CameraErrors(
            tree["seed"],
            MountErrors(**_tuples(tree["mount"])),
            OpticsErrors(**_tuples(tree["optics"])),
            TimingErrors(**_tuples(tree["timing"])),
            ToneErrors(**_tuples(tree["tone"])),
            ImuErrors(**_tuples(tree["imu"])),
            LossErrors(**_tuples(tree["loss"])),
        )


class _Draw:
    """Uniform numbers of a seed, in the order of the calls, times a scale."""

    def __init__(self, seed: int, scale: float) -> None:
        self._rng = np.random.default_rng([seed, _STREAM])
        self._scale = scale

    def between(self, interval: tuple[float, float]) -> float:
        return self._scale * float(self._rng.uniform(*interval))

    def within(self, half_width: float) -> float:
        return self.between((-half_width, half_width))

    def vector(self, half_width: float) -> Vec3:
        return (self.within(half_width), self.within(half_width), self.within(half_width))


def _tuples(tree: dict[str, Any]) -> dict[str, Any]:
    """Return the table with its lists as tuples."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in tree.items()}
