"""Lines of sight through a voxel map. Everything here is in voxel units: voxel (i, j, k) spans [(i,j,k), (i,j,k)+1].

Traversal after Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing" (1987).
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray
from uav_recon.types.maps import FREE


@kernel
def is_visible(state: ByteArray, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float, tail: float) -> bool:
    """Tell whether known-free space alone lies between two points.

    state (nx, ny, nz) uint8; start and end in voxel units. Each voxel that the segment crosses must be FREE, its start's
    included; the end's own voxel is not asked, nor are those within ``tail`` voxels before the end. Unknown and occupied
    voxels block, and so does everything outside the array.
    """
    nx, ny, nz = state.shape
    i, j, k = math.floor(x0), math.floor(y0), math.floor(z0)
    ie, je, ke = math.floor(x1), math.floor(y1), math.floor(z1)
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length < 1e-12:
        return True
    t_end = 1.0 - tail / length
    si = 1 if dx > 0 else -1
    sj = 1 if dy > 0 else -1
    sk = 1 if dz > 0 else -1
    # a zero component never reaches a border: infinity keeps it out of the comparison
    delta_x = 1.0 / abs(dx) if dx != 0.0 else np.inf
    delta_y = 1.0 / abs(dy) if dy != 0.0 else np.inf
    delta_z = 1.0 / abs(dz) if dz != 0.0 else np.inf
    tx = ((i + 1 - x0) if dx > 0 else (x0 - i)) * delta_x if dx != 0.0 else np.inf
    ty = ((j + 1 - y0) if dy > 0 else (y0 - j)) * delta_y if dy != 0.0 else np.inf
    tz = ((k + 1 - z0) if dz > 0 else (z0 - k)) * delta_z if dz != 0.0 else np.inf
    t = 0.0
    while t < t_end and not (i == ie and j == je and k == ke):
        if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
            return False
        if state[i, j, k] != FREE:
            return False
        if tx <= ty and tx <= tz:
            t = tx
            tx += delta_x
            i += si
        elif ty <= tz:
            t = ty
            ty += delta_y
            j += sj
        else:
            t = tz
            tz += delta_z
            k += sk
    return True


@kernel
def visible_targets(state: ByteArray, eye: FloatArray, targets: FloatArray, tail: float) -> BoolArray:
    """is_visible from one eye (3,) to many targets (N, 3), voxel units; (N,) bool."""
    out = np.zeros(len(targets), dtype=np.bool_)
    for n in range(len(targets)):
        out[n] = is_visible(state, eye[0], eye[1], eye[2], targets[n, 0], targets[n, 1], targets[n, 2], tail)
    return out


def warm_up() -> None:
    """Compile for the read-only arrays of a VoxelMap."""
    state = np.full((2, 2, 2), FREE, dtype=np.uint8)
    state.setflags(write=False)
    visible_targets(state, np.full(3, 0.5), np.full((1, 3), 1.5), 0.0)
