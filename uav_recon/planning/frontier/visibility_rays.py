"""Ray casting from a position to frontier cells, and the voxels that block the rays.

A cell counts as seen if one of its UNKNOWN neighbours is in the frustum, in range, and reached through known-free voxels
only: a view from there makes that neighbour known. Rays start at the neighbour, because most blocked rays are blocked close
to it.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.traversal import first_obstacle
from uav_recon.planning.camera_frustum import LineOfSight, in_view, sight
from uav_recon.planning.frontier.visibility_bound import FITTING, HASH_SIZE, Int32Array, Targets
from uav_recon.types.frames import BoolArray, ByteArray, Float32Array, FloatArray, IntArray

Scene = tuple[
    ByteArray, tuple[int, int, int], FloatArray, float
]  # distance2 raveled, its shape, the lens, HeightMeasure.weight
Blockers = tuple[Int32Array, Int32Array]  # blockers: a hash table of them, and the list in order
# result of the ray to a target
UNASKED = 0
CLEAR = 1
HIDDEN = 2


@kernel
def record_blocker(voxel: int, blockers: Blockers, count: int) -> int:
    """Append a voxel to the list of blockers if it is not in it; return the number of blockers."""
    hash_table, listed = blockers
    at = (voxel * 2654435761 >> 16) & (HASH_SIZE - 1)
    while hash_table[np.uint64(at)] != 0:
        if hash_table[np.uint64(at)] == voxel + 1:
            return count
        at = (at + 1) & (HASH_SIZE - 1)
    if count < len(listed):
        hash_table[np.uint64(at)] = voxel + 1
        listed[count] = voxel
    return count + 1


@kernel
def record_side_blockers(shape: tuple[int, int, int], targets: Targets, blockers: Blockers, count: int) -> int:
    """Append the voxels that close the sides of the targets; return the number of blockers."""
    nx, ny, nz = shape
    centres, sides, _, _ = targets
    for u in range(len(sides)):
        i, j, k = int(centres[0, u]), int(centres[1, u]), int(centres[2, u])
        flat = (i * ny + j) * nz + k
        closed = ~sides[u]
        if closed & 1 and i > 0:
            count = record_blocker(flat - ny * nz, blockers, count)
        if closed & 2 and i < nx - 1:
            count = record_blocker(flat + ny * nz, blockers, count)
        if closed & 4 and j > 0:
            count = record_blocker(flat - nz, blockers, count)
        if closed & 8 and j < ny - 1:
            count = record_blocker(flat + nz, blockers, count)
        if closed & 16 and k > 0:
            count = record_blocker(flat - 1, blockers, count)
        if closed & 32 and k < nz - 1:
            count = record_blocker(flat + 1, blockers, count)
    return count


@kernel
def inside(shape: tuple[int, int, int], line: LineOfSight) -> bool:
    """Return True if an eye is inside the map."""
    return 0.0 <= line[0] < shape[0] and 0.0 <= line[1] < shape[1] and 0.0 <= line[2] < shape[2]


@kernel
def candidate_rays(targets: Targets, line: LineOfSight, facing: Int32Array, directions: Float32Array) -> int:
    """Fill directions (3, N) to the first FITTING target of each cell; return N.

    Cells without such a target are skipped.
    """
    centres, _, links, first = targets
    count = 0
    for n in range(len(first) - 1):
        for m in range(first[n], first[n + 1]):
            u = links[m]
            if facing[u] & FITTING:
                for axis in range(3):
                    directions[axis, count] = centres[axis, u] - np.float32(line[axis])
                count += 1
                break
    return count


@kernel
def visible_cells(
    scene: Scene,
    targets: Targets,
    line: LineOfSight,
    facing: Int32Array,
    candidates: int,
    to_exceed: int,
    order: IntArray,
    found: ByteArray,
    directions: Float32Array,
    blockers: Blockers,
    count: int,
) -> tuple[int, int]:
    """Fill directions (3, N) with a direction to each cell visible at any heading.

    Returns N and the number of blockers. N is 0 if it cannot exceed ``to_exceed``.

    facing: see visibility_bound().
    candidates: number of cells with a FITTING target.
    order: (N,) order of the cells, changed: recently hidden cells are tested first.
    found: (U,) work array.
    """
    distance2, shape, _, weight = scene
    centres, _, links, first = targets
    found[:] = UNASKED
    visible, hidden = 0, 0
    for at in range(len(order)):
        cell = order[at]
        asked, shown = False, False
        for m in range(first[cell], first[cell + 1]):
            u = links[m]
            if not facing[u] & FITTING:
                continue
            asked = True
            if found[u] == UNASKED:
                x, y, z = float(centres[0, u]), float(centres[1, u]), float(centres[2, u])
                voxel = first_obstacle(distance2, shape[1], shape[2], x, y, z, line[0], line[1], line[2], weight)
                found[u] = CLEAR if voxel < 0 else HIDDEN
                if voxel >= 0:
                    count = record_blocker(voxel, blockers, count)
            if found[u] == CLEAR:
                for axis in range(3):
                    directions[axis, visible] = centres[axis, u] - np.float32(line[axis])
                visible += 1
                shown = True
                break
        if asked and not shown:
            order[at], order[hidden] = order[hidden], cell
            hidden += 1
            if candidates - hidden <= to_exceed:
                return 0, count
    return visible, count


@kernel
def confirm_visible(
    scene: Scene, view: FloatArray, points: FloatArray, first: IntArray, blockers: Blockers, count: int
) -> tuple[BoolArray, int]:
    """Return a mask of the cells that a view shows, and the number of blockers.

    Rays are cast in both directions, because a line through an edge or corner of voxels may be clear in only one of them.
    """
    distance2, shape, lens, weight = scene
    line = sight(lens, view[:3], view[3], view[4])
    seen = np.zeros(len(first) - 1, dtype=np.bool_)
    for cell in range(len(seen)):
        for n in range(first[cell], first[cell + 1]):
            x, y, z = points[n, 0], points[n, 1], points[n, 2]
            if not in_view(lens, line, x, y, z):
                continue
            voxel = first_obstacle(distance2, shape[1], shape[2], x, y, z, line[0], line[1], line[2], weight)
            if voxel < 0:
                own = (int(x) * shape[1] + int(y)) * shape[2] + int(z)
                voxel = first_obstacle(distance2, shape[1], shape[2], line[0], line[1], line[2], x, y, z, weight)
                if voxel < 0 or voxel == own:
                    seen[cell] = True
                    break
            count = record_blocker(voxel, blockers, count)
    return seen, count
