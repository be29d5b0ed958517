"""Optical flow and height above ground in the simulated EKF. NED and FRD."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl.geometry.quaternion import Quat, Vec3, conjugate, rotate
from sitl.world.flow_sensor import FULL_QUALITY, FlowMeasurement

MIN_COS_TILT = 0.71  # range_cos_max_tilt of EKF2 and DCM33FlowMin of EKF3: 45 degrees
_TERRAIN_LAG_S = 0.15
_TERRAIN_RESET_S = 5.0  # after this time without range the terrain is reset to the next one


@dataclass(frozen=True, slots=True)
class FlowTuning:
    """Tuning of flow fusion from a firmware's parameters and constants; by default none.

    read, range_read: a driver reads the flow sensor, the range finder. fuse: the flow is fused.
    noise_radps: standard deviation at the highest and the lowest quality. gate: standard deviations. rate_max_radps: of flow
    and turn. height_m: limits of the height above ground. delay_s: from the end of an interval to its reading, as a parameter
    says. position_m, range_position_m: of the sensors on the body, FRD. valid_s: the velocity remains valid for this time after
    the last fused flow or pose, while flow was read within seen_s and the terrain measured within terrain_s. reset_s: after
    this time of rejected flow, and without poses, the velocity is reset to it.
    """

    read: bool = False
    range_read: bool = False
    fuse: bool = False
    quality_min: int = 1
    noise_radps: tuple[float, float] = (0.15, 0.5)
    gate: float = 3.0
    rate_max_radps: float = math.inf
    height_m: tuple[float, float] = (0.0, math.inf)
    delay_s: float = 0.0
    position_m: Vec3 = (0.0, 0.0, 0.0)
    range_position_m: Vec3 = (0.0, 0.0, 0.0)
    valid_s: float = 0.0
    seen_s: float = math.inf
    terrain_s: float = math.inf
    reset_s: float = math.inf

    def noise(self, quality: int) -> float:
        """Return the standard deviation (rad/s) for a quality: linear between the two."""
        best, worst = self.noise_radps
        share = (quality - self.quality_min) / max(FULL_QUALITY - self.quality_min, 1)
        return worst + (best - worst) * min(max(share, 0.0), 1.0)


class Terrain:
    """Height of the body's origin above the ground below it, from the range finder."""

    def __init__(self) -> None:
        self._height_m = math.nan
        self.measured_s = -math.inf

    def measure(self, now_s: float, range_m: float, quat_wxyz: Quat, sensor_m: Vec3, velocity_down_mps: float) -> None:
        """Take a range along the body's third axis.

        sensor_m: position of the range finder on the body.
        """
        cos_tilt = rotate(quat_wxyz, (0.0, 0.0, 1.0))[2]
        if cos_tilt < MIN_COS_TILT:
            return
        measured_m = range_m * cos_tilt + rotate(quat_wxyz, sensor_m)[2]
        age_s = now_s - self.measured_s
        if age_s > _TERRAIN_RESET_S:
            self._height_m = measured_m
        else:
            expected_m = self.height_m(now_s, velocity_down_mps)
            self._height_m = expected_m + (1.0 - math.exp(-age_s / _TERRAIN_LAG_S)) * (measured_m - expected_m)
        self.measured_s = now_s

    def height_m(self, now_s: float, velocity_down_mps: float) -> float:
        """Return the height (m) now; NaN before the first range."""
        return self._height_m - velocity_down_mps * (now_s - self.measured_s) if math.isfinite(self._height_m) else math.nan


def flow_velocity(
    flow: FlowMeasurement, sensor_m: Vec3, height_m: float, quat_wxyz: Quat, velocity: Vec3
) -> tuple[float, float, float]:
    """Return the velocity that a flow shows (north, east; m/s), and the range on the axis (m).

    sensor_m: position of the flow sensor on the body. height_m: of the body's origin above ground. velocity: the estimate, for
    the part along the axis, which the flow does not show.
    """
    cos_tilt = rotate(quat_wxyz, (0.0, 0.0, 1.0))[2]
    distance_m = max((height_m - rotate(quat_wxyz, sensor_m)[2]) / cos_tilt, 0.0)
    dt = flow.interval_s
    wx, wy, wz = (angle / dt for angle in flow.gyro_rad)
    px, py, pz = sensor_m
    forward = distance_m * (flow.flow_rad[1] / dt - wy) - (wy * pz - wz * py)
    right = -distance_m * (flow.flow_rad[0] / dt - wx) - (wz * px - wx * pz)
    along = rotate(conjugate(quat_wxyz), velocity)[2]
    north, east, _ = rotate(quat_wxyz, (forward, right, along))
    return north, east, distance_m
