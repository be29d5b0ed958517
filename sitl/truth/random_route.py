"""Random route through a scene.

Each waypoint sees the next one, with clearance; the waypoints are spread over the reachable space.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sitl.geometry.quaternion import wrapped
from sitl.scene.scene import BODY_ABOVE_FLOOR_M, TAKEOFF_HEIGHT_M, Scene
from sitl.truth.visibility import REACH_CLEARANCE_M, reachable_positions
from sitl.world.spline_trajectory import Waypoint

HEIGHT_M = (0.5, 1.5)  # of the body's centre above its place on the pad
LEG_M = (0.8, 4.0)
LOOK_RAD = math.radians(60.0)  # heading of a leg: within this of the direction of travel
PITCH_RAD = (math.radians(-10.0), math.radians(35.0))  # of a gimbal
_STREAM = 0x207E
_CHECKED_M = 0.05  # spacing of the clearance checks on a leg
_CANDIDATES = 200
_BEST = 8  # of the candidates, one of the farthest from the route is taken
_HEADINGS = 12
_AHEAD_M = np.array([0.45, 0.6, 0.75, 0.9, 1.05])  # where the camera looks: nothing may be nearer than _VIEW_M
_VIEW_M = 0.12
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


class NoRouteError(Exception):
    """The scene has no room for a route."""


def random_route(scene: Scene, number: int, length_m: float, look_rad: float = LOOK_RAD) -> list[Waypoint]:
    """Return waypoints of at least length_m in all; the first is straight above the pad.

    number: one number, one route. look_rad: largest angle between heading and direction of travel. Raises NoRouteError.
    """
    return _Route(scene, number, look_rad).waypoints(length_m)


class _Route:
    def __init__(self, scene: Scene, number: int, look_rad: float) -> None:
        self._scene = scene
        self._look_rad = look_rad
        self._rng = np.random.default_rng([number, _STREAM])
        positions = reachable_positions(scene).astype(np.float64)
        flown = (positions[:, 2] >= HEIGHT_M[0]) & (positions[:, 2] <= HEIGHT_M[1])
        self._positions: F64 = positions[flown]

    def waypoints(self, length_m: float) -> list[Waypoint]:
        above = np.array([0.0, 0.0, TAKEOFF_HEIGHT_M - BODY_ABOVE_FLOOR_M])
        route, at, flown_m = [self._waypoint(above, self._scene.start_yaw_rad)], above, 0.0
        visited = [above]
        while flown_m < length_m:
            goal = self._next(at, np.array(visited))
            direction = math.atan2(goal[1] - at[1], goal[0] - at[0])
            route.append(self._waypoint(goal, self._heading(at, goal, direction)))
            flown_m += float(np.linalg.norm(goal - at))
            visited += [0.5 * (at + goal), goal]
            at = goal
        return route

    def _waypoint(self, position_m: F64, yaw_rad: float) -> Waypoint:
        x, y, z = position_m.tolist()
        return Waypoint((x, y, z), yaw_rad, float(self._rng.uniform(*PITCH_RAD)))

    def _next(self, at: F64, visited: F64) -> F64:
        """Return a position in sight of at, one of those far from the route flown."""
        away = np.linalg.norm(self._positions - at, axis=1)
        near = np.flatnonzero((away >= LEG_M[0]) & (away <= LEG_M[1]))
        drawn = self._rng.permutation(near)[:_CANDIDATES]
        clear = [p for p in self._positions[drawn] if self._clear(at, p)]
        if not clear:
            raise NoRouteError(f"{self._scene.name}: no free leg of {LEG_M[0]:g} m or more from {at.round(2).tolist()}")
        alone_m = np.linalg.norm(np.array(clear)[:, None] - visited, axis=2).min(axis=1)
        best = np.argsort(-alone_m, kind="stable")[:_BEST]
        return np.asarray(clear[int(self._rng.choice(best))])

    def _clear(self, start: F64, end: F64) -> bool:
        share = np.linspace(0.0, 1.0, max(int(np.linalg.norm(end - start) / _CHECKED_M), 1) + 1)[1:]
        points = start + share[:, None] * (end - start)
        return bool((self._scene.samples.distances(points, 0.0, 0.0, 0.5) >= REACH_CLEARANCE_M - 0.05).all())

    def _heading(self, start: F64, end: F64, direction_rad: float) -> float:
        """Return a heading near the direction of travel that looks at no wall close by."""
        drawn = [wrapped(direction_rad + float(d)) for d in self._rng.uniform(-self._look_rad, self._look_rad, _HEADINGS)]
        return max(drawn, key=lambda yaw: min(self._view_m(end, yaw), self._view_m(0.5 * (start + end), yaw)))

    def _view_m(self, position_m: F64, yaw_rad: float) -> float:
        """Return the distance ahead (m) that is free of surfaces, at most the last of _AHEAD_M."""
        ahead = position_m + _AHEAD_M[:, None] * np.array([math.cos(yaw_rad), math.sin(yaw_rad), 0.0])
        blocked = self._scene.samples.distances(ahead, 0.0, 0.0, 0.5) < _VIEW_M
        return float(_AHEAD_M[int(np.argmax(blocked))]) if blocked.any() else math.inf
