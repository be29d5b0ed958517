"""ArduPilot's input shaping: a motion within limits of acceleration and jerk that closes in on a target that may jump.

After AP_Math/control.cpp (4.8-dev): shape_pos_vel_accel() and shape_vel_accel(), for one vertical axis and for the
horizontal plane, whose limits are those of the vector's length. Local NED.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl.geometry.quaternion import Vec3

_Plane = tuple[float, ...]  # components of the plane, or the one of an axis


@dataclass(frozen=True, slots=True)
class ShapingLimits:
    """Of the correction's speed, of acceleration and of jerk. SI."""

    speed: float
    acceleration: float
    jerk: float


class InputShaper:
    """position, velocity and acceleration are what the controller is to follow now."""

    def __init__(self, horizontal: ShapingLimits, vertical: ShapingLimits) -> None:
        self.limits = (horizontal, vertical)
        self.reset((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def reset(self, position: Vec3, velocity: Vec3) -> None:
        """Begin with the motion there is."""
        self.position, self.velocity, self.acceleration = position, velocity, (0.0, 0.0, 0.0)

    def shift(self, delta: Vec3) -> None:
        """The estimate jumped, and the motion with it."""
        self.position = _sum(self.position, delta, 1.0)

    def step(self, dt_s: float, position: Vec3 | None, velocity: Vec3, acceleration: Vec3) -> None:
        """Advance by dt_s, then aim at a target; a position of None follows the velocity alone."""
        p, v, a = self.position, self.velocity, self.acceleration
        p = _sum(p, v, dt_s)
        v = _sum(v, a, dt_s)
        north_east = _shaped(
            self.limits[0], dt_s, position and position[:2], velocity[:2], acceleration[:2], p[:2], v[:2], a[:2]
        )
        down = _shaped(self.limits[1], dt_s, position and position[2:], velocity[2:], acceleration[2:], p[2:], v[2:], a[2:])
        self.position, self.velocity = p, v
        self.acceleration = (north_east[0], north_east[1], down[0])


def _shaped(
    limits: ShapingLimits, dt_s: float, place: _Plane | None, speed: _Plane, push: _Plane, p: _Plane, v: _Plane, a: _Plane
) -> _Plane:
    """The next acceleration: critically damped towards the target near by, along braking parabolas from far away."""
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
    """sqrt_controller(): the rate that closes an error without exceeding a second derivative, and its slope (1/s)."""
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
