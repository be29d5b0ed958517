"""Share of a room's surface that a tilted camera sees from where the vehicle can fly.

The room is an empty box. The vehicle keeps its clearance from walls and ceiling, and flies over furniture. It may turn to any
heading, so only the elevation of a line of sight counts. The surface that a gimbal sees in the same room has the share 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import BoolArray, Float32Array, FloatArray, IntArray

LOWEST_M = 0.8  # height of the body's centre over the floor: furniture is below
GRAZING_COS = 0.175  # no depth from a surface seen under a smaller cosine
FARTHEST_M = 5.0  # of surface that is mapped
GIMBAL_RAD = math.radians(60.0)  # tilt of a gimbal, up and down
MIN_PLACES = 0.08  # share of the positions; a flight misses surface that is seen from fewer ...
MIN_VOLUME_M3 = 0.5  # ... or, in a large room, from less space than this
LARGEST_M = 2.0 * FARTHEST_M  # of a side: in a larger room nothing is seen from elsewhere
TILTS_DEG = (15.0, 10.0, 5.0, 0.0)  # compared, positive looks down
USUAL_DEG = 10.0  # where each of them shows the room: from more places than a lower one it sees a ceiling
MIN_IMPROVEMENT = 0.04  # the room is not shown by each if one of TILTS_DEG shows this much more than the first
AS_GOOD = 0.01  # of tilts whose shares differ by less, the one that looks lower is taken
FLOOR, CEILING, WALLS = range(3)
_PLACES = 11  # positions along each axis of the flown box
_POINTS = 24  # surface points along each axis of a side
Size = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class VisibleShares:
    """Shares of the surface in sight at one tilt; the surface that a gimbal sees is 1."""

    room: float
    floor: float
    walls: float
    ceiling: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthView:
    """The depth camera: full vertical angle, shortest depth, position before the body's centre."""

    vertical_fov_rad: float = math.radians(58.0)
    near_m: float = 0.3
    ahead_m: float = 0.1


class RoomVisibility:
    """The surface of a box, and the elevations of the lines of sight to it.

    size_m: length, width and height. clearance_m: of the body's centre from walls and ceiling. Raises ValueError if this
    leaves no position.
    """

    def __init__(self, size_m: Size, clearance_m: float, view: DepthView) -> None:
        self._half_rad = 0.5 * view.vertical_fov_rad
        _require_space(size_m, clearance_m)
        box_m = (min(size_m[0], LARGEST_M), min(size_m[1], LARGEST_M), size_m[2])
        points, normals, self._area, self._side = _surface(box_m)
        places = _places(box_m, clearance_m)
        self._least_share = min(MIN_PLACES, MIN_VOLUME_M3 / max(float(np.prod(np.ptp(places, axis=0))), MIN_VOLUME_M3))
        self._elevation, self._open = _lines(points, normals, places, view)
        self._gimbal = self._seen(GIMBAL_RAD, -GIMBAL_RAD)

    def shares(self, tilt_rad: float) -> VisibleShares:
        """Return what a camera at a tilt (positive looks down) sees."""
        seen = self._seen(tilt_rad, tilt_rad) & self._gimbal

        def share(counts: BoolArray) -> float:
            total = float(self._area[counts & self._gimbal].sum())
            return float(self._area[counts & seen].sum()) / total if total > 0.0 else 1.0

        floor, ceiling, walls = (share(self._side == side) for side in (FLOOR, CEILING, WALLS))
        return VisibleShares(share(self._side >= 0), floor, walls, ceiling)

    def recommended_deg(self) -> float:
        """Return the usual tilt; in a small room the first of TILTS_DEG that shows as much as any."""
        room = {tilt: self.shares(math.radians(tilt)).room for tilt in TILTS_DEG}
        most = max(room.values())
        if most < room[TILTS_DEG[0]] + MIN_IMPROVEMENT:
            return USUAL_DEG
        return next(tilt for tilt in TILTS_DEG if room[tilt] > most - AS_GOOD)

    def _seen(self, lowest_tilt_rad: float, highest_tilt_rad: float) -> BoolArray:
        """Return the points (N,) in sight of a mount with a range of tilts."""
        low, high = -lowest_tilt_rad - self._half_rad, self._half_rad - highest_tilt_rad
        within = (self._elevation >= low) & (self._elevation <= high) & self._open
        seen: BoolArray = within.mean(axis=1) >= self._least_share
        return seen


def _surface(size_m: Size) -> tuple[Float32Array, Float32Array, FloatArray, IntArray]:
    """Return points (N, 3) of the six sides, inward normals (N, 3), areas (N,) and sides (N,)."""
    points, normals, areas, sides = [], [], [], []
    middle = (np.arange(_POINTS) + 0.5) / _POINTS
    for axis in range(3):
        across = [other for other in range(3) if other != axis]
        grid = np.stack(np.meshgrid(middle, middle, indexing="ij"), axis=-1).reshape(-1, 2)
        for far in (0, 1):
            at, normal = np.empty((len(grid), 3)), np.zeros((len(grid), 3))
            at[:, across] = grid * np.array([size_m[other] for other in across])
            at[:, axis], normal[:, axis] = far * size_m[axis], 1.0 - 2.0 * far
            points.append(at)
            normals.append(normal)
            areas.append(np.full(len(grid), size_m[across[0]] * size_m[across[1]] / len(grid)))
            sides.append(np.full(len(grid), (CEILING if far else FLOOR) if axis == 2 else WALLS))
    xyz, inward = (np.concatenate(parts).astype(np.float32) for parts in (points, normals))
    return xyz, inward, np.concatenate(areas), np.concatenate(sides)


def _require_space(size_m: Size, clearance_m: float) -> None:
    """Raise ValueError if there is no position for the body's centre."""
    length_m, width_m, height_m = size_m
    if min(length_m, width_m, height_m + clearance_m - LOWEST_M) < 2.0 * clearance_m:
        named = " x ".join(f"{side_m:g}" for side_m in size_m)
        raise ValueError(f"no position in a room of {named} m is {clearance_m:g} m from walls and ceiling, over furniture")


def _places(size_m: Size, clearance_m: float) -> Float32Array:
    """Return positions (P, 3) of the body's centre."""
    low = np.array([clearance_m, clearance_m, LOWEST_M])
    high = np.array(size_m) - clearance_m
    axes = [np.linspace(a, b, _PLACES) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)


def _lines(
    points: Float32Array, normals: Float32Array, places: Float32Array, view: DepthView
) -> tuple[Float32Array, BoolArray]:
    """Return the elevation (N, P) of each point from each position, and a mask (N, P) of depths."""
    dx, dy, dz = (points[:, None, axis] - places[None, :, axis] for axis in range(3))
    ahead_m = np.hypot(dx, dy) - np.float32(view.ahead_m)
    facing = -(dx * normals[:, None, 0] + dy * normals[:, None, 1] + dz * normals[:, None, 2])
    distance_m = np.sqrt(dx * dx + dy * dy + dz * dz)
    returned = (ahead_m > 0.0) & (distance_m >= view.near_m) & (distance_m <= FARTHEST_M)
    elevation: Float32Array = np.arctan2(dz, np.maximum(ahead_m, np.float32(1e-6)))
    return elevation, returned & (facing >= GRAZING_COS * distance_m)
