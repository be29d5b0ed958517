"""A tracking system whose poses go to the autopilot, not to the companion."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sitl.geometry.quaternion import Quat, Vec3, from_yaw, multiply, rotate
from sitl.world.pose_tracker import PoseRecord

F64 = NDArray[np.float64]
ORIGIN_M = 2.0  # standard deviation of the place of the pad in its frame, per horizontal axis


class OnboardTracker:
    """Writes poses in a frame of its own: heading and origin are where it was switched on.

    fuse: of the autopilot. step() moves its frame, as a loop closure does, and counts a reset.
    """

    def __init__(self, seed: int, fuse: Callable[[PoseRecord], None]) -> None:
        rng = np.random.default_rng([seed, 0x0B0A])
        self._fuse = fuse
        self._turn: Quat = from_yaw(float(rng.uniform(-math.pi, math.pi)))
        self._shift_m: F64 = np.array([*(ORIGIN_M * rng.standard_normal(2)), 0.0])
        self._resets = 0

    def step(self, shift_m: Vec3, turn_rad: float = 0.0) -> None:
        """Move the frame by a shift and a turn about its origin."""
        self._turn = multiply(from_yaw(turn_rad), self._turn)
        self._shift_m = np.array(rotate(from_yaw(turn_rad), _vector(self._shift_m))) + shift_m
        self._resets += 1

    def write_pose(
        self, stamp_s: float, position_m: F64, quat_wxyz: F64, variance: F64, quality: int, reset_counter: int
    ) -> None:
        """Give a pose odom_from_body to the autopilot, in the frame of this tracker."""
        place_m = np.array(rotate(self._turn, _vector(position_m))) + self._shift_m
        w, x, y, z = quat_wxyz.tolist()
        attitude = np.array(multiply(self._turn, (w, x, y, z)))
        self._fuse(PoseRecord(stamp_s, place_m, attitude, variance, quality, reset_counter + self._resets))


def _vector(numbers: F64) -> Vec3:
    x, y, z = numbers.tolist()
    return (x, y, z)
