"""Multicopter position control for both autopilots: position P, velocity PID, feedforward.

Local NED frame, metres, radians. A NaN in a setpoint means "not controlled by this field", as in PX4. Speed, tilt and
thrust are limited; acceleration is limited only in the trajectories that the firmware generates itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from sitl.geometry.quaternion import Vec3, wrapped
from sitl.world.quadrotor import GRAVITY_MPS2

_NAN3 = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class ControlSetpoint:
    """Wanted motion, local NED; NaN fields are ignored. yaw_rate: clockwise seen from above."""

    position: Vec3 = _NAN3
    velocity: Vec3 = _NAN3
    acceleration: Vec3 = _NAN3
    yaw: float = math.nan
    yaw_rate: float = math.nan

    @property
    def valid(self) -> bool:
        """True if each axis is controlled, x and y by the same fields (as in PX4 PositionControl)."""
        x, y, z = (
            (math.isfinite(p), math.isfinite(v), math.isfinite(a))
            for p, v, a in zip(self.position, self.velocity, self.acceleration, strict=True)
        )
        return any(x) and any(z) and x == y

    def shifted(self, delta: Vec3, turn_rad: float) -> ControlSetpoint:
        """Return the setpoint after a jump of the estimate: PX4 shifts the setpoint that it HOLDS."""
        p = self.position
        return replace(self, position=(p[0] + delta[0], p[1] + delta[1], p[2] + delta[2]), yaw=self.yaw + turn_rad)


@dataclass(frozen=True, slots=True)
class ControlGains:
    """Gains and limits; SI, radians.

    xy_velocity and z_velocity: P (1/s), I (1/s²) and feedback of the acceleration (1) of the velocity controllers.
    """

    xy_p: float
    z_p: float
    yaw_p: float
    xy_velocity: Vec3
    z_velocity: Vec3
    speed_xy: float
    speed_up: float
    speed_down: float
    accel_up: float  # limit from the available thrust, like accel_down
    accel_down: float
    tilt_rad: float
    yaw_rate: float


class PositionController:
    """Controller from a setpoint to specific force (local NED, hover = (0, 0, -g)) and yaw rate."""

    def __init__(self, gains: ControlGains) -> None:
        self._integral = [0.0, 0.0, 0.0]
        self.configure(gains)

    def configure(self, gains: ControlGains) -> None:
        """Apply changed gains."""
        self._gains = gains
        self._tilt = math.tan(gains.tilt_rad)

    def reset(self) -> None:
        """Set the integrals to zero (on the ground)."""
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
        """Return the specific force (m/s^2, local NED) and the yaw rate (rad/s) after one step.

        speed_up_mps: a climb-rate limit below the parameter's, for the take-off ramp.
        """
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
        if free:  # anti-windup: integrate only while the tilt is not saturated
            integral[0] = min(max(integral[0] + sx * dt_s, -3.0), 3.0)
            integral[1] = min(max(integral[1] + sy * dt_s, -3.0), 3.0)
        integral[2] = min(max(integral[2] + sz * dt_s, -6.0), 9.0)
        return (x, y, z - GRAVITY_MPS2), self._turn(yaw, setpoint)

    def level(self, dt_s: float, velocity_down: float, wanted_down: float) -> Vec3:
        """Return the force without a horizontal position: level, with vertical speed control only."""
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
        """Return the wanted acceleration of one axis and the rate of change of its integral."""
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
    """Return the sum of those arguments that are not NaN; NaN if both are."""
    if math.isnan(a):
        return b
    return a + _or_zero(b)


def _or_zero(a: float) -> float:
    return 0.0 if math.isnan(a) else a


def _prioritised(ex: float, ey: float, wx: float, wy: float, limit: float) -> tuple[float, float]:
    """Limit a velocity (wx, wy); the part from the position error (ex, ey) has priority."""
    norm = math.hypot(ex, ey)
    if norm >= limit:
        return (ex * limit / norm, ey * limit / norm)
    rx, ry = wx - ex, wy - ey
    # s in [0, 1] with |e + s r| = limit
    a, b, c = rx * rx + ry * ry, ex * rx + ey * ry, norm * norm - limit * limit
    s = (-b + math.sqrt(max(b * b - a * c, 0.0))) / a
    return (ex + s * rx, ey + s * ry)
