"""The nearest thing in the way, straight from raw depth in body axes: no map, and no pose but where the nose points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.min_range_grid import MinRangeGrid

_BESIDE_M = 0.05  # a return this far beside the hull's way still is in it
_MIN_SHARE = 0.2  # of the pixels: a frame with fewer returns is as good as none, be it dark, covered or too near


@dataclass(frozen=True, slots=True)
class Margins:
    """What stays free before the hull (m) when it stops, and before it passes at more than ``slow_mps``; reaction (s)."""

    stop_m: float
    fast_m: float
    slow_mps: float = 0.5
    reaction_s: float = 0.25


class ForwardDepth:
    """One frame's nearest returns as places about the body's centre."""

    def __init__(self, nearby: MinRangeGrid, hull_radius_m: float) -> None:
        self.stamp_s = nearby.stamp_s
        self._radius_m, self._half_tan = hull_radius_m, nearby.half_tan
        self._depth_from_body = nearby.body_from_depth.rotation().T
        self._places = nearby.body_from_depth.apply(nearby.points())

    @staticmethod
    def tells(nearby: MinRangeGrid) -> bool:
        """Whether a frame has enough returns to be believed at all."""
        return nearby.share >= _MIN_SHARE

    def sees(self, direction_body: FloatArray) -> bool:
        """Whether the camera looks where a unit vector (3,) in body axes points."""
        x, y, z = (self._depth_from_body @ direction_body).tolist()
        return bool(abs(x) <= z * self._half_tan[0] and abs(y) <= z * self._half_tan[1])  # never where z is negative

    def room_m(self, direction_body: FloatArray) -> float:
        """Metres that the hull may go along a unit vector (3,) in body axes before it meets a return; infinity for none."""
        along = self._places @ direction_body
        across = np.linalg.norm(self._places - along[:, None] * direction_body, axis=1)
        met = along[(along > 0.0) & (across <= self._radius_m + _BESIDE_M)]
        return float(met.min()) - self._radius_m if met.size else math.inf


def fastest_mps(room_m: float, braking_mps2: float, margins: Margins, speed_mps: float) -> float:
    """The greatest speed at which what the way has left is enough to react in and to brake in.
    room_m: before the hull. Below slow_mps the hull stops stop_m short; above it, it is back to slow_mps fast_m short:
    v² = v_end² + 2 a (room - reaction - margin), HAZARDS 2.
    """
    left_m = room_m - speed_mps * margins.reaction_s
    if left_m > margins.fast_m:
        return math.sqrt(margins.slow_mps**2 + 2.0 * braking_mps2 * (left_m - margins.fast_m))
    return min(math.sqrt(2.0 * braking_mps2 * max(left_m - margins.stop_m, 0.0)), margins.slow_mps)
