"""Speed limit from the nearest obstacle in the path, from raw depth in body axes.

It uses no map, and of the pose only the heading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.min_range_grid import MinRangeGrid

_BESIDE_M = 0.05  #: brake: a return this far beside the hull's path still counts as in its way
_MIN_SHARE = 0.2  #: reject: a depth frame with returns in a smaller share of its pixels: dark, covered or too near


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """Free distances (m) in front of the hull.

    stop_clearance_m: when it stops. fast_clearance_m: before it passes at more than ``slow_mps``.
    reaction_s: reaction time (s).
    """

    stop_clearance_m: float
    fast_clearance_m: float
    slow_mps: float = 0.5  #: brake: max. speed towards an obstacle closer than fast_clearance_m, and of a step aside
    reaction_s: float = 0.25  #: brake: time flown on before braking begins; its distance is taken off the free path


class ForwardDepth:
    """The nearest returns of one frame as positions about the body's centre."""

    def __init__(self, nearby: MinRangeGrid, hull_radius_m: float) -> None:
        self.nearby = nearby
        self.stamp_s = nearby.stamp_s
        self._radius_m = hull_radius_m
        self._half_tan = nearby.half_tan
        self._depth_from_body = nearby.body_from_depth.rotation().T
        self._places = nearby.body_from_depth.apply(nearby.points())

    @staticmethod
    def has_enough_returns(nearby: MinRangeGrid) -> bool:
        """Return True if a frame has enough returns to be valid."""
        return nearby.share >= _MIN_SHARE

    def sees(self, direction_body: FloatArray) -> bool:
        """Return True if a unit vector (3,) in body axes points into the camera's view."""
        x, y, z = (self._depth_from_body @ direction_body).tolist()
        return bool(abs(x) <= z * self._half_tan[0] and abs(y) <= z * self._half_tan[1])  # False where z is negative

    def room_m(self, direction_body: FloatArray) -> float:
        """Return the distance (m) that the hull can move along a unit vector (3,) to a return.

        direction_body: in body axes. Infinity if there is no return.
        """
        along = self._places @ direction_body
        across = np.linalg.norm(self._places - along[:, None] * direction_body, axis=1)
        met = along[(along > 0.0) & (across <= self._radius_m + _BESIDE_M)]
        return float(met.min()) - self._radius_m if met.size else math.inf


def fastest_mps(room_m: float, braking_mps2: float, margins: Margins, speed_mps: float) -> float:
    """Return the greatest speed at which the free path is enough to react and to brake.

    room_m: in front of the hull. Below slow_mps the hull stops stop_clearance_m before the obstacle; above it, it is back to
    slow_mps fast_clearance_m before it: v² = v_end² + 2 a (room - reaction - margin), HAZARDS 2.
    """
    left_m = room_m - speed_mps * margins.reaction_s
    if left_m > margins.fast_clearance_m:
        return math.sqrt(margins.slow_mps**2 + 2.0 * braking_mps2 * (left_m - margins.fast_clearance_m))
    return min(math.sqrt(2.0 * braking_mps2 * max(left_m - margins.stop_clearance_m, 0.0)), margins.slow_mps)
