"""Forecast of what the camera will have seen free, and of the speed limit that follows.

It counts the views of the last seconds, and what the camera sees on the way before.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.motion.clearance import ClearanceMap, clearance_at
from uav_recon.motion.path_sight import PathSight
from uav_recon.safety.sight_speed_limit import SightSpeedLimit, entered_points, memory_s
from uav_recon.types.frames import AnyArray, BoolArray, Float32Array, FloatArray, IntArray
from uav_recon.types.maps import FREE, GridSpec, VoxelMap
from uav_recon.types.recent_views import RecentViews

OLDER_S = 0.5  #: brake: ages are taken as larger by this: the guard stores a view each 0.4 s, and the motion may be late
KNOWN_S = 0.6  #: brake: a view on the way counts from this time on: until then it may be neither taken nor stored
REACH_M = 0.05  # beyond the hull's radius: what it reaches next
LOOK_S = 0.2  # between two views on the way that are examined
LINE_M = 0.10  # clearance of a line of sight at the camera ...
LINE_SHARE = 0.08  # ... and what it grows by along the line, because the guard's cells of the image are coarse


@dataclass(frozen=True, slots=True)
class EnteredHull:
    """The hull of a motion, and how far it flies on until it stands (m)."""

    radius_m: float
    stopping_m: float


class HullPath(NamedTuple):
    """The positions of a motion, and what sees from them.

    place: (M, 5). reached_s: (M,) instants. tangents: (2,) of half the camera's angles, horizontal and vertical. radius_m: of
    the hull. oldest_s: a position this long before another does not count for it.
    """

    place: FloatArray
    reached_s: FloatArray
    tangents: FloatArray
    radius_m: float
    oldest_s: float


class RecentViewArrays(NamedTuple):
    """The arrays of RecentViews, with their shapes and units."""

    stamp_s: FloatArray
    depth_from_world: FloatArray
    place_world: FloatArray
    body_world: FloatArray
    range_m: Float32Array
    half_tan: FloatArray

    @staticmethod
    def of(views: RecentViews) -> RecentViewArrays:
        """Return the arrays of views."""
        return RecentViewArrays(
            stamp_s=views.stamp_s, depth_from_world=views.depth_from_world, place_world=views.place_world,
            body_world=views.body_world, range_m=views.range_m, half_tan=views.half_tan,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class SightForecast:
    """Forecast for one motion that begins at begin_s.

    tangents: (2,) of half the camera's angles, horizontal and vertical, as far as they are relied on. place: (P, 5), and
    reached_s: (P,), of the part of the motion that is chosen already. sight: weights of positions; None if the camera is not
    needed to tell where it is.
    """

    views: RecentViews
    clearance_map: ClearanceMap
    limit: SightSpeedLimit
    hull: EnteredHull
    tangents: FloatArray
    begin_s: float
    place: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 5)))
    reached_s: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    sight: PathSight | None = None

    @property
    def end_s(self) -> float:
        """Instant at which the chosen part ends."""
        return float(self.reached_s[-1]) if len(self.reached_s) else self.begin_s

    def extended(self, place: FloatArray, reached_s: FloatArray) -> SightForecast:
        """Return the forecast with more chosen positions (M, 5), reached at instants (M,)."""
        return dataclasses.replace(
            self, place=np.vstack([self.place, place]), reached_s=np.concatenate([self.reached_s, reached_s])
        )

    def max_speed_mps(self, direction: FloatArray, place: FloatArray, reached_s: FloatArray, asked: BoolArray) -> FloatArray:
        """Return the speed limits (M,) from the ages of what the hull enters.

        They are infinite where not ``asked`` (M,). direction: (M, 3), of any length. place: (M, 5) after the chosen part.
        reached_s: (M,) instants.
        """
        limit_mps = np.full(len(place), np.inf)
        nodes = np.flatnonzero(asked)
        if not len(nodes):
            return limit_mps
        stopping_m = np.full(len(nodes), self.hull.stopping_m)
        points = entered_points(place[nodes, :3], _unit(direction[nodes]), stopping_m, self.hull.radius_m, self._reach_m)
        limit_mps[nodes] = self.limit.at(self._ages_s(points, nodes, place, reached_s))
        return limit_mps

    def is_refused(self, direction: FloatArray, place: FloatArray, reached_s: FloatArray, asked: BoolArray) -> BoolArray:
        """Return a mask (M,) of the positions at which the guard refuses even a slow motion.

        It has not seen the next space for too long. The arguments are those of max_speed_mps().
        """
        refused = np.zeros(len(place), dtype=np.bool_)
        nodes = np.flatnonzero(asked)
        if len(nodes):
            unit = _unit(direction[nodes])
            points = (place[nodes, :3] + self._reach_m * unit)[:, None]
            refused[nodes] = self._ages_s(points, nodes, place, reached_s) > memory_s(self.limit.blind_memory_s, unit)
        return refused

    @property
    def _reach_m(self) -> float:
        return self.hull.radius_m + REACH_M

    def _ages_s(self, points: FloatArray, nodes: IntArray, place: FloatArray, reached_s: FloatArray) -> FloatArray:
        """Return the ages (N,) of points (N, K, 3) when the nodes (N,) are reached: of the oldest.

        place: (M, 5) positions, of which the nodes are indices. reached_s: (M,) instants.
        """
        seen_s = np.empty(len(nodes))
        path = HullPath(
            place=np.vstack([self.place, place]), reached_s=np.concatenate([self.reached_s, reached_s]),
            tangents=self.tangents, radius_m=self.hull.radius_m, oldest_s=self.limit.blind_stale_s,
        )  # fmt: skip
        _last_seen_s(points, nodes + len(self.place), path, RecentViewArrays.of(self.views), self.clearance_map, seen_s)
        ages_s: FloatArray = reached_s[nodes] - seen_s + OLDER_S
        return ages_s


def _unit(direction: FloatArray) -> FloatArray:
    """Return directions (N, 3) of length one."""
    unit: FloatArray = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
    return unit


@kernel
def _line_is_free(clearance_map: ClearanceMap, here: AnyArray, there: AnyArray, length_m: float) -> bool:
    """Return True if a line of sight keeps clear of anything that may not be free."""
    dx, dy, dz = there[0] - here[0], there[1] - here[1], there[2] - here[2]
    slower = length_m / max(math.sqrt(dx * dx + dy * dy + clearance_map.height_weight * dz * dz), 1e-9)
    went_m = 0.0
    while went_m < length_m:
        share = went_m / length_m
        x, y, z = here[0] + share * dx, here[1] + share * dy, here[2] + share * dz
        left_m = clearance_at(clearance_map, x, y, z) - LINE_M - LINE_SHARE * went_m
        if left_m <= 0.0:
            return False
        went_m += max(slower * left_m, 0.5 * clearance_map.resolution_m)
    return True


@kernel
def _last_seen_on_path_s(point: AnyArray, n: int, path: HullPath, clearance_map: ClearanceMap) -> float:
    """Return the last instant before node n at which the motion sees a point or is there.

    It is -infinity if there is none.
    """
    place, reached_s, tangents, radius_m, oldest_s = path
    examined_s = np.inf
    for m in range(n - 1, -1, -1):
        at_s = reached_s[m]
        if reached_s[n] - at_s > oldest_s:
            break
        if reached_s[n] - at_s < KNOWN_S or examined_s - at_s < LOOK_S:
            continue
        examined_s = at_s
        dx, dy, dz = point[0] - place[m, 0], point[1] - place[m, 1], point[2] - place[m, 2]
        distance2 = dx * dx + dy * dy + dz * dz
        if distance2 <= radius_m * radius_m:
            return float(at_s)
        cos, sin = math.cos(place[m, 3]), math.sin(place[m, 3])
        ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
        cos, sin = math.cos(place[m, 4]), math.sin(place[m, 4])
        deep, below = cos * ahead - sin * dz, -sin * ahead - cos * dz
        if deep <= 0.0 or abs(aside) > tangents[0] * deep or abs(below) > tangents[1] * deep:
            continue
        if _line_is_free(clearance_map, place[m], point, math.sqrt(distance2)):
            return float(at_s)
    return -np.inf


@kernel
def _last_seen_in_views_s(point: AnyArray, radius_m: float, views: RecentViewArrays) -> float:
    """Return the stamp of the newest view that saw past a point or took place there.

    It is -infinity if there is none.
    """
    stamp_s, depth_from_world, place_world, body_world, range_m, half_tan = views
    rows, columns = range_m.shape[1], range_m.shape[2]
    for v in range(len(stamp_s) - 1, -1, -1):
        dx, dy, dz = point[0] - body_world[v, 0], point[1] - body_world[v, 1], point[2] - body_world[v, 2]
        if dx * dx + dy * dy + dz * dz <= radius_m * radius_m:
            return float(stamp_s[v])
        dx, dy, dz = point[0] - place_world[v, 0], point[1] - place_world[v, 1], point[2] - place_world[v, 2]
        turn = depth_from_world[v]
        deep = turn[2, 0] * dx + turn[2, 1] * dy + turn[2, 2] * dz
        if deep <= 1e-6:
            continue
        right = (turn[0, 0] * dx + turn[0, 1] * dy + turn[0, 2] * dz) / deep / half_tan[0]
        down = (turn[1, 0] * dx + turn[1, 1] * dy + turn[1, 2] * dz) / deep / half_tan[1]
        if abs(right) >= 1.0 or abs(down) >= 1.0:
            continue
        nearest_m = range_m[v, int((down + 1.0) / 2.0 * rows), int((right + 1.0) / 2.0 * columns)]
        if math.sqrt(dx * dx + dy * dy + dz * dz) <= nearest_m - REACH_M:
            return float(stamp_s[v])
    return -np.inf


@kernel
def _last_seen_s(
    points: FloatArray, nodes: IntArray, path: HullPath, views: RecentViewArrays, clearance_map: ClearanceMap, out: FloatArray
) -> None:
    """Fill ``out`` (N,) with the last sight of each node: of the point not seen for longest.

    points: (N, K, 3) of each node. nodes: (N,) index of each in the path.
    """
    for i in range(len(points)):
        out[i] = np.inf
        for k in range(points.shape[1]):
            seen_s = _last_seen_on_path_s(points[i, k], nodes[i], path, clearance_map)
            if seen_s == -np.inf:
                seen_s = _last_seen_in_views_s(points[i, k], path.radius_m, views)
            out[i] = min(out[i], seen_s)
            if seen_s == -np.inf:
                break


def warm_up() -> None:
    """Compile the kernels."""
    grid = GridSpec(np.zeros(3), 1.0, (3, 3, 3))
    voxels = VoxelMap.whole(grid, np.full(grid.shape, FREE, dtype=np.uint8), np.full(grid.shape, 81, dtype=np.uint8), 0)
    clearance_map = ClearanceMap.of(voxels, np.full(3, -np.inf), np.full(3, np.inf), 0.3)
    views = RecentViews(
        np.zeros(1), np.eye(3)[None], np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 2, 2), dtype=np.float32), np.ones(2)
    )
    limit = SightSpeedLimit(full_speed_mps=1.0, blind_speed_mps=0.3, blind_fresh_s=3.0, blind_stale_s=10.0, blind_memory_s=60.0)
    place = np.ones((2, 5))
    SightForecast(views, clearance_map, limit, EnteredHull(0.2, 0.2), np.ones(2), 0.0).max_speed_mps(
        np.ones((2, 3)), place, np.array([1.0, 2.0]), np.ones(2, dtype=np.bool_)
    )
