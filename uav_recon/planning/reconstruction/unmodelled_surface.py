"""Surface that is in the map but not in the model (not in the paper).

No keyframe shows it, or none well enough. Occupied space beside free space is surface. The map uses every frame, the model
only the views in its budget. A region without a model element nearby is neither a frontier nor uncertain, so without this
module it would get no task.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED

OUT = 0.45  # voxels
BESIDE = 1  # voxels in each direction; an element this near belongs to the surface


@kernel
def _any(held: BoolArray, i: int, j: int, k: int) -> bool:
    """Return True if a voxel or one of its neighbours within BESIDE is held.

    (i, j, k) is the first corner of that cube.
    """
    for a in range(i, i + 2 * BESIDE + 1):
        for b in range(j, j + 2 * BESIDE + 1):
            for c in range(k, k + 2 * BESIDE + 1):
                if held[a, b, c]:
                    return True
    return False


@kernel
def unmodelled_surface(state: ByteArray, low: IntArray, high: IntArray, modelled: IntArray) -> tuple[FloatArray, FloatArray]:  # noqa: C901
    """Return positions (N, 3) and outward unit normals (N, 3) of unmodelled surface.

    Units are voxels. Only voxels in [low, high) of the map are searched. The normal is the mean direction to the free ones
    of the 26 surrounding voxels. The position is in the voxel, OUT of its centre along the normal: a line of sight at a small
    angle to the surface would pass through several voxels of it on the way to a centre.

    state: (nx, ny, nz) uint8.
    modelled: (M, 3) voxels with an element of the model, inside or outside the map.
    """
    nx, ny, nz = state.shape
    # with a border, because elements beside the box count too
    first = (low[0] - BESIDE, low[1] - BESIDE, low[2] - BESIDE)
    held = np.zeros((high[0] - first[0] + BESIDE, high[1] - first[1] + BESIDE, high[2] - first[2] + BESIDE), dtype=np.bool_)
    for m in range(len(modelled)):
        i, j, k = modelled[m, 0] - first[0], modelled[m, 1] - first[1], modelled[m, 2] - first[2]
        if min(i, j, k) >= 0 and i < held.shape[0] and j < held.shape[1] and k < held.shape[2]:
            held[i, j, k] = True
    occupied = np.count_nonzero(state[low[0] : high[0], low[1] : high[1], low[2] : high[2]] == OCCUPIED)
    position = np.empty((occupied, 3))
    normal = np.empty((occupied, 3))
    count = 0
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            for k in range(low[2], high[2]):
                if state[i, j, k] != OCCUPIED:
                    continue
                x, y, z, beside = 0.0, 0.0, 0.0, False
                for a in range(max(i - 1, 0), min(i + 2, nx)):
                    for b in range(max(j - 1, 0), min(j + 2, ny)):
                        for c in range(max(k - 1, 0), min(k + 2, nz)):
                            if state[a, b, c] == FREE:
                                x, y, z = x + a - i, y + b - j, z + c - k
                                beside = beside or abs(a - i) + abs(b - j) + abs(c - k) == 1
                if not beside or _any(held, i - low[0], j - low[1], k - low[2]):
                    continue
                length = math.sqrt(x * x + y * y + z * z)
                if length < 1.0:  # free on both sides: thinner than a voxel, so no side is the outer one
                    continue
                x, y, z = x / length, y / length, z / length
                position[count, 0], position[count, 1], position[count, 2] = (
                    i + 0.5 + OUT * x,
                    j + 0.5 + OUT * y,
                    k + 0.5 + OUT * z,
                )
                normal[count, 0], normal[count, 1], normal[count, 2] = x, y, z
                count += 1
    return position[:count].copy(), normal[:count].copy()
