"""Module that looks down: optical flow sensor with its own gyro, and range finder.

As sold with PMW3901 or PAW3902 and VL53L1X. Both are computed by ray casting in the true scene (Open3D). Measurements are in
FRD body axes by MAVLink's convention: a right-hand turn about an axis gives positive flow about it, motion along +X positive
flow about y, along +Y negative flow about x.
"""

from __future__ import annotations

import math
import random
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.geometry.ned_frd import frd_from_flu
from sitl.geometry.quaternion import IDENTITY, Quat, Vec3, conjugate, multiply, normalised, rotate, small_rotation
from sitl.scene.scene import Scene
from sitl.world.floor_texture import FloorTexture

F64 = NDArray[np.float64]

# positions on the body, FLU
FLOW_MOUNT_M: Vec3 = (0.03, -0.02, -0.03)
RANGE_MOUNT_M: Vec3 = (0.03, 0.02, -0.03)

# range finder
RANGE_M = (0.05, 4.0)
RANGE_FOV_RAD = math.radians(20.0)
RANGE_HZ = 20.0
RANGE_NOISE_SHARE = 0.01  # rms error as a share of the range
RANGE_NOISE_M = 0.005  # rms error in addition
_RANGE_RINGS = 4

# flow sensor
FLOW_FOV_RAD = math.radians(42.0)
FOCUS_M = (0.08, 4.0)
FLOW_MAX_RADPS = 7.4
FLOW_HZ = (15.0, 25.0)
DELAY_S = (0.010, 0.040)  # from the end of the interval to the reading by the autopilot, which does not know it
SCALE_SIGMA = 0.03
BIAS_RADPS = 0.01 / 1.2  # rms per axis: 1 cm/s at 1.2 m
NOISE_RAD = 0.05 / 1.2 / 15.0  # rms per measurement and axis: 5 cm/s at 15 Hz and 1.2 m, on good texture
GYRO_BIAS_RADPS = 0.002  # rms per axis
GYRO_NOISE_RADPS = 0.004  # rms per measurement and axis
DROPOUT_SHARE = 0.02
FULL_QUALITY = 255
_GRID = 5  # rays per side of the field of view
_NOISE_WITHOUT_TEXTURE = 3.0  # factor of the noise on a floor without texture
_FAR_M = 2.0  # from here the quality falls, to half of it at the end of the focus
_DARK = 0.4  # light, as a share of a lit room, below which the quality falls in proportion


@dataclass(frozen=True, slots=True)
class FlowMeasurement:
    """One reading of the flow sensor, FRD body axes.

    read_s: time at which the autopilot read it, world clock. The interval ended DELAY_S earlier. flow_rad: mean angle of the
    scene's motion about x and y. gyro_rad: the turn that its own gyro measured. quality: 0 (no flow) to FULL_QUALITY.
    """

    read_s: float
    interval_s: float
    flow_rad: tuple[float, float]
    gyro_rad: Vec3
    quality: int


@dataclass(frozen=True, slots=True)
class RangeMeasurement:
    """One reading of the range finder.

    read_s: world clock. range_m: RANGE_M[1] or RANGE_M[0] if not valid.
    """

    read_s: float
    range_m: float
    valid: bool


@dataclass(frozen=True, slots=True)
class FlowSensorErrors:
    """Errors of one flow sensor: constant in a flight, see the constants of this module."""

    scale: float = 1.0
    bias_radps: tuple[float, float] = (0.0, 0.0)
    gyro_bias_radps: Vec3 = (0.0, 0.0, 0.0)
    noise_rad: float = 0.0
    gyro_noise_radps: float = 0.0
    delay_s: float = 0.0
    rate_hz: float = 20.0
    dropout_share: float = 0.0

    @staticmethod
    def drawn(seed: int) -> FlowSensorErrors:
        """Draw the errors of the sensor of a flight."""
        draw = random.Random(seed ^ 0x0F10)
        return FlowSensorErrors(
            scale=draw.gauss(1.0, SCALE_SIGMA),
            bias_radps=(draw.gauss(0.0, BIAS_RADPS), draw.gauss(0.0, BIAS_RADPS)),
            gyro_bias_radps=(
                draw.gauss(0.0, GYRO_BIAS_RADPS),
                draw.gauss(0.0, GYRO_BIAS_RADPS),
                draw.gauss(0.0, GYRO_BIAS_RADPS),
            ),
            noise_rad=NOISE_RAD,
            gyro_noise_radps=GYRO_NOISE_RADPS,
            delay_s=draw.uniform(*DELAY_S),
            rate_hz=draw.uniform(*FLOW_HZ),
            dropout_share=DROPOUT_SHARE,
        )


class SimulatedFlowModule:
    """The module: call step() at each time step of the vehicle.

    flow, distance: the newest readings, None before the first. valid_distance: the newest valid one. light: of the room,
    0 (dark) to 1; set by the caller.
    """

    def __init__(self, scene: Scene, seed: int, errors: FlowSensorErrors | None = None) -> None:
        """Set up the rays. errors: of the flow sensor; None: drawn from the seed."""
        self._rays = _SceneRays(scene)
        self.errors = errors or FlowSensorErrors.drawn(seed)
        self._flow = _FlowSensor(self._rays, FloorTexture(seed), self.errors, seed)
        self._random = random.Random(seed ^ 0x4A6E)
        self._next_range_s = -math.inf
        self._pending: deque[FlowMeasurement] = deque()
        self.flow: FlowMeasurement | None = None
        self.distance: RangeMeasurement | None = None
        self.valid_distance: RangeMeasurement | None = None
        self.light = 1.0

    def step(self, now_s: float, position: Vec3, quat_wxyz: Quat) -> None:
        """Advance to now_s (world clock). position (ENU, m) and quat_wxyz (enu_from_flu): body."""
        measured = self._flow.step(now_s, position, quat_wxyz, self.light)
        if measured is not None:
            self._pending.append(measured)
        while self._pending and self._pending[0].read_s <= now_s + 1e-9:
            self.flow = self._pending.popleft()
        if now_s >= self._next_range_s - 1e-9:
            self._next_range_s = max(self._next_range_s + 1.0 / RANGE_HZ, now_s)
            self.distance = self._measured_range(now_s, position, quat_wxyz)
            self.valid_distance = self.distance if self.distance.valid else self.valid_distance

    def true_range_m(self, position: Vec3, quat_wxyz: Quat) -> float:
        """Return the mean distance (m) along the axis to what the beam meets; inf for nothing.

        Near surfaces count more, as they return more light.
        """
        depth_m = self._rays.depths(_sensor_position(position, quat_wxyz, RANGE_MOUNT_M), quat_wxyz, _BEAM)
        hit = np.isfinite(depth_m)
        if not hit.any():
            return math.inf
        weight = 1.0 / np.maximum(depth_m[hit], 0.01) ** 2
        return float((weight * depth_m[hit]).sum() / weight.sum())

    def _measured_range(self, now_s: float, position: Vec3, quat_wxyz: Quat) -> RangeMeasurement:
        true_m = self.true_range_m(position, quat_wxyz)
        gauss = self._random.gauss
        measured_m = true_m * (1.0 + gauss(0.0, RANGE_NOISE_SHARE)) + gauss(0.0, RANGE_NOISE_M)
        low_m, high_m = RANGE_M
        return RangeMeasurement(now_s, min(max(measured_m, low_m), high_m), low_m <= measured_m <= high_m)


class _SceneRays:
    """Ray casting in the scene."""

    def __init__(self, scene: Scene) -> None:
        import open3d

        self._tensor: Any = open3d.core.Tensor.from_numpy
        self._scene: Any = open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(self._tensor(scene.vertices.astype(np.float32)), self._tensor(scene.faces.astype(np.uint32)))

    def depths(self, sensor_m: Vec3, quat_wxyz: Quat, directions: F64) -> F64:
        """Return the depth (N,) along the downward axis of the first surface, m; inf for none.

        directions: (N, 3), FLU, with -1 along the third axis.
        """
        rays = np.empty((len(directions), 6), np.float32)
        rays[:, :3] = sensor_m
        rays[:, 3:] = directions @ _body_axes(quat_wxyz)
        return np.asarray(self._scene.cast_rays(self._tensor(rays))["t_hit"].numpy(), np.float64)


class _FlowSensor:
    """The flow sensor alone."""

    def __init__(self, rays: _SceneRays, texture: FloorTexture, errors: FlowSensorErrors, seed: int) -> None:
        self._rays = rays
        self._texture = texture
        self._errors = errors
        self._random = random.Random(seed ^ 0x5F10)
        self._first: tuple[float, Vec3, Quat] | None = None  # time, position of the sensor, attitude: at the interval's start
        self._last_quat: Quat = IDENTITY
        self._turn_flu: Vec3 = (0.0, 0.0, 0.0)
        self._next_s = math.inf

    def step(self, now_s: float, position: Vec3, quat_wxyz: Quat, light: float) -> FlowMeasurement | None:
        """Advance to now_s; return the measurement of an interval that ends now."""
        place = _sensor_position(position, quat_wxyz, FLOW_MOUNT_M)
        if self._first is None:
            self._next_s = now_s + 1.0 / self._errors.rate_hz
            self._begin(now_s, place, quat_wxyz)
            return None
        turn = small_rotation(multiply(conjugate(self._last_quat), quat_wxyz))
        self._turn_flu = _sum(self._turn_flu, turn)
        self._last_quat = quat_wxyz
        if now_s < self._next_s - 1e-9:
            return None
        self._next_s = max(self._next_s + 1.0 / self._errors.rate_hz, now_s)
        measured = self._measure(self._first, (now_s, place, quat_wxyz), light)
        self._begin(now_s, place, quat_wxyz)
        return measured

    def _begin(self, now_s: float, place: Vec3, quat_wxyz: Quat) -> None:
        self._first = (now_s, place, quat_wxyz)
        self._last_quat = quat_wxyz
        self._turn_flu = (0.0, 0.0, 0.0)

    def _measure(self, first: tuple[float, Vec3, Quat], last: tuple[float, Vec3, Quat], light: float) -> FlowMeasurement:
        e, gauss = self._errors, self._random.gauss
        interval_s = last[0] - first[0]
        turn = frd_from_flu(self._turn_flu)
        moved, quality_share = self._seen(first, last, light)
        true = (turn[0] + moved[0], turn[1] + moved[1])
        rate = math.hypot(*true) / interval_s
        quality_share *= max(0.0, 1.0 - (rate / FLOW_MAX_RADPS) ** 2)
        clip = min(1.0, FLOW_MAX_RADPS / max(rate, 1e-9))
        noise_rad = e.noise_rad * (1.0 + (_NOISE_WITHOUT_TEXTURE - 1.0) * (1.0 - quality_share))
        flow = (
            e.scale * clip * true[0] + e.bias_radps[0] * interval_s + gauss(0.0, noise_rad),
            e.scale * clip * true[1] + e.bias_radps[1] * interval_s + gauss(0.0, noise_rad),
        )
        b, sigma = e.gyro_bias_radps, e.gyro_noise_radps * interval_s
        gyro = (
            turn[0] + b[0] * interval_s + gauss(0.0, sigma),
            turn[1] + b[1] * interval_s + gauss(0.0, sigma),
            turn[2] + b[2] * interval_s + gauss(0.0, sigma),
        )
        quality = 0 if self._random.random() < e.dropout_share else round(FULL_QUALITY * quality_share)
        if quality == 0 and clip == 1.0:  # a saturated sensor reports its limit, one that sees nothing reports no motion
            flow = (0.0, 0.0)
        return FlowMeasurement(last[0] + e.delay_s, interval_s, flow, gyro, quality)

    def _seen(
        self, first: tuple[float, Vec3, Quat], last: tuple[float, Vec3, Quat], light: float
    ) -> tuple[tuple[float, float], float]:
        """Return the mean flow of the displacement, without rotation, and the quality.

        Flow: rad about x and y, FRD. Quality: 0 to 1.
        """
        middle = _mean_attitude(first[2], last[2])
        place = _mean(first[1], last[1])
        depth_m = self._rays.depths(place, middle, _VIEW)
        hit = np.isfinite(depth_m)
        if not hit.any():
            return (0.0, 0.0), 0.0
        depth_m, view = depth_m[hit], _VIEW[hit]
        forward, left, up = rotate(conjugate(middle), _difference(last[1], first[1]))
        about_y = ((forward + view[:, 0] * up) / depth_m).mean()
        about_x = ((left + view[:, 1] * up) / depth_m).mean()
        points_m = np.array(place) + (depth_m[:, None] * view) @ _body_axes(middle)
        share = float(self._texture.at(points_m).mean()) * float(hit.mean())
        return (float(about_x), float(about_y)), share * min(light / _DARK, 1.0) * _sharpness(float(depth_m.mean()))


def _sharpness(distance_m: float) -> float:
    """Return the share of the texture that remains at a distance, 0 outside the focus."""
    near_m, far_m = FOCUS_M
    if not near_m <= distance_m <= far_m:
        return 0.0
    return 1.0 - 0.5 * max(0.0, distance_m - _FAR_M) / (far_m - _FAR_M)


def _grid() -> F64:
    side = np.linspace(-1.0, 1.0, _GRID) * math.tan(0.5 * FLOW_FOV_RAD)
    x, y = np.meshgrid(side, side)
    return np.column_stack([x.ravel(), y.ravel(), -np.ones(x.size)])


def _rings() -> F64:
    reach = math.tan(0.5 * RANGE_FOV_RAD)
    around = [
        (reach * ring / _RANGE_RINGS, math.tau * n / (6 * ring)) for ring in range(1, _RANGE_RINGS + 1) for n in range(6 * ring)
    ]
    off, angle = np.array([(0.0, 0.0), *around]).T
    return np.column_stack([off * np.cos(angle), off * np.sin(angle), -np.ones(len(off))])


# rays, FLU, with -1 along the third axis
_VIEW = _grid()
_BEAM = _rings()


def _body_axes(quat_wxyz: Quat) -> F64:
    """Return the axes of the body in the world, one a row."""
    return np.array([rotate(quat_wxyz, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))])


def _sensor_position(position: Vec3, quat_wxyz: Quat, mount_m: Vec3) -> Vec3:
    return _sum(position, rotate(quat_wxyz, mount_m))


def _sum(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _difference(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _mean(a: Vec3, b: Vec3) -> Vec3:
    return (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]))


def _mean_attitude(a: Quat, b: Quat) -> Quat:
    sign = 1.0 if sum(p * q for p, q in zip(a, b, strict=True)) >= 0.0 else -1.0
    return normalised((a[0] + sign * b[0], a[1] + sign * b[1], a[2] + sign * b[2], a[3] + sign * b[3]))
