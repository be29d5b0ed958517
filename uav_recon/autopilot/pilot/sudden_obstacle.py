"""Detection of sudden obstacles: something stands now where a moment ago nothing was.

Examples are a door, a person, or an object that comes nearer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.min_range_grid import MinRangeGrid, in_view
from uav_recon.types.pose import Pose

_MEMORY_S = 0.8  #: evade: an obstacle is new where the views of this time looked past
_VIEWS = 6  #: evade: number of views within that time, at even intervals
_INSIDE_M = 0.20  #: evade: a new return is at least this much nearer than earlier ones: pose error and noise are less
_INSIDE_SHARE = 0.04  #: evade: the same, added as a share of the range
_REACH_M = 3.0  #: evade: a return farther from the body's centre is not relevant yet
_CELLS = 2  #: evade: an obstacle has at least this many returns: one alone may be noise
_SAYING = 2  #: evade: at least this many views looked past each of them: one view alone may be wrong


@dataclass(frozen=True, slots=True, eq=False)
class SuddenObstacle:
    """A sudden obstacle, seen at stamp_s.

    places_m: its returns in odom (N, 3), one per cell, nearest first. away_m: level distance of the nearest from the body's
    centre.
    """

    stamp_s: float
    places_m: FloatArray
    away_m: float


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A past view.

    range_m: the nearest return in the cell or beside it, NaN where that is not known.
    """

    stamp_s: float
    odom_from_depth: Pose
    half_tan: tuple[float, float]
    range_m: FloatArray


class SuddenObstacleDetector:
    """Stores what the camera looked past in the last second, by cells; about 0.2 ms a frame."""

    def __init__(self) -> None:
        self._views: deque[_View] = deque()

    def forget(self) -> None:
        """Forget all views after a jump of odom."""
        self._views.clear()

    def look(self, nearby: MinRangeGrid, odom_from_body: Pose) -> SuddenObstacle | None:
        """Return the returns of a frame where earlier views looked past, or None."""
        odom_from_depth = odom_from_body @ nearby.body_from_depth
        while self._views and nearby.stamp_s - self._views[0].stamp_s > _MEMORY_S:
            self._views.popleft()
        if self._views and self._views[-1].range_m.shape != nearby.range_m.shape:
            self._views.clear()  # from another camera
        places = odom_from_depth.apply(nearby.points())
        here = odom_from_body.translation_m
        close = places[np.linalg.norm(places[:, :2] - here[:2], axis=1) <= _REACH_M]
        new = _looked_past(self._views, close) >= _SAYING if self._views else np.zeros(len(close), dtype=bool)
        if not self._views or nearby.stamp_s - self._views[-1].stamp_s >= _MEMORY_S / _VIEWS:
            self._views.append(_View(nearby.stamp_s, odom_from_depth, nearby.half_tan, _eroded(nearby)))
        if np.count_nonzero(new) < _CELLS:
            return None
        away = np.linalg.norm(close[new, :2] - here[:2], axis=1)
        return SuddenObstacle(nearby.stamp_s, close[new][np.argsort(away)], float(away.min()))


def _looked_past(views: Collection[_View], places: FloatArray) -> IntArray:
    """Return the number (N,) of views with nothing at or before positions (N, 3) in odom."""
    place_m = np.array([view.odom_from_depth.translation_m for view in views])
    odom_from_depth = np.array([view.odom_from_depth.rotation() for view in views])
    half_tan, range_m = np.array([[view.half_tan] for view in views]), np.array([view.range_m for view in views])
    seen = (places - place_m[:, None]) @ odom_from_depth
    past, v, u = in_view(seen, half_tan, range_m.shape)
    n, _ = inside = np.nonzero(past)
    free_m = range_m[n, v[inside].astype(int), u[inside].astype(int)]
    past[inside] = np.linalg.norm(seen[inside], axis=1) * (1.0 + _INSIDE_SHARE) + _INSIDE_M < free_m
    said: IntArray = np.count_nonzero(past, axis=0)
    return said


def _eroded(nearby: MinRangeGrid) -> FloatArray:
    """Return for each cell the nearest return in it and the eight around it.

    NaN for a cell at the border, and where the cell or one of the three below it has returns in less than most of its pixels:
    near the floor such a lower cell is floor too near to be seen, and a table top at a flat angle shows only what is behind it.
    """
    range_m = nearby.range_m
    nearest = np.full(range_m.shape, np.nan)
    rows, columns = range_m.shape
    around = [range_m[i : rows - 2 + i, j : columns - 2 + j] for i in range(3) for j in range(3)]
    there = np.isfinite(range_m) & nearby.full
    tells = there[1:-1, 1:-1] & there[2:, :-2] & there[2:, 1:-1] & there[2:, 2:]
    nearest[1:-1, 1:-1] = np.where(tells, np.fmin.reduce(around), np.nan)
    return nearest
