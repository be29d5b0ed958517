"""ArduPilot's input shaping: motion with limited acceleration and jerk towards a target.

After AP_Math/control.cpp (4.8-dev): shape_pos_vel_accel() and shape_vel_accel(), for the vertical axis and for the
horizontal plane, where the limits apply to the length of the vector. The target may jump. Local NED.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl.geometry.quaternion import Vec3

_Plane = tuple[float, ...]  # two components in the horizontal plane, or one on the vertical axis


@dataclass(frozen=True, slots=True)
class ShapingLimits:
    """Limits of the speed of a position correction, of acceleration and of jerk; SI."""

    speed: float
    acceleration: float
    jerk: float


class InputShaper:
    """Shaped motion: position, velocity and acceleration are the setpoint of the controller."""

    def __init__(self, horizontal: ShapingLimits, vertical: ShapingLimits) -> None:
        self.limits = (horizontal, vertical)
        self.reset((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def reset(self, position: Vec3, velocity: Vec3) -> None:
        """Start from a position and a velocity, without acceleration."""
        self.position = position
        self.velocity = velocity
        self.acceleration = (0.0, 0.0, 0.0)

    def shift(self, delta: Vec3) -> None:
        """Shift the position by a jump of the estimate."""
        self.position = _sum(self.position, delta, 1.0)

    def step(self, dt_s: float, position: Vec3 | None, velocity: Vec3, acceleration: Vec3) -> None:
        """Advance by dt_s, then accelerate towards a target.

        Without a position the velocity alone is followed.
        """
        p, v, a = self.position, self.velocity, self.acceleration
        p = _sum(p, v, dt_s)
        v = _sum(v, a, dt_s)
        north_east = _shaped(
            self.limits[0], dt_s, position and position[:2], velocity[:2], acceleration[:2], p[:2], v[:2], a[:2]
        )
        down = _shaped(self.limits[1], dt_s, position and position[2:], velocity[2:], acceleration[2:], p[2:], v[2:], a[2:])
        self.position = p
        self.velocity = v
        self.acceleration = (north_east[0], north_east[1], down[0])


def _shaped(
    limits: ShapingLimits, dt_s: float, place: _Plane | None, speed: _Plane, push: _Plane, p: _Plane, v: _Plane, a: _Plane
) -> _Plane:
    """Return the next acceleration.

    The approach is critically damped near the target and follows braking parabolas farther away.
    """
    gain = limits.jerk / limits.acceleration
    excess = _difference(v, speed)
    if place is None:
        wanted = _toward(_difference(speed, v), gain, limits.jerk)[0]
    else:
        closing, slope = _toward(_difference(place, p), gain, limits.acceleration)
        if math.hypot(*closing) > limits.speed:
            closing, slope = _clipped(closing, limits.speed), 0.0
        wanted = tuple(gain * (c - e) - slope * e for c, e in zip(closing, excess, strict=True))
    wanted = tuple(w + u for w, u in zip(_clipped(wanted, limits.acceleration), push, strict=True))
    change = _clipped(_difference(wanted, a), limits.jerk * dt_s)
    return tuple(x + c for x, c in zip(a, change, strict=True))


def _toward(error: _Plane, gain: float, limit: float) -> tuple[_Plane, float]:
    """Return the rate that reduces an error with a limited second derivative, and its slope.

    This is sqrt_controller(); the slope is in 1/s.
    """
    size = math.hypot(*error)
    linear = limit / (gain * gain)
    if size <= linear:
        return tuple(gain * e for e in error), gain
    rate = math.sqrt(2.0 * limit * (size - 0.5 * linear))
    return tuple(rate * e / size for e in error), limit / rate


def _clipped(vector: _Plane, longest: float) -> _Plane:
    size = math.hypot(*vector)
    return vector if size <= longest else tuple(x * longest / size for x in vector)


def _difference(a: _Plane, b: _Plane) -> _Plane:
    return tuple(x - y for x, y in zip(a, b, strict=True))


def _sum(a: Vec3, b: Vec3, dt_s: float) -> Vec3:
    return (a[0] + b[0] * dt_s, a[1] + b[1] * dt_s, a[2] + b[2] * dt_s)
