"""Geodesic neighbourhood: a radius measured along paths through free space.

Thus it does not extend through walls.

The search runs from the vehicle over every third voxel along each axis. A step is open if all voxels that it passes are known
free. A wall of one voxel stops it; an opening wide enough for the vehicle never does. Few nodes are needed.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.traversal import is_visible
from uav_recon.planning.reconstruction.view_gain import TAIL
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE

STRIDE = 3  # voxels between nodes of the search
AROUND = 2  # nodes in each direction that are tested for a line of sight to an element


@kernel
def geodesic_distances(state: ByteArray, start: IntArray, limit: float) -> tuple[FloatArray, IntArray]:  # noqa: C901
    """Return path lengths in voxels from a voxel to nodes STRIDE apart, up to ``limit``.

    Returns (na, nb, nc) float64 for a box of nodes, inf = farther or no path, and the voxel (3,) of the first node: node
    (a, b, c) is the voxel first + STRIDE * (a, b, c). Only that box is allocated, for any map size.
    """
    most = int(limit) // STRIDE
    low = np.empty(3, dtype=np.int64)
    size = np.empty(3, dtype=np.int64)
    for axis in range(3):
        below = min(most, start[axis] // STRIDE)
        above = min(most, (state.shape[axis] - 1 - start[axis]) // STRIDE)
        low[axis] = start[axis] - STRIDE * below
        size[axis] = below + above + 1
    reach = np.full((size[0], size[1], size[2]), np.inf)
    # nodes are queued again when a shorter path to them is found, so the final result is exact in any order
    count = size[0] * size[1] * size[2]
    queue = np.empty(count, dtype=np.int64)
    waiting = np.zeros(count, dtype=np.bool_)
    a, b, c = (start[0] - low[0]) // STRIDE, (start[1] - low[1]) // STRIDE, (start[2] - low[2]) // STRIDE
    reach[a, b, c] = 0.0
    queue[0] = (a * size[1] + b) * size[2] + c
    head, length = 0, 1
    while length > 0:
        node = queue[head]
        head = (head + 1) % count
        length -= 1
        waiting[node] = False
        a, b, c = node // (size[1] * size[2]), node // size[2] % size[1], node % size[2]
        here = reach[a, b, c]
        i, j, k = low[0] + STRIDE * a, low[1] + STRIDE * b, low[2] + STRIDE * c
        for da in range(-1, 2):
            for db in range(-1, 2):
                for dc in range(-1, 2):
                    na, nb, nc = a + da, b + db, c + dc
                    if na < 0 or nb < 0 or nc < 0 or na >= size[0] or nb >= size[1] or nc >= size[2]:
                        continue
                    there = here + STRIDE * math.sqrt(da * da + db * db + dc * dc)
                    if there > limit or there >= reach[na, nb, nc] - 1e-9:
                        continue
                    is_open = True
                    for step in range(1, STRIDE + 1):
                        is_open = is_open and state[i + step * da, j + step * db, k + step * dc] == FREE
                    if not is_open:
                        continue
                    reach[na, nb, nc] = there
                    node = (na * size[1] + nb) * size[2] + nc
                    if not waiting[node]:
                        waiting[node] = True
                        queue[(head + length) % count] = node
                        length += 1
    return reach, low


@kernel
def within_geodesic_radius(
    state: ByteArray, reach: FloatArray, low: IntArray, limit: float, position: FloatArray, normal: FloatArray
) -> BoolArray:
    """Return a mask (N,) of the surface points within ``limit``.

    The distance of a point is the path to a nearby node that sees it, plus the line of sight.

    position, normal: (N, 3) points and outward normals, in voxels.
    """
    out = np.zeros(len(position), dtype=np.bool_)
    for n in range(len(position)):
        x, y, z = position[n, 0], position[n, 1], position[n, 2]
        # the search is centred one step in front of the surface
        a = int(np.floor((x + STRIDE * normal[n, 0] - low[0]) / STRIDE))
        b = int(np.floor((y + STRIDE * normal[n, 1] - low[1]) / STRIDE))
        c = int(np.floor((z + STRIDE * normal[n, 2] - low[2]) / STRIDE))
        for ring in range(AROUND + 1):
            if out[n]:
                break
            for na in range(max(a - ring, 0), min(a + ring + 1, reach.shape[0])):
                for nb in range(max(b - ring, 0), min(b + ring + 1, reach.shape[1])):
                    for nc in range(max(c - ring, 0), min(c + ring + 1, reach.shape[2])):
                        if out[n] or max(abs(na - a), abs(nb - b), abs(nc - c)) != ring or reach[na, nb, nc] == np.inf:
                            continue
                        ex, ey, ez = low[0] + STRIDE * na + 0.5, low[1] + STRIDE * nb + 0.5, low[2] + STRIDE * nc + 0.5
                        facing = normal[n, 0] * (ex - x) + normal[n, 1] * (ey - y) + normal[n, 2] * (ez - z)
                        sight = math.sqrt((ex - x) ** 2 + (ey - y) ** 2 + (ez - z) ** 2)
                        if facing <= 0.0 or reach[na, nb, nc] + sight > limit:
                            continue
                        out[n] = is_visible(state, ex, ey, ez, x, y, z, TAIL)
    return out
