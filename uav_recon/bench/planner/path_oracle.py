"""Shortest paths independent of the planner, by scikit-image's MCP and dynamic programming.

MCP searches on the 26-connected grid; dynamic programming shortens its path. A mask is (nx, ny, nz) bool, True = the body's
centre may be there. Cells are its indices, lengths are in voxels.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage
from skimage.graph import MCP_Geometric

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, VoxelMap

SAMPLES_PER_VOXEL = 20
_AROUND = np.ones((3, 3, 3), dtype=bool)


def flyable(voxels: VoxelMap, clearance_m: float, low: IntArray, high: IntArray) -> BoolArray:
    """Return the free voxels in [low, high) that have the clearance, by scipy's exact transform.

    The distance to the centre of a voxel that is not free must be the clearance plus half a voxel, because an obstacle may
    extend to its near face.
    """
    free = np.pad(voxels.state == FREE, 1)
    away_m = ndimage.distance_transform_edt(free)[1:-1, 1:-1, 1:-1] * voxels.grid.resolution_m
    mask: BoolArray = away_m >= clearance_m + voxels.grid.resolution_m * (0.5 - 1e-3)
    inside = np.zeros_like(mask)
    inside[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = True
    return mask & inside


def connected_pairs(mask: BoolArray, count: int, seed: int) -> IntArray:
    """Return seeded random pairs of different cells of the largest component.

    The component is 26-connected. The shape is (count, 2, 3), or (0, 2, 3) if the component has only one cell.
    """
    labels, parts = ndimage.label(mask, structure=_AROUND)
    cells = (
        np.argwhere(labels == 1 + int(np.argmax(np.bincount(labels[mask])[1:]))) if parts else np.zeros((0, 3), dtype=np.int64)
    )
    if len(cells) < 2:
        return np.zeros((0, 2, 3), dtype=np.int64)
    rng = np.random.default_rng(seed)
    return np.stack([cells[rng.choice(len(cells), 2, replace=False)] for _ in range(count)])


def shortest_path(mask: BoolArray, start: IntArray, goal: IntArray) -> FloatArray:
    """Return the points (M, 3) of a shortest path from ``start`` to ``goal``, in voxels.

    The points are cell centres. The path is an exact 26-grid path, shortened: of all subsequences of its cells whose lines
    stay in the mask, the shortest. Raises ValueError if there is no path.
    """
    search = MCP_Geometric(np.where(mask, 1.0, -1.0), fully_connected=True)
    search.find_costs([tuple(start)], [tuple(goal)])
    return _pulled(mask, np.array(search.traceback(tuple(goal)), dtype=np.float64) + 0.5)


@kernel
def length_of(points: FloatArray) -> float:
    """Return the length of a polyline (M, 3)."""
    total = 0.0
    for n in range(1, len(points)):
        total += math.sqrt(((points[n] - points[n - 1]) ** 2).sum())
    return total


@kernel
def _is_open(mask: BoolArray, a: FloatArray, b: FloatArray) -> bool:
    # mid-interval samples: a diagonal step passes exactly over a corner or an edge, which is never sampled
    count = 2 * math.ceil(SAMPLES_PER_VOXEL / 2 * math.sqrt(((b - a) ** 2).sum()))
    for n in range(count):
        p = a + (n + 0.5) / count * (b - a)
        if not mask[int(p[0]), int(p[1]), int(p[2])]:
            return False
    return True


@kernel
def _pulled(mask: BoolArray, points: FloatArray) -> FloatArray:
    count = len(points)
    best = np.full(count, np.inf)
    before = np.zeros(count, dtype=np.int64)
    best[0] = 0.0
    for j in range(1, count):
        for i in range(j):
            reached = best[i] + math.sqrt(((points[j] - points[i]) ** 2).sum())
            if reached < best[j] and (i == j - 1 or _is_open(mask, points[i], points[j])):
                best[j], before[j] = reached, i
    kept = np.zeros(count, dtype=np.bool_)
    at = count - 1
    while at > 0:
        kept[at] = True
        at = before[at]
    kept[0] = True
    return points[kept]
