"""Line segments and polylines in a padded voxel mask. Lengths are in voxels.

Positions are in padded voxel units.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import ByteArray, FloatArray


@kernel
def distance(x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> float:
    """Return the distance between two points."""
    return math.sqrt((x0 - x1) ** 2 + (y0 - y1) ** 2 + (z0 - z1) ** 2)


@kernel
def segment_is_open(open_samples: ByteArray, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> bool:
    """Return True if every sample of a segment lies in a mask; both ends must lie in it.

    Samples are at most half a voxel apart.

    open_samples: a mask, or, in place of its ones, the number of samples to advance. All samples skipped by the advance are
        known to be open.
    """
    if x0 > x1 or (x0 == x1 and (y0 > y1 or (y0 == y1 and z0 > z1))):
        x0, y0, z0, x1, y1, z1 = x1, y1, z1, x0, y0, z0  # the result is the same in both directions, to the last bit
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    # mid-interval samples of an even number of intervals: never exactly on the corner that a diagonal step passes
    count = 2 * math.ceil(math.sqrt(dx * dx + dy * dy + dz * dz)) + 2
    dx, dy, dz = dx / count, dy / count, dz / count
    x, y, z = x0 + 0.5 * dx, y0 + 0.5 * dy, z0 + 0.5 * dz
    flat, along = open_samples.ravel(), np.int64(open_samples.shape[2])
    across = np.int64(open_samples.shape[1] * open_samples.shape[2])
    n = 0
    while n < count:
        # unsigned: avoids the test for a negative index
        ahead = flat[np.uint64(int(x + n * dx) * across + int(y + n * dy) * along + int(z + n * dz))]
        if ahead == 0:
            return False
        n += ahead
    return True


@kernel
def length_of(points: FloatArray) -> float:
    """Return the length of a polyline (N, 3), in its own unit."""
    total = 0.0
    for n in range(1, len(points)):
        dx, dy, dz = points[n, 0] - points[n - 1, 0], points[n, 1] - points[n - 1, 1], points[n, 2] - points[n - 1, 2]
        total += math.sqrt(dx * dx + dy * dy + dz * dz)
    return total


@kernel
def departure(points: FloatArray) -> FloatArray:
    """Return the unit direction (3,) in which a polyline (N, 3) leaves its first point.

    Zero if it does not move.
    """
    for n in range(1, len(points)):
        step = points[n] - points[0]
        length = math.sqrt((step * step).sum())
        if length > 1e-9:
            direction: FloatArray = step / length
            return direction
    return np.zeros(3)


def warm_up() -> None:
    """Compile all kernels."""
    open_samples = np.ones((4, 4, 4), dtype=np.uint8)
    segment_is_open(open_samples, 1.5, 1.5, 1.5, 2.5, 2.5, 2.5)
    distance(0.0, 0.0, 0.0, 1.0, 1.0, 1.0)
    way = np.array([[1.5, 1.5, 1.5], [1.5, 2.5, 1.5], [2.5, 2.5, 2.5]])
    for polyline in (way, way[::-1]):  # both memory layouts of paths
        length_of(polyline)
        departure(polyline)
