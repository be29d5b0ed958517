"""Detection of sudden obstacles: something stands now where a moment ago nothing was.

Examples are a door, a person, or an object that comes nearer.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass
from typing import TypeGuard

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
_SAME_M = 0.15  #: evade: sights of one obstacle in two frames are no farther apart, plus this speed times the time between
_SAME_MPS = 2.0  #: evade: the same
_GONE_SHARE = 0.5  #: evade: an obstacle of the frame before was a ghost if this one looks past more of its returns
_SAYING = 2  #: evade: at least this many views looked past each of them: one view alone may be wrong


@dataclass(frozen=True, slots=True, eq=False)
class SuddenObstacle:
    """A sudden obstacle, seen at stamp_s.

    places_m: its returns in odom (N, 3), one per cell, nearest first. away_m: level distance of the nearest from the body's
    centre. sights: number of frames in a row that show it there, up to this one; shown_s: time from the first of them to this
    one.
    """

    stamp_s: float
    places_m: FloatArray
    away_m: float
    sights: int = 1
    shown_s: float = 0.0


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
    """Stores what the camera looked past in the last second, by cells; about 0.2 ms a frame.

    A depth camera may show a ghost: an obstacle in single frames, where nothing stands. ``ghost_s`` tells of the newest one.
    """

    def __init__(self) -> None:
        self._views: deque[_View] = deque()
        self.ghost_s = -math.inf  # stamp of the newest frame that looked past what the frame before it showed once
        self._last: SuddenObstacle | None = None  # in the frame before

    def forget(self) -> None:
        """Forget all views after a jump of odom."""
        self._views.clear()
        self._last = None

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
        view = _View(nearby.stamp_s, odom_from_depth, nearby.half_tan, _eroded(nearby))
        if not self._views or nearby.stamp_s - self._views[-1].stamp_s >= _MEMORY_S / _VIEWS:
            self._views.append(view)
        if self._last is not None and np.mean(_looked_past([view], self._last.places_m)) > _GONE_SHARE:
            self.ghost_s = nearby.stamp_s
        if np.count_nonzero(new) < _CELLS:
            self._last = None
            return None
        away = np.linalg.norm(close[new, :2] - here[:2], axis=1)
        found = SuddenObstacle(nearby.stamp_s, close[new][np.argsort(away)], float(away.min()))
        if _is_same(self._last, found):
            shown_s = self._last.shown_s + found.stamp_s - self._last.stamp_s
            found = dataclasses.replace(found, sights=self._last.sights + 1, shown_s=shown_s)
        self._last = found
        return found


def _is_same(before: SuddenObstacle | None, now: SuddenObstacle) -> TypeGuard[SuddenObstacle]:
    """Return True if an obstacle of the frame before may be this one."""
    if before is None:
        return False
    apart_m = float(np.linalg.norm(before.places_m - now.places_m[0], axis=1).min())
    return apart_m <= _SAME_M + _SAME_MPS * (now.stamp_s - before.stamp_s)


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
