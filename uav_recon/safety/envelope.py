"""Envelope: fence and limits for the commanded motion of the body's centre.

All numbers are plain floats and are checked when the envelope is made.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_recon.types.polygon import Polygon, Vec2

Vec3 = tuple[float, float, float]

_ROUNDING_M = 1e-9  #: internal: tolerance for the rounding of sums at the fence


@dataclass(frozen=True, slots=True, kw_only=True)
class Fence:
    """A floor plan between a floor and a ceiling (odom, m), with an inset for the body's centre.

    Raises ValueError if the inset leaves no height.
    """

    plan: Polygon
    floor_m: float
    ceiling_m: float
    inset_m: float

    def __post_init__(self) -> None:
        high_m = self.ceiling_m - self.floor_m
        if not (math.isfinite(high_m) and high_m > 2 * self.inset_m >= 0.0):
            raise ValueError(f"floor {self.floor_m}, ceiling {self.ceiling_m} m: no room for an inset of {self.inset_m} m")

    def holds(self, position_m: Vec3) -> bool:
        """Return True if a position lies inside the fence itself, without the inset. False for NaN."""
        return self.plan.holds(position_m[:2]) and self.floor_m <= position_m[2] <= self.ceiling_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Envelope:
    """The fence and the limits of commanded motion (SI, radians).

    The take-off and landing column is the cylinder of ``pad_radius_m`` round the pad, from ``pad_depth_m`` below the
    pad up to the inset ceiling. It relaxes only the floor: sideways and upwards the inset fence holds there too.
    Raises ValueError if a number is not finite or positive, or the pad does not lie inside.
    """

    fence: Fence
    max_speed_mps: float
    max_acceleration_mps2: float
    max_yaw_rate_radps: float
    pad_m: Vec3 = (0.0, 0.0, 0.0)
    pad_radius_m: float = 0.5  #: refuse: below the inset floor only within this distance of the pad, for take-off and landing
    pad_depth_m: float = 0.2  #: refuse: a setpoint farther below the pad, on which a landing ends

    def __post_init__(self) -> None:
        limits = (self.max_speed_mps, self.max_acceleration_mps2, self.max_yaw_rate_radps, self.pad_radius_m)
        numbers = (*self.pad_m, *limits, self.pad_depth_m)
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError(f"an envelope needs finite numbers, got {numbers}")
        if min(limits) <= 0.0 or self.pad_depth_m < 0.0:
            raise ValueError(f"limits {limits} must be positive, pad depth {self.pad_depth_m} not negative")
        if not self.in_column(self.pad_m):
            raise ValueError(f"the take-off place {self.pad_m} is not inside the fence and its inset")

    def in_band(self, position_m: Vec3) -> bool:
        """Return True if a height lies between inset floor and inset ceiling."""
        inset_m = self.fence.inset_m - _ROUNDING_M
        return self.fence.floor_m + inset_m <= position_m[2] <= self.fence.ceiling_m - inset_m

    def in_column(self, position_m: Vec3) -> bool:
        """Return True if a position is in the take-off and landing column and the fence's plan.

        False for NaN.
        """
        x, y, z = position_m
        inset_m = self.fence.inset_m - _ROUNDING_M
        return (
            math.hypot(x - self.pad_m[0], y - self.pad_m[1]) <= self.pad_radius_m + _ROUNDING_M
            and self.pad_m[2] - self.pad_depth_m - _ROUNDING_M <= z <= self.fence.ceiling_m - inset_m
            and self._in_plan((x, y), (x, y))
        )

    def admits(self, position_m: Vec3, stopping_point_m: Vec3) -> bool:
        """Return True if the straight path from a position to its stopping point stays inside.

        False for NaN. Heights and column are convex: if both ends are in the same one, so are all points between. The plan's
        sides are checked against the path.
        """
        in_band = self.in_band(position_m) and self.in_band(stopping_point_m)
        in_column = self.in_column(position_m) and self.in_column(stopping_point_m)
        return in_column or (in_band and self._in_plan(position_m[:2], stopping_point_m[:2]))

    def nearest_inside(self, position_m: Vec3) -> Vec3:
        """Return the position if it is inside, otherwise a near one that is.

        The pad if there is none.
        """
        if self.admits(position_m, position_m):
            return position_m
        x, y, z = position_m
        inset_m, fence = self.fence.inset_m, self.fence
        plan = (x, y) if self._in_plan((x, y), (x, y)) else fence.plan.nearest_with_clearance((x, y), inset_m)
        height_m = min(max(z, fence.floor_m + inset_m), fence.ceiling_m - inset_m)
        return self.pad_m if plan is None else (plan[0], plan[1], height_m)

    def stopping_point(self, position_m: Vec3, velocity_mps: Vec3) -> Vec3:
        """Return the point where braking with the whole allowed acceleration ends: p + v |v| / 2a."""
        seconds = math.hypot(*velocity_mps) / (2.0 * self.max_acceleration_mps2)
        x, y, z = (p + v * seconds for p, v in zip(position_m, velocity_mps, strict=True))
        return x, y, z

    def _in_plan(self, start_m: Vec2, end_m: Vec2) -> bool:
        return self.fence.plan.room_m(start_m, end_m) >= self.fence.inset_m - _ROUNDING_M
