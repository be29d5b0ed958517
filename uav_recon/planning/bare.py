"""Surface that the map knows and the model does not: no kept picture shows it, or none well enough (not in the paper).

Occupied space beside free space is surface, whoever saw it: the map takes every frame, the model only the views in its
budget. A stretch that no element of the model lies near is neither a frontier nor uncertain, so nobody would look at it.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED

BESIDE = 1  # voxels each way: an element so near is this surface's


@kernel
def bare_surface(state: ByteArray, low: IntArray, high: IntArray, modelled: IntArray) -> tuple[FloatArray, FloatArray]:
    """Centres (N, 3) and outward unit normals (N, 3) of bare surface in voxels [low, high) of the map, in voxel units.

    state: (nx, ny, nz) uint8. modelled: (M,) flat indices of voxels that hold an element of the model; negative ones are not
    read. The normal is the mean direction to the free ones of the 26 voxels around.
    """
    nx, ny, nz = state.shape
    size = (high[0] - low[0], high[1] - low[1], high[2] - low[2])
    near = np.zeros(size, dtype=np.bool_)
    for m in range(len(modelled)):
        if modelled[m] < 0:
            continue
        i, j, k = modelled[m] // (ny * nz) - low[0], modelled[m] // nz % ny - low[1], modelled[m] % nz - low[2]
        for a in range(max(i - BESIDE, 0), min(i + BESIDE + 1, size[0])):
            for b in range(max(j - BESIDE, 0), min(j + BESIDE + 1, size[1])):
                for c in range(max(k - BESIDE, 0), min(k + BESIDE + 1, size[2])):
                    near[a, b, c] = True
    position = np.empty((size[0] * size[1] * size[2], 3))
    normal = np.empty((size[0] * size[1] * size[2], 3))
    count = 0
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            for k in range(low[2], high[2]):
                if state[i, j, k] != OCCUPIED or near[i - low[0], j - low[1], k - low[2]]:
                    continue
                x, y, z, beside = 0.0, 0.0, 0.0, False
                for a in range(max(i - 1, 0), min(i + 2, nx)):
                    for b in range(max(j - 1, 0), min(j + 2, ny)):
                        for c in range(max(k - 1, 0), min(k + 2, nz)):
                            if state[a, b, c] == FREE:
                                x, y, z = x + a - i, y + b - j, z + c - k
                                beside = beside or abs(a - i) + abs(b - j) + abs(c - k) == 1
                if not beside:
                    continue
                length = math.sqrt(x * x + y * y + z * z)
                if length < 1.0:  # free on both sides: thinner than a voxel, and no side of it is the outer one
                    continue
                position[count, 0], position[count, 1], position[count, 2] = i + 0.5, j + 0.5, k + 0.5
                normal[count, 0], normal[count, 1], normal[count, 2] = x / length, y / length, z / length
                count += 1
    return position[:count].copy(), normal[:count].copy()
