"""Setpoint blending: from the last setpoint to a trajectory that begins slightly beside it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.trajectory import Setpoint, Trajectory

#: refuse: a trajectory that begins farther away is not joined, and the guard refuses it; a push causes less
_LARGEST_GAP_M = 0.5
_LARGEST_TURN_RAD = 0.5  #: refuse: the same for a heading that is farther off
_SHORTEST_S = 1.0
_MEAN_SPEED_MPS = 0.08
_MEAN_TURN_RADPS = 0.15


class SetpointBlender:
    """Closes the gap along 1 - 3s² + 2s³.

    Position and velocity are continuous at both ends.

    A mission plans from the measured pose, which lies a tracking error beside the setpoint; the guard allows no such step.
    flown: the last setpoint. It is age_s old and is extrapolated, so a trajectory that joins without a gap is flown unchanged.
    """

    def __init__(self, flown: Setpoint, age_s: float, trajectory: Trajectory, now_s: float) -> None:
        first = trajectory.setpoint_at(now_s)
        gap: FloatArray = flown.position_m + age_s * flown.velocity_mps - first.position_m
        turn_rad = math.remainder(flown.yaw_rad + age_s * flown.yaw_rate_radps - first.yaw_rad, math.tau)
        distance_m = float(np.linalg.norm(gap))
        closes = distance_m <= _LARGEST_GAP_M and abs(turn_rad) <= _LARGEST_TURN_RAD
        self._gap, self._turn_rad = (gap, turn_rad) if closes else (np.zeros(3), 0.0)
        self._start_s = now_s
        self._duration_s = max(_SHORTEST_S, distance_m / _MEAN_SPEED_MPS, abs(turn_rad) / _MEAN_TURN_RADPS)

    def apply(self, setpoint: Setpoint, now_s: float) -> Setpoint:
        """Return the trajectory's sample at an instant, with the rest of the gap added."""
        s = (now_s - self._start_s) / self._duration_s
        if s >= 1.0:
            return setpoint
        left = 1.0 - s * s * (3.0 - 2.0 * s)
        rate = -6.0 * s * (1.0 - s) / self._duration_s
        change = (12.0 * s - 6.0) / self._duration_s**2
        return replace(
            setpoint,
            position_m=setpoint.position_m + self._gap * left,
            velocity_mps=setpoint.velocity_mps + self._gap * rate,
            acceleration_mps2=setpoint.acceleration_mps2 + self._gap * change,
            yaw_rad=setpoint.yaw_rad + self._turn_rad * left,
            yaw_rate_radps=setpoint.yaw_rate_radps + self._turn_rad * rate,
        )
