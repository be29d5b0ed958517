"""Whether something stands now where a moment ago nothing was: a door, a person, a thing that comes nearer."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.min_range_grid import MinRangeGrid, in_view
from uav_recon.types.pose import Pose

_MEMORY_S = 0.8
_VIEWS = 6  # kept for so long, evenly
_INSIDE_M, _INSIDE_SHARE = 0.20, 0.04  # so far before what was seen there then, and this share of the range: pose and noise
_REACH_M = 3.0  # from the body's centre; what is farther does not concern it yet
_CELLS, _SAYING = 2, 2  # returns that it has at least, and views that looked past each of them


@dataclass(frozen=True, slots=True, eq=False)
class SuddenObstacle:
    """places_m: its returns in odom (N, 3), one a cell, the nearest first, seen at stamp_s; away_m: how far that is from the
    body's centre, level.
    """

    stamp_s: float
    places_m: FloatArray
    away_m: float


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """range_m: the nearest return in the cell or beside it, NaN where that is not known."""

    stamp_s: float
    odom_from_depth: Pose
    half_tan: tuple[float, float]
    range_m: FloatArray


class Neighbourhood:
    """Remembers what the camera looked past in the last second, by cells; about 0.2 ms a frame."""

    def __init__(self) -> None:
        self._views: deque[_View] = deque()

    def forget(self) -> None:
        """Odom itself jumped."""
        self._views.clear()

    def look(self, nearby: MinRangeGrid, odom_from_body: Pose) -> SuddenObstacle | None:
        """What in a frame stands where views of the last moments looked past, the nearest of it; None for nothing."""
        odom_from_depth = odom_from_body @ nearby.body_from_depth
        while self._views and nearby.stamp_s - self._views[0].stamp_s > _MEMORY_S:
            self._views.popleft()
        if self._views and self._views[-1].range_m.shape != nearby.range_m.shape:
            self._views.clear()  # of another camera
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
    """How many views had nothing at places (N, 3) in odom, nor before them: (N,)."""
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
    """Each cell's nearest return or that of the eight around it; NaN where most of it has none, or it lies at the border, or
    above one most of which has none: near the floor that is the floor, too near to be seen, and a table's top at a flat angle
    shows nothing of itself but what is behind it.
    """
    range_m = nearby.range_m
    nearest = np.full(range_m.shape, np.nan)
    rows, columns = range_m.shape
    around = [range_m[i : rows - 2 + i, j : columns - 2 + j] for i in range(3) for j in range(3)]
    there = np.isfinite(range_m) & nearby.full
    tells = there[1:-1, 1:-1] & there[2:, :-2] & there[2:, 1:-1] & there[2:, 2:]
    nearest[1:-1, 1:-1] = np.where(tells, np.fmin.reduce(around), np.nan)
    return nearest
