"""Multicopter position control, PX4's and ArduCopter's alike: position P, velocity PI, feedforward, limits.

Local NED frame, metres, radians. A NaN in a setpoint means "not controlled by this field", as in PX4. What is limited is
speed, tilt and thrust; limits of acceleration belong to the trajectories that the firmwares make themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from sitl.geometry.quaternion import Vec3, wrapped
from sitl.world.quadrotor import GRAVITY_MPS2

_NAN3 = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class ControlSetpoint:
    """Wanted motion, local NED; each field NaN where it is ignored. yaw rate is about down (clockwise from above)."""

    position: Vec3 = _NAN3
    velocity: Vec3 = _NAN3
    acceleration: Vec3 = _NAN3
    yaw: float = math.nan
    yaw_rate: float = math.nan

    @property
    def valid(self) -> bool:
        """Whether every axis is controlled by something; the horizontal ones come in pairs (PX4 PositionControl)."""
        x, y, z = (
            (math.isfinite(p), math.isfinite(v), math.isfinite(a))
            for p, v, a in zip(self.position, self.velocity, self.acceleration, strict=True)
        )
        return any(x) and any(z) and x == y

    def shifted(self, delta: Vec3, turn_rad: float) -> ControlSetpoint:
        """The setpoint after the estimate jumped: PX4 carries the HELD setpoint along."""
        p = self.position
        return replace(self, position=(p[0] + delta[0], p[1] + delta[1], p[2] + delta[2]), yaw=self.yaw + turn_rad)


@dataclass(frozen=True, slots=True)
class ControlGains:
    """Gains and limits. A triple: velocity P (1/s), velocity I (1/s²), feedback of the acceleration (1). SI, radians."""

    xy_p: float
    z_p: float
    yaw_p: float
    xy_velocity: Vec3
    z_velocity: Vec3
    speed_xy: float
    speed_up: float
    speed_down: float
    accel_up: float  # what thrust is there for, as accel_down
    accel_down: float
    tilt_rad: float
    yaw_rate: float


class PositionController:
    """Turns a setpoint into a wanted specific force (local NED, hover = (0, 0, -g)) and a yaw rate, rad/s."""

    def __init__(self, gains: ControlGains) -> None:
        self._integral = [0.0, 0.0, 0.0]
        self.configure(gains)

    def configure(self, gains: ControlGains) -> None:
        """Take over changed gains."""
        self._gains = gains
        self._tilt = math.tan(gains.tilt_rad)

    def reset(self) -> None:
        """Forget the integrals (on the ground)."""
        self._integral = [0.0, 0.0, 0.0]

    def step(
        self,
        dt_s: float,
        position: Vec3,
        velocity: Vec3,
        acceleration: Vec3,
        yaw: float,
        setpoint: ControlSetpoint,
        speed_up_mps: float = math.inf,
    ) -> tuple[Vec3, float]:
        """One step. speed_up_mps: a tighter climb limit than the parameter's (the take-off ramp)."""
        wanted = self._wanted_velocity(position, setpoint, min(speed_up_mps, self._gains.speed_up))
        a = setpoint.acceleration
        x, sx = self._axis(0, self._gains.xy_velocity, wanted[0], velocity[0], acceleration[0], a[0])
        y, sy = self._axis(1, self._gains.xy_velocity, wanted[1], velocity[1], acceleration[1], a[1])
        z, sz = self._axis(2, self._gains.z_velocity, wanted[2], velocity[2], acceleration[2], a[2])
        z = min(max(z, -self._gains.accel_up), self._gains.accel_down)
        side = math.sqrt(x * x + y * y)
        most = self._tilt * max(GRAVITY_MPS2 - z, 1.0)
        free = side <= most
        if not free:
            x, y = x * most / side, y * most / side
        integral = self._integral
        if free:  # anti-windup: integrate only while the command is carried out
            integral[0] = min(max(integral[0] + sx * dt_s, -3.0), 3.0)
            integral[1] = min(max(integral[1] + sy * dt_s, -3.0), 3.0)
        integral[2] = min(max(integral[2] + sz * dt_s, -6.0), 9.0)
        return (x, y, z - GRAVITY_MPS2), self._turn(yaw, setpoint)

    def level(self, dt_s: float, velocity_down: float, wanted_down: float) -> Vec3:
        """Without a horizontal position: keep level, control the vertical speed alone."""
        z, sz = self._axis(2, self._gains.z_velocity, wanted_down, velocity_down, 0.0, math.nan)
        self._integral[2] = min(max(self._integral[2] + sz * dt_s, -6.0), 9.0)
        return (0.0, 0.0, min(max(z, -self._gains.accel_up), self._gains.accel_down) - GRAVITY_MPS2)

    def _wanted_velocity(self, position: Vec3, setpoint: ControlSetpoint, speed_up: float) -> Vec3:
        px, py, pz = setpoint.position
        fx, fy, fz = setpoint.velocity
        ex = self._gains.xy_p * (px - position[0])
        ey = self._gains.xy_p * (py - position[1])
        ez = self._gains.z_p * (pz - position[2])
        wx, wy = _sum(ex, fx), _sum(ey, fy)
        limit = self._gains.speed_xy
        if wx * wx + wy * wy > limit * limit:
            wx, wy = _prioritised(_or_zero(ex), _or_zero(ey), wx, wy, limit)
        return (wx, wy, min(max(_sum(ez, fz), -speed_up), self._gains.speed_down))

    def _axis(
        self, axis: int, gains: tuple[float, float, float], wanted: float, now: float, accel: float, forward: float
    ) -> tuple[float, float]:
        """Wanted acceleration of one axis, and how fast its integral wants to grow."""
        if math.isnan(wanted):  # acceleration alone
            return (_or_zero(forward), 0.0)
        error = wanted - now
        value = gains[0] * error + self._integral[axis] - gains[2] * accel
        return (value + _or_zero(forward), gains[1] * error)

    def _turn(self, yaw: float, setpoint: ControlSetpoint) -> float:
        rate = _or_zero(setpoint.yaw_rate)
        if not math.isnan(setpoint.yaw):
            rate += self._gains.yaw_p * wrapped(setpoint.yaw - yaw)
        return min(max(rate, -self._gains.yaw_rate), self._gains.yaw_rate)


def _sum(a: float, b: float) -> float:
    """The sum of what is not NaN; NaN if neither is."""
    if math.isnan(a):
        return b
    return a + _or_zero(b)


def _or_zero(a: float) -> float:
    return 0.0 if math.isnan(a) else a


def _prioritised(ex: float, ey: float, wx: float, wy: float, limit: float) -> tuple[float, float]:
    """Shorten a velocity to the limit, giving the part from the position error (ex, ey) the right of way."""
    norm = math.hypot(ex, ey)
    if norm >= limit:
        return (ex * limit / norm, ey * limit / norm)
    rx, ry = wx - ex, wy - ey
    # Largest s in [0, 1] with |e + s r| = limit.
    a, b, c = rx * rx + ry * ry, ex * rx + ey * ry, norm * norm - limit * limit
    s = (-b + math.sqrt(max(b * b - a * c, 0.0))) / a
    return (ex + s * rx, ey + s * ry)
