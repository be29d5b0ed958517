"""Clearance of positions off a voxel centre: not less than the clearance at a centre.

The mask requires a distance between voxel centres. From a flyable centre, the sides of the blocking voxels are closer than
that distance, by an amount bounded by the grid. Every position off a centre must keep this smaller distance from the sides.
Positions are in voxel units.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import ByteArray, FloatArray, IntArray

# indices in a clearance box (7,): lower corner, upper corner, squared distance to voxel sides
LOW = 0
HIGH = 3
SIDES2 = 6
CLEAR = -1
OUTSIDE = -2


def make_clearance_box(shape: tuple[int, int, int], low: IntArray, high: IntArray, needed2: int) -> FloatArray:
    """Return the clearance box (7,): bounds of a position and squared distance to voxel sides.

    The bounds are a box around the centres [low, high).

    needed2: squared distance in voxels that a centre must keep from the centres of all voxels that are not known free.
    """
    steps2 = np.arange(math.isqrt(needed2) + 2) ** 2
    sides2 = np.maximum(np.arange(len(steps2)) - 0.5, 0.0) ** 2
    far = np.add.outer(np.add.outer(steps2, steps2), steps2) >= needed2
    least2 = float(np.add.outer(np.add.outer(sides2, sides2), sides2)[far].min())
    border = math.sqrt(least2)  # space outside the map is unknown
    return np.concatenate([np.maximum(low + 0.5, border), np.minimum(high - 0.5, np.array(shape) - border), [least2]])


@kernel
def blocking_voxel(
    distance2: ByteArray, shape: tuple[int, int, int], clearance_box: FloatArray, x: float, y: float, z: float
) -> int:
    """Return the flat index of a voxel, not known free, with a side too close to a position.

    CLEAR if there is none, OUTSIDE if the position is outside the clearance box.

    distance2: raveled, as in VoxelMap.
    clearance_box: (7,), see make_clearance_box().
    """
    nx, ny, nz = shape
    if not (
        clearance_box[LOW] <= x <= clearance_box[HIGH]
        and clearance_box[LOW + 1] <= y <= clearance_box[HIGH + 1]
        and clearance_box[LOW + 2] <= z <= clearance_box[HIGH + 2]
    ):
        return OUTSIDE
    least2 = clearance_box[SIDES2]
    least = math.sqrt(least2)
    own = distance2[np.uint64((int(x) * ny + int(y)) * nz + int(z))]
    if own >= (least + math.sqrt(3.0)) ** 2:  # from the position to its voxel's centre, and from a voxel's corner to its centre
        return CLEAR
    for i in range(int(x - least), min(int(x + least), nx - 1) + 1):
        across = max(i - x, x - i - 1.0, 0.0)
        for j in range(int(y - least), min(int(y + least), ny - 1) + 1):
            along = max(j - y, y - j - 1.0, 0.0)
            for k in range(int(z - least), min(int(z + least), nz - 1) + 1):
                up = max(k - z, z - k - 1.0, 0.0)
                at = (i * ny + j) * nz + k
                if distance2[np.uint64(at)] == 0 and across * across + along * along + up * up < least2:
                    return at
    return CLEAR
