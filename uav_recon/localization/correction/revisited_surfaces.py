"""Surfaces by when they were first seen.

A tracker that sees old ones has wandered no more than it had then.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.localization.correction.offset_filter import WANDERED
from uav_recon.types.camera import Frame
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

_CELL_M = 0.5
_ROWS, _COLUMNS = 8, 12  # of the pixels that are looked at
_REACH_M = 4.5
_OLD_WAY_M = 3.0  # surfaces are old after this way
_OLD_SHARE = 0.4  # of the points that must lie on old surfaces
_FEWEST = 20


class Wandered(NamedTuple):
    """The wander (6,) of a tracker as in OffsetFilter.wander, and the variances (6,)."""

    mean: FloatArray
    variance: FloatArray


class _FirstSight(NamedTuple):
    way_m: float
    wandered: Wandered


class RevisitedSurfaces:
    """Cells of 0.5 m with the way and the tracker's wander at their first sight.

    Not thread-safe; 0.2 ms a frame.
    """

    def __init__(self) -> None:
        self._seen: dict[tuple[int, ...], _FirstSight] = {}

    def __len__(self) -> int:
        return len(self._seen)

    def look(self, frame: Frame, odom_from_depth: Pose, way_m: float, wandered: Wandered) -> Wandered | None:
        """Remember what a frame shows, and return the wander at its first sight.

        None if too little of it is old. way_m: that the tracker has flown.
        """
        points = odom_from_depth.apply(_sampled(frame))
        rows, counts = np.unique(np.floor(points / _CELL_M).astype(np.int64), axis=0, return_counts=True)
        cells = [tuple(row) for row in rows.tolist()]
        pairs = [(self._seen.get(cell), count) for cell, count in zip(cells, counts.tolist(), strict=True)]
        for cell in cells:
            self._seen.setdefault(cell, _FirstSight(way_m, wandered))
        old = [(then.wandered, count) for then, count in pairs if then is not None and way_m - then.way_m > _OLD_WAY_M]
        total = sum(count for _, count in old)
        if total < max(_OLD_SHARE * len(points), _FEWEST):
            return None
        mean, variance = np.zeros(len(WANDERED)), np.zeros(len(WANDERED))
        for then, count in old:
            mean += count / total * then.mean
            variance += count / total * then.variance
        return Wandered(mean, variance)


def _sampled(frame: Frame) -> FloatArray:
    """Return points (N, 3) of a grid of pixels, in the frame of the depth imager."""
    (height, width), lens = frame.depth_m.shape, frame.depth_intrinsics
    v, u = np.meshgrid(
        (np.linspace(0.05, 0.95, _ROWS) * (height - 1)).astype(int),
        (np.linspace(0.05, 0.95, _COLUMNS) * (width - 1)).astype(int),
        indexing="ij",
    )
    z = frame.depth_m[v, u].astype(np.float64)
    points = np.stack(((u - lens.cx) / lens.fx * z, (v - lens.cy) / lens.fy * z, z), axis=-1)
    return np.asarray(points[(z > 0.0) & (z < _REACH_M)])
