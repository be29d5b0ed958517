"""Where the body's centre may be told to go, and how fast: plain numbers, checked when they are written down."""

from __future__ import annotations

import math
from dataclasses import dataclass

Vec3 = tuple[float, float, float]

_ROUNDING_M = 1e-9


@dataclass(frozen=True, slots=True)
class Envelope:
    """The fence box in odom (m), its inset, and the limits of commanded motion (SI, radians).

    The take-off and landing column is the cylinder of ``pad_radius_m`` round the pad, from ``pad_depth_m`` below the
    pad up to the inset ceiling. It relaxes only the floor: sideways and upwards the inset fence holds there too.
    Raises ValueError if a number is not finite or positive, or the inset leaves no room.
    """

    fence_min_m: Vec3
    fence_max_m: Vec3
    inset_m: float
    max_speed_mps: float
    max_acceleration_mps2: float
    max_yaw_rate_radps: float
    pad_m: Vec3 = (0.0, 0.0, 0.0)
    pad_radius_m: float = 0.5
    pad_depth_m: float = 0.2

    def __post_init__(self) -> None:
        limits = (self.max_speed_mps, self.max_acceleration_mps2, self.max_yaw_rate_radps, self.pad_radius_m)
        numbers = (*self.fence_min_m, *self.fence_max_m, *self.pad_m, *limits, self.inset_m, self.pad_depth_m)
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError(f"an envelope needs finite numbers, got {numbers}")
        if min(limits) <= 0.0 or self.inset_m < 0.0 or self.pad_depth_m < 0.0:
            raise ValueError(f"limits {limits} must be positive, inset {self.inset_m} and pad depth not negative")
        for low, high, axis in zip(self.fence_min_m, self.fence_max_m, "xyz", strict=True):
            if not high - low > 2 * self.inset_m:
                raise ValueError(f"fence {axis} from {low} to {high} m leaves no room inside an inset of {self.inset_m} m")

    def in_box(self, position_m: Vec3) -> bool:
        """Whether a point (odom, m) lies inside the inset fence. False for anything that is not a number."""
        inset = self.inset_m - _ROUNDING_M
        return all(
            low + inset <= value <= high - inset
            for value, low, high in zip(position_m, self.fence_min_m, self.fence_max_m, strict=True)
        )

    def in_column(self, position_m: Vec3) -> bool:
        """Whether a point lies in the take-off and landing column. False for anything that is not a number."""
        x, y, z = position_m
        inset = self.inset_m - _ROUNDING_M
        return (
            math.hypot(x - self.pad_m[0], y - self.pad_m[1]) <= self.pad_radius_m + _ROUNDING_M
            and self.fence_min_m[0] + inset <= x <= self.fence_max_m[0] - inset
            and self.fence_min_m[1] + inset <= y <= self.fence_max_m[1] - inset
            and self.pad_m[2] - self.pad_depth_m - _ROUNDING_M <= z <= self.fence_max_m[2] - inset
        )

    def contains(self, position_m: Vec3) -> bool:
        """Whether a setpoint may stand at this point."""
        return self.in_box(position_m) or self.in_column(position_m)

    def admits(self, position_m: Vec3, stop_m: Vec3) -> bool:
        """Whether the straight way from a point to its stopping point stays inside.

        Both parts of the allowed space are convex, so both ends in the same part answer for every point between.
        """
        return (self.in_box(position_m) and self.in_box(stop_m)) or (self.in_column(position_m) and self.in_column(stop_m))

    def nearest_inside(self, position_m: Vec3) -> Vec3:
        """The point itself if it is inside, otherwise the nearest point of the inset box."""
        if self.contains(position_m):
            return position_m
        x, y, z = (
            min(max(value, low + self.inset_m), high - self.inset_m)
            for value, low, high in zip(position_m, self.fence_min_m, self.fence_max_m, strict=True)
        )
        return (x, y, z)

    def stopping_point(self, position_m: Vec3, velocity_mps: Vec3) -> Vec3:
        """Where braking with the whole allowed acceleration ends: p + v |v| / 2a."""
        x, y, z = position_m
        vx, vy, vz = velocity_mps
        seconds = math.hypot(vx, vy, vz) / (2.0 * self.max_acceleration_mps2)
        return (x + vx * seconds, y + vy * seconds, z + vz * seconds)
