"""Line-of-sight queries in a voxel map.

All coordinates are in voxel units: voxel (i, j, k) spans [(i,j,k), (i,j,k)+1]. Traversal after Amanatides and Woo, "A Fast
Voxel Traversal Algorithm for Ray Tracing" (1987).
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray
from uav_recon.types.maps import FREE


@kernel
def is_visible(state: ByteArray, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float, tail: float) -> bool:
    """Return True if the segment between two points crosses known-free space only.

    state (nx, ny, nz) uint8; start and end in voxel units. Each voxel that the segment crosses must be FREE, including that
    of the start. The voxel of the end and the voxels within ``tail`` voxels before the end are not checked. Unknown and
    occupied voxels block, and so does everything outside the array.
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
    # the segment never crosses a border along an axis with a zero component: infinity excludes it from the comparison
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
    """Return is_visible from one eye (3,) to targets (N, 3), in voxel units, as (N,) bool."""
    out = np.zeros(len(targets), dtype=np.bool_)
    for n in range(len(targets)):
        out[n] = is_visible(state, eye[0], eye[1], eye[2], targets[n, 0], targets[n, 1], targets[n, 2], tail)
    return out


_ROOT = np.sqrt(np.arange(256))
_WORTH_A_JUMP = 4.0  # squared distance, in squared diagonals of a voxel, below which a jump is hardly longer than a step


@kernel
def first_obstacle(
    distance2: ByteArray, ny: int, nz: int, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float,
    height_weight: float = 1.0,
) -> int:  # fmt: skip
    """Return the flat index of the first voxel on a segment that is not known free, or -1.

    The voxel of the start is not checked, that of the end is. distance2: (nx * ny * nz,) uint8, VoxelMap.distance2
    flattened. Both ends in voxel units and INSIDE the array: this is not checked. The result equals that of a voxel-by-voxel
    traversal, but the search jumps across the free ball around the current point: sphere tracing on exact distances less the
    half diagonals of both voxels, so that no voxel is skipped. height_weight: of these distances, see HeightMeasure.weight.
    """
    i, j, k = int(x0), int(y0), int(z0)
    end = (int(x1) * ny + int(y1)) * nz + int(z1)
    flat = (i * ny + j) * nz + k
    if flat == end:
        return -1
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    # the segment never crosses a border along an axis with a zero component
    dx = dx if abs(dx) > 1e-9 else 1e-9
    dy = dy if abs(dy) > 1e-9 else 1e-9
    dz = dz if abs(dz) > 1e-9 else 1e-9
    per_step = 1.0 / math.sqrt(dx * dx + dy * dy + height_weight * dz * dz)
    diagonal = math.sqrt(2.0 + height_weight)
    jump2 = _WORTH_A_JUMP * (2.0 + height_weight)
    per_x, per_y, per_z = 1.0 / dx, 1.0 / dy, 1.0 / dz
    delta_x, delta_y, delta_z = abs(per_x), abs(per_y), abs(per_z)
    step_x, step_y, step_z = (ny * nz if dx > 0 else -ny * nz), (nz if dy > 0 else -nz), (1 if dz > 0 else -1)
    bi, bj, bk = (1 if dx > 0 else 0), (1 if dy > 0 else 0), (1 if dz > 0 else 0)
    tx, ty, tz = (i + bi - x0) * per_x, (j + bj - y0) * per_y, (k + bk - z0) * per_z
    while True:
        # the order of the borders is close to random, so branches would be mispredicted
        along_x = (tx <= ty) & (tx <= tz)
        along_y = (not along_x) & (ty <= tz)
        t = tx if along_x else (ty if along_y else tz)
        flat += step_x if along_x else (step_y if along_y else step_z)
        if t >= 1.0:
            return -1
        d2 = distance2[np.uint64(flat)]
        if d2 == 0:
            return flat
        if flat == end:
            return -1
        if d2 < jump2:
            tx += delta_x if along_x else 0.0
            ty += delta_y if along_y else 0.0
            tz += 0.0 if along_x | along_y else delta_z
            continue
        while d2 >= jump2:
            t += (_ROOT[d2] - diagonal) * per_step
            if t >= 1.0:
                return -1
            i, j, k = int(x0 + t * dx), int(y0 + t * dy), int(z0 + t * dz)
            flat = (i * ny + j) * nz + k
            if flat == end:
                return -1
            d2 = distance2[np.uint64(flat)]
        tx, ty, tz = (i + bi - x0) * per_x, (j + bj - y0) * per_y, (k + bk - z0) * per_z


def warm_up() -> None:
    """Compile for the read-only arrays of a VoxelMap."""
    state = np.full((2, 2, 2), FREE, dtype=np.uint8)
    state.setflags(write=False)
    visible_targets(state, np.full(3, 0.5), np.full((1, 3), 1.5), 0.0)
    first_obstacle(state.reshape(-1), 2, 2, 0.5, 0.5, 0.5, 1.5, 1.5, 1.5, 1.0)
