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
from uav_recon.types.maps import EUCLIDEAN, HeightMeasure

# indices in a clearance box (9,): lower corner, upper corner, squared distance to voxel sides, and of heights to voxel sides
# the part that does not count and the factor on the rest
LOW = 0
HIGH = 3
SIDES2 = 6
SKIP = 7
SLOPE = 8
CLEAR = -1
OUTSIDE = -2


def make_clearance_box(
    shape: tuple[int, int, int],
    low: IntArray,
    high: IntArray,
    needed2: int,
    heights: HeightMeasure = EUCLIDEAN,
) -> FloatArray:
    """Return the clearance box (9,): bounds of a position and its distance to voxel sides.

    The bounds are a box around the centres [low, high).

    needed2: squared distance in voxels that a centre must keep from the centres of all voxels that are not known free.
    heights: of the distances, see VoxelMap.
    """
    steps = np.arange(math.isqrt(needed2) + 2)
    sides2 = np.maximum(steps - 0.5, 0.0) ** 2
    far = np.add.outer(np.add.outer(steps**2, steps**2), heights.squares(steps)) >= needed2
    skip = max(heights.half_voxels - 0.5, 0.0)
    up2 = (heights.slope * np.maximum(steps - 0.5 - skip, 0.0)) ** 2
    least2 = float(np.add.outer(np.add.outer(sides2, sides2), up2)[far].min())
    least = math.sqrt(least2)
    border = np.array([least, least, least / heights.slope + skip])  # space outside the map is unknown
    bounds = np.maximum(low + 0.5, border), np.minimum(high - 0.5, np.array(shape) - border)
    return np.concatenate([*bounds, [least2, skip, heights.slope]])


@kernel
def blocking_voxel(
    distance2: ByteArray, shape: tuple[int, int, int], clearance_box: FloatArray, x: float, y: float, z: float
) -> int:
    """Return the flat index of a voxel, not known free, with a side too close to a position.

    CLEAR if there is none, OUTSIDE if the position is outside the clearance box.

    distance2: raveled, as in VoxelMap.
    clearance_box: (9,), see make_clearance_box().
    """
    nx, ny, nz = shape
    if not (
        clearance_box[LOW] <= x <= clearance_box[HIGH]
        and clearance_box[LOW + 1] <= y <= clearance_box[HIGH + 1]
        and clearance_box[LOW + 2] <= z <= clearance_box[HIGH + 2]
    ):
        return OUTSIDE
    least2 = clearance_box[SIDES2]
    skip, slope = clearance_box[SKIP], clearance_box[SLOPE]
    least = math.sqrt(least2)
    rise = least / slope + skip
    own = distance2[np.uint64((int(x) * ny + int(y)) * nz + int(z))]
    # the diagonal: from the position to its voxel's centre, and from a voxel's corner to its centre
    if own >= (least + math.sqrt(2.0 + slope * slope)) ** 2:
        return CLEAR
    for i in range(int(x - least), min(int(x + least), nx - 1) + 1):
        across = max(i - x, x - i - 1.0, 0.0)
        for j in range(int(y - least), min(int(y + least), ny - 1) + 1):
            along = max(j - y, y - j - 1.0, 0.0)
            for k in range(int(z - rise), min(int(z + rise), nz - 1) + 1):
                up = slope * max(k - z - skip, z - k - 1.0 - skip, 0.0)
                at = (i * ny + j) * nz + k
                if distance2[np.uint64(at)] == 0 and across * across + along * along + up * up < least2:
                    return at
    return CLEAR
