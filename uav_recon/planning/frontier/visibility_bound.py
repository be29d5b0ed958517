"""Upper bound on the visible frontier from a position, before rays are cast.

It counts the unknown voxels that have an open side towards the eye. A ray to the centre of a voxel enters through the side
that faces the eye most directly. If the voxel in front of that side is not known free, the ray is blocked. This test covers
all voxels of a cluster at once without following a ray. Other obstacles are rare: one position in nine has a higher bound
than the cells shown by the best view.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.planning.camera_frustum import NEAR, PITCH_MAX, PITCH_MIN, RANGE, TAN_H, TAN_V, LineOfSight
from uav_recon.types.frames import ByteArray, Float32Array, FloatArray, IntArray

Int32Array = NDArray[np.int32]
# centres (3, U) of the distinct unknown neighbours, voxels; sides (U,), bit f set = known free towards FACES[f]; then the
# neighbours of each cell: links (L,), and the start of each cell's links (N + 1,)
Targets = tuple[Float32Array, Int32Array, IntArray, IntArray]
# bits of a target as seen from an eye. TURNED: an open side faces the eye, in range. FITTING: also visible at some heading.
# FRAMED: also in the image
FITTING = 1
FRAMED = 2
TURNED = 4
HASH_SIZE = 4096  # size of a hash table, a power of two


@kernel
def distinct_targets(distance2: ByteArray, shape: tuple[int, int, int], points: FloatArray, first: IntArray) -> Targets:
    """Return each unknown neighbour once.

    distance2: raveled. points, first: see view_cache.targets(); fewer points than HASH_SIZE.
    """
    nx, ny, nz = shape
    hash_table = np.zeros(HASH_SIZE, dtype=np.int32)
    links = np.empty(len(points), dtype=np.int64)
    centres = np.empty((3, len(points)), dtype=np.float32)
    sides = np.zeros(len(points), dtype=np.int32)
    count = 0
    for m in range(len(points)):
        i, j, k = int(points[m, 0]), int(points[m, 1]), int(points[m, 2])
        flat = (i * ny + j) * nz + k
        at = (flat * 2654435761 >> 16) & (HASH_SIZE - 1)
        while hash_table[at] != 0:
            u = hash_table[at] - 1
            if centres[0, u] == points[m, 0] and centres[1, u] == points[m, 1] and centres[2, u] == points[m, 2]:
                break
            at = (at + 1) & (HASH_SIZE - 1)
        if hash_table[at] == 0:
            sides[count] = (
                (i > 0 and distance2[flat - ny * nz] != 0)
                | (i < nx - 1 and distance2[flat + ny * nz] != 0) << 1
                | (j > 0 and distance2[flat - nz] != 0) << 2
                | (j < ny - 1 and distance2[flat + nz] != 0) << 3
                | (k > 0 and distance2[flat - 1] != 0) << 4
                | (k < nz - 1 and distance2[flat + 1] != 0) << 5
            )
            for axis in range(3):
                centres[axis, count] = points[m, axis]
            count += 1
            hash_table[at] = count
        links[m] = hash_table[at] - 1
    return centres[:, :count].copy(), sides[:count].copy(), links, first


@kernel
def visibility_bound(targets: Targets, lens: FloatArray, line: LineOfSight, facing: Int32Array) -> tuple[int, int]:
    """Fill facing (U,) with the bits of each target; return how many are TURNED and FRAMED.

    FITTING is exact for a mount that tilts by at most half the image. With a free pitch it equals TURNED. The loop is in
    single precision and without branches, so that it is vectorized.
    """
    centres, sides, _, _ = targets
    xs, ys, zs = centres[0], centres[1], centres[2]
    ex, ey, ez = np.float32(line[0]), np.float32(line[1]), np.float32(line[2])
    cy, sy, cp, sp = np.float32(line[3]), np.float32(line[4]), np.float32(line[5]), np.float32(line[6])
    tan_h, tan_v, zero = np.float32(lens[TAN_H]), np.float32(lens[TAN_V]), np.float32(0.0)
    tall = tan_v if lens[PITCH_MIN] == lens[PITCH_MAX] else np.float32(1e9)
    far2, near2 = np.float32(lens[RANGE] * lens[RANGE]), np.float32(lens[NEAR] * lens[NEAR])
    all_turned, all_framed = np.int32(0), np.int32(0)
    for u in range(len(sides)):
        dx, dy, dz = xs[u] - ex, ys[u] - ey, zs[u] - ez
        ax, ay, az = abs(dx), abs(dy), abs(dz)
        x_side = np.int32(0) if dx > zero else np.int32(1)
        y_side = np.int32(2) if dy > zero else np.int32(3)
        z_side = np.int32(4) if dz > zero else np.int32(5)
        side = y_side if ay >= az else z_side
        side = x_side if (ax >= ay) & (ax >= az) else side
        across2 = dx * dx + dy * dy
        away2 = across2 + dz * dz
        turned = (sides[u] >> side) & np.int32(1) & np.int32((away2 <= far2) & (away2 >= near2))
        across = np.sqrt(across2)
        fitting = turned & np.int32(abs(sp * across + cp * dz) <= (cp * across - sp * dz) * tall)
        along, left = cy * dx + sy * dy, cy * dy - sy * dx
        forward, up = cp * along - sp * dz, sp * along + cp * dz
        framed = turned & np.int32((abs(left) <= forward * tan_h) & (abs(up) <= forward * tan_v) & (forward > zero))
        facing[u] = fitting | (framed << np.int32(1)) | (turned << np.int32(2))  # bits in the order FITTING, FRAMED, TURNED
        all_turned += turned
        all_framed += framed
    return int(all_turned), int(all_framed)


@kernel
def cells_with(targets: Targets, facing: Int32Array) -> tuple[int, int]:
    """Return how many cells have a FITTING target, and how many a FRAMED one."""
    _, _, links, first = targets
    fitting, framed = 0, 0
    for n in range(len(first) - 1):
        bits = 0
        for m in range(first[n], first[n + 1]):
            bits |= int(facing[links[m]])
        fitting += bits & FITTING
        framed += bits >> 1 & 1
    return fitting, framed
