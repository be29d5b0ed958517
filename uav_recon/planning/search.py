"""Shortest paths on a padded voxel mask, and pulling them straight. All lengths are in voxels, positions in padded voxels.

A mask is (nx, ny, nz) uint8 with a border of zeros: 1 = may be entered.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import ByteArray, FloatArray, IntArray

CellArray = NDArray[np.int32]  # flat cell indices: half the memory to fill for each search

STEPS = np.array(
    [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) != (0, 0, 0)], dtype=np.int64
)
STEP_LENGTHS = np.sqrt((STEPS**2).sum(axis=1).astype(np.float64))


def distances_from(mask: ByteArray, source: int, targets: IntArray, limit: float) -> tuple[FloatArray, CellArray]:
    """Exact 26-connected path lengths from one cell, flat arrays (n,): distance (inf = not reached) and previous cell (-1).

    Stops once all ``targets`` (flat indices; none = never) are settled, or beyond ``limit`` voxels. The source is taken as
    given, whatever the mask says of it.
    """
    strides = np.array([mask.shape[1] * mask.shape[2], mask.shape[2], 1], dtype=np.int64)
    return _spread(mask.ravel(), STEPS @ strides, STEP_LENGTHS, source, targets, limit)


@kernel
def _spread(
    mask: ByteArray, offsets: IntArray, lengths: FloatArray, source: int, targets: IntArray, limit: float
) -> tuple[FloatArray, CellArray]:
    # Dijkstra with buckets one voxel wide (Dinitz): no edge is shorter than a bucket, so the order inside one is free
    n = len(mask)
    distance = np.full(n, np.inf)
    previous = np.full(n, -1, dtype=np.int32)
    buckets = np.empty((3, n), dtype=np.int32)
    sizes = np.zeros(3, dtype=np.int64)
    listed = np.full(n, -1, dtype=np.int32)  # last bucket that a cell was put on
    distance[source] = 0.0
    buckets[0, 0] = source
    sizes[0] = 1
    level = 0
    open_targets = len(targets)
    while sizes[0] + sizes[1] + sizes[2] > 0 and level <= limit:
        slot = level % 3
        for m in range(sizes[slot]):
            cell = buckets[slot, m]
            here = distance[cell]
            if here < level:
                continue  # settled in an earlier bucket
            for e in range(len(offsets)):
                neighbour = cell + offsets[e]
                reached = here + lengths[e]
                if mask[neighbour] == 0 or reached >= distance[neighbour] or reached > limit:
                    continue
                distance[neighbour] = reached
                previous[neighbour] = cell
                into = int(reached)
                if listed[neighbour] != into:
                    listed[neighbour] = into
                    buckets[into % 3, sizes[into % 3]] = neighbour
                    sizes[into % 3] += 1
        sizes[slot] = 0
        level += 1
        if open_targets > 0:
            open_targets = 0
            for m in range(len(targets)):
                if distance[targets[m]] >= level:
                    open_targets += 1
            if open_targets == 0:
                break
    return distance, previous


@kernel
def chain(previous: CellArray, cell: int) -> IntArray:
    """Cells from the source to ``cell``, both included."""
    count = 1
    at = cell
    while previous[at] >= 0:
        at = previous[at]
        count += 1
    out = np.empty(count, dtype=np.int64)
    at = cell
    for n in range(count - 1, -1, -1):
        out[n] = at
        at = previous[at]
    return out


@kernel
def line_is_open(mask: ByteArray, a: FloatArray, b: FloatArray) -> bool:
    """Tell whether every sample of a straight segment, at most half a voxel apart, lies in the mask."""
    for axis in range(3):
        if min(a[axis], b[axis]) < 0.0 or max(a[axis], b[axis]) >= mask.shape[axis]:
            return False
    return segment_is_open(mask, a[0], a[1], a[2], b[0], b[1], b[2])


@kernel
def distance(x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> float:
    """Return how far apart two points are."""
    return math.sqrt((x0 - x1) ** 2 + (y0 - y1) ** 2 + (z0 - z1) ** 2)


@kernel
def segment_is_open(leap: ByteArray, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> bool:
    """line_is_open for ends that are known to lie in the array.

    leap: a mask, or in place of its ones how many samples to go on by, all but the last of them known to be open.
    """
    if x0 > x1 or (x0 == x1 and (y0 > y1 or (y0 == y1 and z0 > z1))):
        x0, y0, z0, x1, y1, z1 = x1, y1, z1, x0, y0, z0  # the same both ways, to the last bit
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    # mid-interval samples of an even number of intervals: never exactly on the corner that a diagonal step passes
    count = 2 * math.ceil(math.sqrt(dx * dx + dy * dy + dz * dz)) + 2
    dx, dy, dz = dx / count, dy / count, dz / count
    x, y, z = x0 + 0.5 * dx, y0 + 0.5 * dy, z0 + 0.5 * dz
    flat, across, along = leap.ravel(), np.int64(leap.shape[1] * leap.shape[2]), np.int64(leap.shape[2])
    n = 0
    while n < count:
        # unsigned: an index that needs no test for being negative
        ahead = flat[np.uint64(int(x + n * dx) * across + int(y + n * dy) * along + int(z + n * dz))]
        if ahead == 0:
            return False
        n += ahead
    return True


@kernel
def pull(mask: ByteArray, points: FloatArray) -> FloatArray:
    """Straighten a polyline (N, 3): leave out points wherever the direct line is open. Ends stay."""
    count = len(points)
    keep = np.zeros(count, dtype=np.bool_)
    keep[0] = True
    keep[count - 1] = True
    anchor = 0
    while anchor < count - 1:
        reach = anchor + 1
        # the farthest point in sight, looked for from the far end: paths are short, and this pulls tightest
        for far in range(count - 1, anchor + 1, -1):
            if line_is_open(mask, points[anchor], points[far]):
                reach = far
                break
        keep[reach] = True
        anchor = reach
    return points[keep]


@kernel
def length_of(points: FloatArray) -> float:
    """Length of a polyline (N, 3), in its own unit."""
    total = 0.0
    for n in range(1, len(points)):
        dx, dy, dz = points[n, 0] - points[n - 1, 0], points[n, 1] - points[n - 1, 1], points[n, 2] - points[n - 1, 2]
        total += math.sqrt(dx * dx + dy * dy + dz * dz)
    return total


@kernel
def departure(points: FloatArray) -> FloatArray:
    """Unit direction (3,) in which a polyline (N, 3) leaves its first point; zero where it does not move."""
    for n in range(1, len(points)):
        step = points[n] - points[0]
        length = math.sqrt((step * step).sum())
        if length > 1e-9:
            direction: FloatArray = step / length
            return direction
    return np.zeros(3)


def warm_up() -> None:
    """Compile all kernels."""
    mask = np.zeros((4, 4, 4), dtype=np.uint8)
    mask[1:3, 1:3, 1:3] = 1
    _, previous = distances_from(mask, 21, np.array([42]), np.inf)
    chain(previous, 42)
    way = pull(mask, np.array([[1.5, 1.5, 1.5], [1.5, 2.5, 1.5], [2.5, 2.5, 2.5]]))
    for polyline in (way, way[::-1]):  # both memory layouts that routes uses
        length_of(polyline)
        departure(polyline)
