"""The trajectory that PX4 makes itself in Hold, Land and Takeoff: limited in acceleration and jerk, never in OFFBOARD.

Read in PX4 1.15 to 1.17: VelocitySmoothing.cpp, PositionSmoothing.cpp, TrajMath.hpp, Navigator::preproject_stop_point().
One simplification: the horizontal plane is one line, the course on which the mode was entered, where PX4 has two axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_STOP_DELAY_S = 0.6  # preproject_stop_point(): accel_delay_max / jerk


@dataclass(frozen=True, slots=True)
class SmoothingLimits:
    """Of one line. SI."""

    speed: float
    acceleration: float
    jerk: float

    def stopping_m(self, speed: float) -> float:
        """How far ahead a mode that is to stay where it was entered puts that place."""
        return speed * (speed / (2.0 * self.acceleration) + _STOP_DELAY_S)

    def speed_towards(self, distance_m: float) -> float:
        """The speed (signed) at which a place so far ahead is approached (computeMaxSpeedFromDistance)."""
        delay = 4.0 * self.acceleration**2 / self.jerk
        most = 0.5 * (math.sqrt(delay**2 + 8.0 * self.acceleration * abs(distance_m)) - delay)
        return math.copysign(min(most, self.speed), distance_m)


class TrajectorySmoothing:
    """A motion along a line, in the shortest time to a wanted speed. position, velocity, acceleration: where it is now. SI."""

    def __init__(self, position: float = 0.0, velocity: float = 0.0) -> None:
        self.position, self.velocity, self.acceleration = position, velocity, 0.0

    def step(self, dt_s: float, wanted: float, limits: SmoothingLimits) -> None:
        """Advance by dt_s towards a speed: jerk up to a peak of acceleration, hold it, jerk back to none, go on."""
        jerk = limits.jerk
        at_rest = self.velocity + self.acceleration * abs(self.acceleration) / (2.0 * jerk)
        way = math.copysign(1.0, wanted - at_rest)
        now, gain = way * self.acceleration, way * (wanted - self.velocity)
        peak = min(math.sqrt(max(jerk * gain + 0.5 * now * now, 0.0)), limits.acceleration)
        rise_s, fall_s = max(peak - now, 0.0) / jerk, peak / jerk
        hold_s = max(gain - (2.0 * peak * peak - now * now) / (2.0 * jerk), 0.0) / peak if peak > 1e-6 else 0.0
        left_s = dt_s
        for change, lasts_s in ((jerk, rise_s), (0.0, hold_s), (-jerk, fall_s)):
            phase_s = min(left_s, lasts_s)
            self._glide(way * change, phase_s)
            left_s -= phase_s
        if left_s > 0.0:
            self.acceleration = 0.0
            self._glide(0.0, left_s)

    def _glide(self, jerk: float, dt_s: float) -> None:
        a, v = self.acceleration, self.velocity
        self.position += dt_s * (v + dt_s * (0.5 * a + dt_s * jerk / 6.0))
        self.velocity = v + dt_s * (a + 0.5 * dt_s * jerk)
        self.acceleration = a + dt_s * jerk
