"""Moving parts of the view: returns where earlier views looked past.

A person who walks through the view moves a large part of it. Taken for the room, it moves the track. So the tracker gets a
frame without what stands where the views of the last second saw free space.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from uav_recon.geometry.min_range_binning import nearest_in_cells
from uav_recon.types.camera import Frame
from uav_recon.types.frames import BoolArray, Float32Array, FloatArray
from uav_recon.types.min_range_grid import MinRangeGrid, in_view
from uav_recon.types.pose import Pose

_MEMORY_S = 1.5  #: reject: a part of the view moves where the views of this time looked past
_VIEWS = 8  # views within that time, at even intervals
_SAYING = 2  #: reject: number of those views that must have looked past
_NEARER_M = 0.30  #: reject: a return is at least this much nearer than what they saw: the track is right to less in this time
_NEARER_SHARE = 0.06  #: reject: the same, added as a share of the range
_FARTHEST_M = 5.0  # beyond, the noise of depth is as large
_DEEP_M = 0.5  # depth of a body: returns beside it and farther behind it are the room's
_CELLS = 2  # fewer cells are noise
_PERSON_CELLS = 6  #: reject: this many cells that move may have moved the track
_MOST_SHARE = 0.5  #: reject: no part, if more than this share of the cells seems to move: then the track is wrong


@dataclass(frozen=True, slots=True, eq=False)
class _PastView:
    """A past view.

    range_m: the nearest return in the cell or beside it, NaN where that is not known.
    """

    stamp_s: float
    odom_from_depth: Pose
    half_tan: tuple[float, float]
    range_m: FloatArray


class MovingParts:
    """The views of the last second of one camera. Not thread-safe; about 0.4 ms a frame.

    ``moved_s``: stamp of the newest frame of which a large part moved: the track may be wrong. -inf before the first.
    """

    def __init__(self) -> None:
        self._views: deque[_PastView] = deque()
        self.moved_s = -math.inf

    def forget(self) -> None:
        """Forget all views: the track begins again."""
        self._views.clear()

    def without(self, frame: Frame, odom_from_depth: Pose) -> Frame:
        """Return a frame without the returns of what moves; the same object if nothing does.

        odom_from_depth: predicted pose of the depth imager.
        """
        grid = nearest_in_cells(frame, Pose.identity())
        while self._views and not 0.0 <= frame.stamp_s - self._views[0].stamp_s <= _MEMORY_S:
            self._views.popleft()
        if self._views and self._views[-1].range_m.shape != grid.range_m.shape:
            self._views.clear()
        moving = self._moving(grid, odom_from_depth)
        if not self._views or frame.stamp_s - self._views[-1].stamp_s >= _MEMORY_S / _VIEWS:
            self._views.append(_PastView(frame.stamp_s, odom_from_depth, grid.half_tan, _eroded(grid)))
        cells = np.count_nonzero(moving)
        self.moved_s = frame.stamp_s if cells >= _PERSON_CELLS else self.moved_s
        few = not _CELLS <= cells <= _MOST_SHARE * np.count_nonzero(np.isfinite(grid.range_m))
        return frame if few else replace(frame, depth_m=_without(frame.depth_m, np.where(moving, grid.range_m, np.inf)))

    def _moving(self, grid: MinRangeGrid, odom_from_depth: Pose) -> BoolArray:
        """Return the cells (rows, columns) whose nearest return moves."""
        moving = np.zeros(grid.range_m.shape, dtype=np.bool_)
        there = np.isfinite(grid.range_m)
        if len(self._views) < _SAYING or not there.any():
            return moving
        places, range_m = odom_from_depth.apply(grid.points()), np.array([view.range_m for view in self._views])
        seen = np.array([view.odom_from_depth.inverse().apply(places) for view in self._views])
        half_tan = np.array([[view.half_tan] for view in self._views])
        past, v, u = in_view(seen, half_tan, range_m.shape)
        n, _ = inside = np.nonzero(past)
        free_m = range_m[n, v[inside].astype(int), u[inside].astype(int)]
        past[inside] = np.linalg.norm(seen[inside], axis=1) * (1.0 + _NEARER_SHARE) + _NEARER_M < free_m
        moving[there] = (np.count_nonzero(past, axis=0) >= _SAYING) & (grid.range_m[there] <= _FARTHEST_M)
        return moving


def _eroded(grid: MinRangeGrid) -> FloatArray:
    """Return for each cell the nearest return in it and the eight around it.

    NaN where one of them has none, or is hardly seen.
    """
    nearest, range_m = np.full(grid.range_m.shape, np.nan), np.where(grid.full, grid.range_m, np.nan)
    rows, columns = range_m.shape
    around = [range_m[i : rows - 2 + i, j : columns - 2 + j] for i in range(3) for j in range(3)]
    nearest[1:-1, 1:-1] = np.minimum.reduce(around)
    return nearest


def _without(depth_m: Float32Array, moving_m: FloatArray) -> Float32Array:
    """Return a depth image without what is in or beside moving cells, and not behind them.

    moving_m (rows, columns): range of the nearest return of a moving cell, infinity for the others.
    """
    padded = np.pad(moving_m, 1, constant_values=np.inf)
    rows, columns = moving_m.shape
    beside = np.minimum.reduce([padded[i : rows + i, j : columns + j] for i in range(3) for j in range(3)])
    height, width = depth_m.shape
    row, column = np.arange(height) * rows // height, np.arange(width) * columns // width
    until_m = np.where(np.isfinite(beside), beside + _DEEP_M, 0.0)[row[:, None], column[None, :]]
    return np.where(depth_m <= until_m, np.float32(np.nan), depth_m)
