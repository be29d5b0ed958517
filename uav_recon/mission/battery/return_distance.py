"""Length of the way home: back along the breadcrumbs, and straight where the map is clear."""

from __future__ import annotations

import numpy as np

from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.maps import VoxelMap

_CORNERS = 64  #: internal: max. number of checked positions of a path: a longer path has fewer of them per metre


def return_distance_m(way: FloatArray, voxels: VoxelMap | None, clearance_m: float) -> float:
    """Return the length of a flown path (N, 3) home, cut short where a straight line is clear.

    It is never longer than the path itself, never shorter than the straight line. Without a map it is the path itself.
    """
    if len(way) < 2:
        return 0.0
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1)))
    if voxels is None:
        return float(along_m[-1])
    corners = np.unique(np.linspace(0, len(way) - 1, _CORNERS).astype(np.int64))
    at, total_m = 0, 0.0
    while at < len(corners) - 1:
        here, ahead = corners[at], corners[at + 1 :]
        seen = np.flatnonzero(_clear(way[here], way[ahead], voxels, clearance_m))
        step = int(seen[-1]) if len(seen) else 0
        there = ahead[step]
        straight_m = float(np.linalg.norm(way[there] - way[here]))
        total_m += straight_m if len(seen) else float(along_m[there] - along_m[here])
        at += step + 1
    return total_m


def _clear(here: FloatArray, there: FloatArray, voxels: VoxelMap, clearance_m: float) -> BoolArray:
    """Return a mask (C,) of the positions (C, 3) on a clear straight line from here (3,)."""
    farthest_m = float(np.linalg.norm(there - here, axis=1).max())
    shares = np.linspace(0.0, 1.0, 2 + int(farthest_m / voxels.grid.resolution_m))
    points: FloatArray = here + shares[None, :, None] * (there - here)[:, None, :]
    index: IntArray = voxels.grid.index(points)
    clear: BoolArray = np.all(voxels.distance_m(index) >= clearance_m, axis=1)
    return clear
