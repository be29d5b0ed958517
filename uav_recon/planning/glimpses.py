"""The best view of one frontier cluster, and what that answer hangs on, so that it can be kept until that changes.

A cell counts as seen when one of its UNKNOWN neighbours is in the frustum, in range, and reached through known-free voxels
alone: that neighbour is what a look from there decides. Rays start there: most that are blocked are blocked at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.traversal import first_obstacle
from uav_recon.planning.camera import CAM_X, CAM_Y, CAM_Z, PITCH_MAX, PITCH_MIN, Sight, aim, in_view, look_at, sight
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import TILE

Int32Array = NDArray[np.int32]

FIRST_PROBES = 4  # cells tried from every place ...
PROBES = 12  # ... so many from the most promising MORE_PLACES of them ...
MORE_PLACES = 12
FULL_PLACES = 5  # ... and all from the best of those, until a view shows this share of the cells ...
BOOK = 4096  # places in the hash table of blockers, a power of two
ENOUGH = 0.97  # ... and only a view that shows so much more than another beats it


@kernel
def targets(faces: ByteArray, flat: IntArray) -> tuple[FloatArray, IntArray]:
    """Centres (M, 3), voxels, of the unknown neighbours of cells (N,) given by flat index; where each cell's begin (N + 1,)."""
    _, ny, nz = faces.shape
    points = np.empty((6 * len(flat), 3))
    first = np.zeros(len(flat) + 1, dtype=np.int64)
    count = 0
    for n in range(len(flat)):
        i, j, k = flat[n] // (ny * nz), flat[n] // nz % ny, flat[n] % nz
        bits = int(faces[i, j, k])
        for face in range(6):
            if bits & (1 << face):
                step = 1.0 if face & 1 else -1.0
                points[count, 0] = i + 0.5 + (step if face < 2 else 0.0)
                points[count, 1] = j + 0.5 + (step if 2 <= face < 4 else 0.0)
                points[count, 2] = k + 0.5 + (step if face >= 4 else 0.0)
                count += 1
        first[n + 1] = count
    return points[:count].copy(), first


@kernel
def _noted(voxel: int, book: Int32Array, blockers: Int32Array, count: int) -> int:
    """Append a voxel to ``blockers`` unless it is there; ``book`` is a hash table of them. How many there are now."""
    at = (voxel * 2654435761 >> 16) & (BOOK - 1)
    while book[np.uint64(at)] != 0:
        if book[np.uint64(at)] == voxel + 1:
            return count
        at = (at + 1) & (BOOK - 1)
    if count < len(blockers):
        book[np.uint64(at)] = voxel + 1
        blockers[count] = voxel
    return count + 1


@kernel
def _sees(
    distance2: ByteArray,
    shape: tuple[int, int, int],
    lens: FloatArray,
    line: Sight,
    points: FloatArray,
    a: int,
    b: int,
    book: Int32Array,
    blockers: Int32Array,
    count: int,
) -> tuple[bool, int]:
    """Tell whether a view shows one of points[a:b]; appends the voxels that hide them, once each, to ``blockers``."""
    for n in range(a, b):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if not in_view(lens, line, x, y, z):
            continue
        voxel = first_obstacle(distance2, shape[1], shape[2], x, y, z, line[0], line[1], line[2])
        if voxel < 0:
            return True, count
        count = _noted(voxel, book, blockers, count)
    return False, count


@kernel
def _count(
    distance2: ByteArray,
    shape: tuple[int, int, int],
    lens: FloatArray,
    view: FloatArray,
    points: FloatArray,
    first: IntArray,
    wanted: float,
    seen: BoolArray,
    book: Int32Array,
    blockers: Int32Array,
    count: int,
) -> tuple[int, int]:
    """Fill ``seen`` with the cells that a view (x, y, z, yaw, pitch) shows; how many, and how many blockers there are now.

    Gives up once there can no longer be as many as ``wanted``.
    """
    line = sight(lens, view[:3], view[3], view[4])
    seen[:] = False
    if not _inside(shape, line):
        return 0, count
    shown = 0
    for n in range(len(seen)):
        if shown + len(seen) - n < wanted:
            break
        seen[n], count = _sees(distance2, shape, lens, line, points, first[n], first[n + 1], book, blockers, count)
        shown += seen[n]
    return shown, count


@kernel
def _centred(lens: FloatArray, view: FloatArray, points: FloatArray, first: IntArray, seen: BoolArray) -> None:
    """Turn a view so that the cells it shows are in its middle: means of directions, as angles have no mean of their own."""
    east, north, flat, down = 0.0, 0.0, 0.0, 0.0
    for n in range(len(seen)):
        if seen[n]:
            point = points[first[n]]
            dx, dy, dz = point[0] - view[0], point[1] - view[1], view[2] + lens[CAM_Z] - point[2]
            across = np.sqrt(dx * dx + dy * dy)
            length = np.sqrt(across * across + dz * dz)
            east += dx / max(across, 1e-9)
            north += dy / max(across, 1e-9)
            flat += across / length
            down += dz / length
    view[3] = np.arctan2(north, east)
    view[4] = min(max(np.arctan2(down, flat), lens[PITCH_MIN]), lens[PITCH_MAX])


@kernel
def _inside(shape: tuple[int, int, int], line: Sight) -> bool:
    return 0.0 <= line[0] < shape[0] and 0.0 <= line[1] < shape[1] and 0.0 <= line[2] < shape[2]


@kernel
def _probed(cells: int) -> IntArray:
    """Numbers of the cells to be tried, spread over the cluster; any first few of them are so, too."""
    probes = min(cells, PROBES)
    probed = np.empty(probes, dtype=np.int64)
    for n in range(probes):
        probed[n] = (2 * (n * 5 % 12 if probes == 12 else n) + 1) * cells // (2 * probes)
    return probed


@kernel
def _probe(
    distance2: ByteArray,
    shape: tuple[int, int, int],
    lens: FloatArray,
    line: Sight,
    points: FloatArray,
    first: IntArray,
    probed: IntArray,
    book: Int32Array,
    blockers: Int32Array,
    count: int,
) -> tuple[int, int]:
    """How many of some cells a line of sight shows, and how many blockers there are now."""
    shown = 0
    for n in probed:
        sees, count = _sees(distance2, shape, lens, line, points, first[n], first[n + 1], book, blockers, count)
        shown += sees
    return shown, count


@kernel
def best_view(
    distance2: ByteArray,
    shape: tuple[int, int, int],
    reachable: ByteArray,
    lens: FloatArray,
    offsets: FloatArray,
    ends: IntArray,
    quotas: IntArray,
    centre: FloatArray,
    points: FloatArray,
    first: IntArray,
    asked: Int32Array,
    blockers: Int32Array,
) -> tuple[FloatArray, BoolArray, int, int, IntArray]:
    """Find the view that shows most cells; of those that show nearly as many, the one whose place comes first in the shell.

    distance2: raveled, as in VoxelMap; reachable: raveled, padded by one voxel all round. asked (K,), blockers (fewer than
    BOOK): room.
    Returns the view (x, y, z, yaw, pitch down), voxels and radians, and which cells it shows: none = no view. Then what the
    answer hangs on: how many of ``asked`` (padded flat index of a place, or its complement if it was not reachable) and of
    ``blockers`` (voxels that hid something; more than there is room for: too many to tell) were filled, and the first and
    last tile, (4,) i and j of each, of the box that all lines lie in.
    """
    nx, ny, nz = shape
    cells = len(first) - 1
    probed = _probed(cells)
    firsts = min(FIRST_PROBES, len(probed))
    places = np.empty((quotas.sum(), 3))  # those that can be reached
    few, more = np.zeros(len(places), dtype=np.int64), np.zeros(len(places), dtype=np.int64)  # probes shown, by place
    asks, opened, count, tried, counted = 0, 0, 0, 0, 0
    part, left = 0, quotas[0]
    book = np.zeros(BOOK, dtype=np.int32)
    best, best_total = np.zeros(5), 0
    best_seen, seen, view = np.zeros(cells, dtype=np.bool_), np.zeros(cells, dtype=np.bool_), np.empty(5)
    low_x, low_y, high_x, high_y = points[0, 0], points[0, 1], points[0, 0], points[0, 1]
    for n in range(len(points)):
        low_x, high_x = min(low_x, points[n, 0]), max(high_x, points[n, 0])
        low_y, high_y = min(low_y, points[n, 1]), max(high_y, points[n, 1])
    # A place that shows all it was asked for goes on at once: no later one can come before it. The others wait their turn.
    for step in range(3):
        share, p = (firsts if step < 2 else len(probed)), 0
        while share > 0 and best_total < ENOUGH * cells and counted < FULL_PLACES:
            if p == (opened if step else len(offsets)):
                share, p = (share - 1 if step else 0), 0
                continue
            if step == 0:
                if p == ends[part] or left == 0:
                    p = ends[part]
                    part += 1
                    left = quotas[part] if part < len(ends) else 0
                    continue
                x, y, z = centre[0] + offsets[p, 0], centre[1] + offsets[p, 1], centre[2] + offsets[p, 2]
                p += 1
                if x < 0.0 or y < 0.0 or z < 0.0 or x >= nx or y >= ny or z >= nz:
                    continue
                at = ((int(x) + 1) * (ny + 2) + int(y) + 1) * (nz + 2) + int(z) + 1
                open_here = reachable[np.uint64(at)] != 0
                asked[asks] = at if open_here else ~at
                asks += 1
                if not open_here:
                    continue
                place = opened
                opened += 1
                left -= 1
                places[place, 0], places[place, 1], places[place, 2] = int(x) + 0.5, int(y) + 0.5, int(z) + 0.5
                low_x, high_x = min(low_x, x), max(high_x, x)
                low_y, high_y = min(low_y, y), max(high_y, y)
            else:
                place = p
                p += 1
                if (more[place] if step == 2 else few[place]) != share or (step == 1 and tried == MORE_PLACES):
                    continue
            x, y, z = places[place]
            line = look_at(lens, x, y, z, centre[0], centre[1], centre[2])
            if not _inside(shape, line):
                continue
            if step == 0:
                few[place], count = _probe(distance2, shape, lens, line, points, first, probed[:firsts], book, blockers, count)
            if step == 1 or (step == 0 and few[place] == firsts and tried < MORE_PLACES):
                tried += 1
                more[place], count = _probe(distance2, shape, lens, line, points, first, probed[firsts:], book, blockers, count)
                more[place] += few[place]
                few[place] = 0
            if step == 2 or more[place] == len(probed):
                counted += 1
                more[place] = 0
                view[0], view[1], view[2] = x, y, z
                view[3], view[4] = aim(lens, x, y, z, centre[0], centre[1], centre[2])
                total, count = _count(
                    distance2, shape, lens, view, points, first, best_total / ENOUGH, seen, book, blockers, count
                )
                if total > best_total / ENOUGH:
                    best_total = total
                    best[:], best_seen[:] = view, seen
    if 0 < best_total < cells:
        view[:] = best
        _centred(lens, view, points, first, best_seen)
        total, count = _count(distance2, shape, lens, view, points, first, best_total + 1, seen, book, blockers, count)
        if total > best_total:
            best[:], best_seen[:] = view, seen
    for n in range(cells):
        if best_seen[n]:
            best_seen[n], count = _confirmed(
                distance2, shape, lens, best, points, first[n], first[n + 1], book, blockers, count
            )
    beside = abs(lens[CAM_X]) + abs(lens[CAM_Y]) + 1.0  # from a place to its lines' ends
    box = np.empty(4, dtype=np.int64)
    box[0], box[1] = int(max(low_x - beside, 0.0)) // TILE, int(max(low_y - beside, 0.0)) // TILE
    box[2], box[3] = int(min(high_x + beside, nx - 1.0)) // TILE, int(min(high_y + beside, ny - 1.0)) // TILE
    return best, best_seen, asks, count, box


@kernel
def _confirmed(
    distance2: ByteArray,
    shape: tuple[int, int, int],
    lens: FloatArray,
    view: FloatArray,
    points: FloatArray,
    a: int,
    b: int,
    book: Int32Array,
    blockers: Int32Array,
    count: int,
) -> tuple[bool, int]:
    """Ask as _sees(), in both directions: a line through an edge or a corner of voxels may pass in one of them alone."""
    line = sight(lens, view[:3], view[3], view[4])
    for n in range(a, b):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if not in_view(lens, line, x, y, z):
            continue
        if first_obstacle(distance2, shape[1], shape[2], x, y, z, line[0], line[1], line[2]) >= 0:
            continue
        voxel = first_obstacle(distance2, shape[1], shape[2], line[0], line[1], line[2], x, y, z)
        if voxel < 0 or voxel == (int(x) * shape[1] + int(y)) * shape[2] + int(z):
            return True, count
        count = _noted(voxel, book, blockers, count)
    return False, count
