"""The widest path through a fine map: the one whose least clearance is greatest."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import LARGEST_DISTANCE_VOXELS, VoxelMap

MOST2 = LARGEST_DISTANCE_VOXELS**2


def widest_path(
    fine: VoxelMap, begin_world: FloatArray, end_world: FloatArray, near_m: float, heights_m: FloatArray
) -> tuple[FloatArray, float]:
    """Return the widest path (N, 3) in world between two positions, and its clearance.

    The clearance (m) is the least to voxel centres. Of the paths that are equally wide it is the one with the fewest steps. It
    begins and ends in a voxel at most ``near_m`` from these positions (3,). Without a path both are empty and 0. heights_m:
    (2,) range of z in world that it stays in.
    """
    grid = fine.grid
    low, high = np.clip(np.rint((heights_m - grid.origin_world_m[2]) / grid.resolution_m).astype(int), 0, grid.shape[2])
    part = np.ascontiguousarray(fine.distance2[:, :, low:high])
    part.setflags(write=False)
    ends = [(place - grid.origin_world_m) / grid.resolution_m - np.array([0.0, 0.0, low]) for place in (begin_world, end_world)]
    cells, width2 = _search(part, ends[0], ends[1], near_m / grid.resolution_m)
    index = np.stack(np.unravel_index(cells, part.shape), axis=-1) + np.array([0, 0, low])
    return grid.centre(index), math.sqrt(width2) * grid.resolution_m


def straightened(fine: VoxelMap, path_world: FloatArray, needed_m: float) -> FloatArray:
    """Return few waypoints (M, 3) of a path (N, 3) whose connections keep a clearance.

    needed_m: to voxel centres.
    """
    grid = fine.grid
    needed2, first, kept = (needed_m / grid.resolution_m) ** 2, 0, [0]
    while first < len(path_world) - 1:
        last = len(path_world) - 1
        while last > first + 1 and not _is_wide(fine, path_world[first], path_world[last], needed2):
            last -= 1
        kept.append(last)
        first = last
    return path_world[kept]


def _is_wide(fine: VoxelMap, begin_world: FloatArray, end_world: FloatArray, needed2: float) -> bool:
    """Return True if every voxel on a line has at least a squared distance."""
    steps = 2 + int(2.0 * np.linalg.norm(end_world - begin_world) / fine.grid.resolution_m)
    cells = fine.grid.index(np.linspace(begin_world, end_world, steps))
    return bool((fine.distance2[tuple(cells.T)] >= needed2).all())


@kernel
def _near(shape: tuple[int, int, int], place: FloatArray, near: float) -> IntArray:
    """Return the flat indices of the voxels with their centres near a place, in voxels."""
    nx, ny, nz = shape
    low = np.floor(place - near - 0.5).astype(np.int64)
    high = np.ceil(place + near + 0.5).astype(np.int64)
    found = np.empty(int(((high - low)[0]) * (high - low)[1] * (high - low)[2]), dtype=np.int64)
    count = 0
    for i in range(max(low[0], 0), min(high[0], nx)):
        for j in range(max(low[1], 0), min(high[1], ny)):
            for k in range(max(low[2], 0), min(high[2], nz)):
                x, y, z = i + 0.5 - place[0], j + 0.5 - place[1], k + 0.5 - place[2]
                if x * x + y * y + z * z <= near * near:
                    found[count] = (i * ny + j) * nz + k
                    count += 1
    return found[:count]


@kernel
def _search(distance2: ByteArray, begin: FloatArray, end: FloatArray, near: float) -> tuple[IntArray, int]:  # noqa: C901
    """Return the flat indices of the widest path and its least squared distance.

    The search takes the cells in buckets of that distance.
    """
    nx, ny, nz = distance2.shape
    flat = distance2.reshape(-1)
    goals = np.zeros(nx * ny * nz, dtype=np.uint8)
    for cell in _near(distance2.shape, end, near):
        goals[cell] = 1
    parent = np.full(nx * ny * nz, -2, dtype=np.int32)  # -2: not seen, -1: a start
    following = np.full(nx * ny * nz, -1, dtype=np.int32)  # linked lists of the buckets
    head, tail = np.full(MOST2 + 1, -1, dtype=np.int32), np.full(MOST2 + 1, -1, dtype=np.int32)
    for cell in _near(distance2.shape, begin, near):
        if flat[cell] > 0:
            parent[cell] = -1
            _append(head, tail, following, min(flat[cell], MOST2), cell)
    level = MOST2
    while level > 0:
        cell = head[level]
        if cell < 0:
            level -= 1
            continue
        head[level] = following[cell]
        following[cell] = -1
        if goals[cell]:
            length, at = 0, cell
            while at >= 0:
                length, at = length + 1, parent[at]
            path = np.empty(length, dtype=np.int64)
            at = cell
            for n in range(length - 1, -1, -1):
                path[n], at = at, parent[at]
            return path, level
        i, j, k = cell // (ny * nz), cell // nz % ny, cell % nz
        for a in range(max(i - 1, 0), min(i + 2, nx)):
            for b in range(max(j - 1, 0), min(j + 2, ny)):
                for c in range(max(k - 1, 0), min(k + 2, nz)):
                    to = (a * ny + b) * nz + c
                    if parent[to] == -2 and flat[to] > 0:
                        parent[to] = cell
                        _append(head, tail, following, min(flat[to], level), to)
    return np.empty(0, dtype=np.int64), 0


@kernel
def _append(head: AnyArray, tail: AnyArray, following: AnyArray, level: int, cell: int) -> None:
    """Append a cell to the list of a level."""
    if head[level] < 0:
        head[level] = cell
    else:
        following[tail[level]] = cell
    tail[level] = cell
