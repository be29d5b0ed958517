"""Where off its voxel's centre a body may stand: no nearer to anything than it may be at a centre.

The mask asks for a distance between centres of voxels. From a centre that may be flown to, sides of voxels are nearer than
that, by no more than the lattice allows; so far every place off a centre must be from them. Positions are in voxel units.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import ByteArray, FloatArray, IntArray

LOW, HIGH, SIDES2 = 0, 3, 6  # in a berth (7,): where the corners of the box begin, and the squared distance
CLEAR, OUTSIDE = -1, -2


def clearance_box(shape: tuple[int, int, int], low: IntArray, high: IntArray, needed2: int) -> FloatArray:
    """What a place off its voxel's centre must keep: a box around centres [low, high), and a distance to sides, squared.

    needed2: what centres keep from the centres of all voxels that are not known free.
    """
    steps2 = np.arange(math.isqrt(needed2) + 2) ** 2
    sides2 = np.maximum(np.arange(len(steps2)) - 0.5, 0.0) ** 2
    far = np.add.outer(np.add.outer(steps2, steps2), steps2) >= needed2
    least2 = float(np.add.outer(np.add.outer(sides2, sides2), sides2)[far].min())
    border = math.sqrt(least2)  # beyond the map nothing is known
    return np.concatenate([np.maximum(low + 0.5, border), np.minimum(high - 0.5, np.array(shape) - border), [least2]])


@kernel
def blocking_voxel(distance2: ByteArray, shape: tuple[int, int, int], berth: FloatArray, x: float, y: float, z: float) -> int:
    """Flat index of a voxel that is not known free and has a side nearer to a place than its berth allows.

    CLEAR if there is none, OUTSIDE if the place is not in its box. distance2: raveled, as in VoxelMap.
    """
    nx, ny, nz = shape
    if not (
        berth[LOW] <= x <= berth[HIGH] and berth[LOW + 1] <= y <= berth[HIGH + 1] and berth[LOW + 2] <= z <= berth[HIGH + 2]
    ):
        return OUTSIDE
    least2 = berth[SIDES2]
    least = math.sqrt(least2)
    own = distance2[np.uint64((int(x) * ny + int(y)) * nz + int(z))]
    if own >= (least + math.sqrt(3.0)) ** 2:  # from the place to its voxel's centre, and from a voxel's corner to its centre
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
