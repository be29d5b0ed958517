"""A simple polygon on the floor plan.

It uses plain numbers, so that config and guard use the same code for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

Vec2 = tuple[float, float]

# a fence outside these limits was written in another unit
_SMALLEST_M = 2.0
_LARGEST_M = 500.0


@dataclass(frozen=True, slots=True)
class Polygon:
    """Corners (x, y) in metres, in order, in either direction; the last one joins the first.

    Raises ValueError, with one line, for a polygon that is open, crosses itself, or has no size to fly in.
    """

    corners_m: tuple[Vec2, ...]
    _sides: tuple[tuple[Vec2, Vec2], ...] = field(init=False, repr=False, compare=False)  # used by every method

    def __post_init__(self) -> None:
        corners = self.corners_m
        object.__setattr__(self, "_sides", tuple(zip(corners, (*corners[1:], *corners[:1]), strict=True)))
        if not all(math.isfinite(value) for corner in corners for value in corner):
            raise ValueError(f"corners {corners} must be finite")
        if len(set(corners)) < 3:
            raise ValueError(f"a polygon of {len(set(corners))} corners is open: three at least close one")
        for axis, name in enumerate("xy"):
            width_m = max(corner[axis] for corner in corners) - min(corner[axis] for corner in corners)
            if not _SMALLEST_M <= width_m <= _LARGEST_M:
                raise ValueError(f"corners span {width_m:g} m along {name}, want {_SMALLEST_M:g} to {_LARGEST_M:g}")
        sides = self.sides()
        for i, (a, b) in enumerate(sides):
            for c, d in sides[i + 1 :]:
                joined = len({a, b, c, d}) < 4
                if (joined and _folds(a, b, c, d)) or (not joined and _between(a, b, c, d) == 0.0):
                    raise ValueError(f"the polygon crosses itself: side {a} to {b} meets side {c} to {d}")

    @staticmethod
    def box(low_m: Vec2, high_m: Vec2) -> Polygon:
        """Return the rectangle between two corners."""
        return Polygon((low_m, (high_m[0], low_m[1]), high_m, (low_m[0], high_m[1])))

    def sides(self) -> tuple[tuple[Vec2, Vec2], ...]:
        """Return the pairs of each corner and the next."""
        return self._sides

    def holds(self, point_m: Vec2) -> bool:
        """Return True if a point lies inside: a ray towards +x meets an odd number of sides.

        False for NaN.
        """
        x, y = point_m
        odd = False
        for (ax, ay), (bx, by) in self.sides():
            if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
                odd = not odd
        return odd

    def room_m(self, start_m: Vec2, end_m: Vec2) -> float:
        """Return the least distance from any point of a straight segment to the border.

        It is negative if the segment is not entirely inside.
        """
        if not (self.holds(start_m) and self.holds(end_m)):
            return -math.inf
        min_m = min(_between(start_m, end_m, a, b) for a, b in self.sides())
        return min_m if min_m > 0.0 else -math.inf

    def nearest_with_clearance(self, point_m: Vec2, room_m: float) -> Vec2 | None:
        """Return the nearest point that is ``room_m`` from every side, or None.

        Only points beside one side or two are tried; None if none of them fits.
        """
        found = [self._beside(point_m, a, b, room_m) for a, b in self.sides()]
        found += [self._beside(place, a, b, room_m) for place in tuple(found) for a, b in self.sides()]
        good = [place for place in found if self.room_m(place, place) >= room_m - 1e-9]
        return min(good, key=lambda place: math.dist(place, point_m), default=None)

    def _beside(self, point_m: Vec2, a: Vec2, b: Vec2, room_m: float) -> Vec2:
        """Return the nearest point that is at least ``room_m`` to the inner side of a side's line."""
        length_m = math.dist(a, b)
        ux, uy = (b[0] - a[0]) / length_m, (b[1] - a[1]) / length_m
        inward = 1.0 if self._signed_area() > 0.0 else -1.0
        nx, ny = -uy * inward, ux * inward
        off_m = (point_m[0] - a[0]) * nx + (point_m[1] - a[1]) * ny
        lift_m = max(room_m - off_m, 0.0)
        return point_m[0] + nx * lift_m, point_m[1] + ny * lift_m

    def _signed_area(self) -> float:
        return sum(a[0] * b[1] - b[0] * a[1] for a, b in self.sides()) / 2.0


def _side_of(a: Vec2, b: Vec2, p: Vec2) -> float:
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def _folds(a: Vec2, b: Vec2, c: Vec2, d: Vec2) -> bool:
    """Return True if two sides with a common corner overlap."""
    (shared,) = {a, b} & {c, d} if len({a, b} & {c, d}) == 1 else (None,)
    if shared is None:
        return True
    (p,), (q,) = {a, b} - {shared}, {c, d} - {shared}
    ahead = (p[0] - shared[0]) * (q[0] - shared[0]) + (p[1] - shared[1]) * (q[1] - shared[1])
    return _side_of(shared, p, q) == 0.0 and ahead > 0.0


def _between(a: Vec2, b: Vec2, c: Vec2, d: Vec2) -> float:
    """Return the distance (m) between two straight segments; 0 where they meet."""
    across = _side_of(a, b, c) * _side_of(a, b, d) < 0.0 and _side_of(c, d, a) * _side_of(c, d, b) < 0.0
    return 0.0 if across else min(_to(a, c, d), _to(b, c, d), _to(c, a, b), _to(d, a, b))


def _to(p: Vec2, a: Vec2, b: Vec2) -> float:
    """Return the distance (m) from a point to a straight segment."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    square = dx * dx + dy * dy
    share = min(max(((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / square, 0.0), 1.0) if square > 0.0 else 0.0
    return math.dist(p, (a[0] + share * dx, a[1] + share * dy))
