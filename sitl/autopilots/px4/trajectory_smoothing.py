"""PX4's trajectories in Hold, Land and Takeoff, limited in acceleration and jerk.

From the sources of PX4 1.15 to 1.17: VelocitySmoothing.cpp, PositionSmoothing.cpp, TrajMath.hpp,
Navigator::preproject_stop_point(). OFFBOARD does not use them. Simplification: horizontal motion is along one line, the
course on entry into the mode; PX4 has two axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_STOP_DELAY_S = 0.6  # preproject_stop_point(): accel_delay_max / jerk


@dataclass(frozen=True, slots=True)
class SmoothingLimits:
    """Limits of the motion along one line; SI."""

    speed: float
    acceleration: float
    jerk: float

    def stopping_m(self, speed: float) -> float:
        """Return the distance (m) from the entry into a mode to its hold position at a speed, m/s."""
        return speed * (speed / (2.0 * self.acceleration) + _STOP_DELAY_S)

    def speed_towards(self, distance_m: float) -> float:
        """Return the signed speed (m/s) at a distance to the goal (computeMaxSpeedFromDistance)."""
        delay = 4.0 * self.acceleration**2 / self.jerk
        most = 0.5 * (math.sqrt(delay**2 + 8.0 * self.acceleration * abs(distance_m)) - delay)
        return math.copysign(min(most, self.speed), distance_m)


class TrajectorySmoothing:
    """Motion along a line that reaches a wanted speed in the shortest time; SI.

    position, velocity, acceleration: the present state.
    """

    def __init__(self, position: float = 0.0, velocity: float = 0.0) -> None:
        self.position = position
        self.velocity = velocity
        self.acceleration = 0.0

    def step(self, dt_s: float, wanted: float, limits: SmoothingLimits) -> None:
        """Advance by dt_s towards a wanted speed.

        The phases are: jerk up to a peak acceleration, constant acceleration, jerk down to zero, constant speed.
        """
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
