"""The best view of one frontier cluster, and what that answer hangs on, so that it can be kept until that changes.

A cell counts as seen when one of its UNKNOWN neighbours is in the frustum, in range, and reached through known-free voxels
alone: that neighbour is what a look from there decides. Rays start there: most that are blocked are blocked at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.traversal import first_obstacle
from uav_recon.planning.camera import (
    CAM_X,
    CAM_Y,
    NEAR,
    PITCH_MAX,
    PITCH_MIN,
    RANGE,
    TAN_H,
    TAN_V,
    Sight,
    aim,
    in_view,
    look_at,
    sight,
)
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import TILE

Int32Array = NDArray[np.int32]
Scene = tuple[ByteArray, tuple[int, int, int], FloatArray]  # distance2 raveled, its shape, the lens
Notes = tuple[Int32Array, Int32Array]  # blockers: a hash table of them, and themselves in order

FIRST_PROBES = 4  # cells tried from every place ...
PROBES = 12  # ... so many from the most promising MORE_PLACES of them ...
MORE_PLACES = 12
FULL_PLACES = 5  # ... and all from the best of those, until a view shows this share of the cells ...
BOOK = 4096  # places in the hash table of blockers, a power of two
ENOUGH = 0.97  # ... and only a view that shows so much more than another beats it
TURNS = 24  # headings tried, all round ...
FINE_TURNS = 4  # ... and so many to either side of the best
NODS = 3  # pitches tried to either side ...
NOD_RAD = np.radians(10.0)  # ... so far apart
HOP = 4  # voxels to the places beside the best that are tried, then half of it, and so on
MOST_STEPS = 8  # such places
_WAYS = np.array(
    [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, 1, 0), (-1, -1, 0), (1, -1, 0), (-1, 1, 0)],
    dtype=np.int64,
)


@kernel
def _noted(voxel: int, notes: Notes, count: int) -> int:
    """Append a voxel to ``blockers`` unless it is there; ``book`` is a hash table of them. How many there are now."""
    book, blockers = notes
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
def _sees(scene: Scene, line: Sight, points: FloatArray, a: int, b: int, notes: Notes, count: int) -> tuple[bool, int]:
    """Tell whether a view shows one of points[a:b]; appends the voxels that hide them, once each, to ``blockers``."""
    distance2, shape, lens = scene
    for n in range(a, b):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if not in_view(lens, line, x, y, z):
            continue
        voxel = first_obstacle(distance2, shape[1], shape[2], x, y, z, line[0], line[1], line[2])
        if voxel < 0:
            return True, count
        count = _noted(voxel, notes, count)
    return False, count


@kernel
def _count(
    scene: Scene,
    view: FloatArray,
    points: FloatArray,
    first: IntArray,
    wanted: float,
    seen: BoolArray,
    notes: Notes,
    count: int,
) -> tuple[int, int]:
    """Fill ``seen`` with the cells that a view (x, y, z, yaw, pitch) shows; how many, and how many blockers there are now.

    Gives up once there can no longer be as many as ``wanted``.
    """
    _, shape, lens = scene
    line = sight(lens, view[:3], view[3], view[4])
    seen[:] = False
    if not _inside(shape, line):
        return 0, count
    shown = 0
    for n in range(len(seen)):
        if shown + len(seen) - n < wanted:
            break
        seen[n], count = _sees(scene, line, points, first[n], first[n + 1], notes, count)
        shown += seen[n]
    return shown, count


@kernel
def _turned(
    scene: Scene, view: FloatArray, points: FloatArray, first: IntArray, beat: int, seen: BoolArray, notes: Notes, count: int
) -> tuple[int, int]:
    """Turn a view to where it shows most cells, and fill ``seen``; how many, and how many blockers there are now.

    What hides a cell does not depend on the heading, so rays are asked once, and only headings then tried. Gives up, view and
    ``seen`` as they were, where it cannot show more than ``beat``: 0.
    """
    distance2, shape, lens = scene
    line = sight(lens, view[:3], view[3], view[4])
    if not _inside(shape, line):
        return 0, count
    cells = len(seen)
    clear = np.empty((cells, 3))  # from the eye to what of a cell can be seen
    visible = 0
    for n in range(cells):
        if visible + cells - n <= beat:
            return 0, count
        for m in range(first[n], first[n + 1]):
            x, y, z = points[m, 0], points[m, 1], points[m, 2]
            dx, dy, dz = x - line[0], y - line[1], z - line[2]
            distance = dx * dx + dy * dy + dz * dz
            if distance > lens[RANGE] * lens[RANGE] or distance < lens[NEAR] * lens[NEAR]:
                continue
            voxel = first_obstacle(distance2, shape[1], shape[2], x, y, z, line[0], line[1], line[2])
            if voxel < 0:
                clear[visible, 0], clear[visible, 1], clear[visible, 2] = dx, dy, dz
                visible += 1
                break
            count = _noted(voxel, notes, count)
    yaw, pitch, most = view[3], view[4], -1
    for turn in range(2):
        base = yaw
        for n in range(TURNS if turn == 0 else 2 * FINE_TURNS + 1):
            tried = base + (n * (2 * np.pi / TURNS) if turn == 0 else (n - FINE_TURNS) * (np.pi / TURNS / FINE_TURNS))
            shown = _framed(lens, clear[:visible], tried, pitch, most)
            if shown > most:
                most, yaw = shown, tried
        base = pitch
        if lens[PITCH_MAX] > lens[PITCH_MIN]:
            for n in range(-NODS, NODS + 1):
                tried = min(max(base + n * NOD_RAD / (1 + 3 * turn), lens[PITCH_MIN]), lens[PITCH_MAX])
                shown = _framed(lens, clear[:visible], yaw, tried, most)
                if shown > most:
                    most, pitch = shown, tried
    if most <= beat:
        return 0, count
    turned, shows = np.empty(5), np.empty(cells, dtype=np.bool_)
    turned[:3], turned[3], turned[4] = view[:3], np.arctan2(np.sin(yaw), np.cos(yaw)), pitch
    total, count = _count(scene, turned, points, first, beat + 1, shows, notes, count)
    if total <= beat:
        return 0, count
    view[:], seen[:] = turned, shows
    return total, count


@kernel
def _framed(lens: FloatArray, clear: FloatArray, yaw: float, pitch: float, beat: int) -> int:
    """How many of the directions (N, 3) lie inside the frustum; any number up to ``beat`` if not more than that."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    shown = 0
    for n in range(len(clear)):
        if shown + len(clear) - n <= beat:
            break
        along = cy * clear[n, 0] + sy * clear[n, 1]
        forward = cp * along - sp * clear[n, 2]
        left = cy * clear[n, 1] - sy * clear[n, 0]
        up = sp * along + cp * clear[n, 2]
        shown += forward > 0.0 and abs(left) <= forward * lens[TAN_H] and abs(up) <= forward * lens[TAN_V]
    return shown


@kernel
def _inside(shape: tuple[int, int, int], line: Sight) -> bool:
    return 0.0 <= line[0] < shape[0] and 0.0 <= line[1] < shape[1] and 0.0 <= line[2] < shape[2]


@kernel
def _ask(reachable: ByteArray, shape: tuple[int, int, int], x: float, y: float, z: float) -> int:
    """Padded flat index of a place inside the map, or its complement if it is not reachable."""
    at = ((int(x) + 1) * (shape[1] + 2) + int(y) + 1) * (shape[2] + 2) + int(z) + 1
    return at if reachable[np.uint64(at)] != 0 else ~at


@kernel
def _widen(extent: FloatArray, x: float, y: float) -> None:
    """Make a box (low x, low y, high x, high y) hold a point."""
    extent[0], extent[1] = min(extent[0], x), min(extent[1], y)
    extent[2], extent[3] = max(extent[2], x), max(extent[3], y)


@kernel
def _climb(
    scene: Scene,
    reachable: ByteArray,
    points: FloatArray,
    first: IntArray,
    total: int,
    best: FloatArray,
    best_seen: BoolArray,
    asked: Int32Array,
    asks: int,
    extent: FloatArray,
    notes: Notes,
    count: int,
) -> tuple[int, int]:
    """Move a view that shows ``total`` cells to places around it as long as one shows more, each with its best heading.

    Changes the view, what it shows, asked and extent; returns how many of asked and blockers there are now.
    """
    _, shape, _ = scene
    view, seen = np.empty(5), np.empty(len(best_seen), dtype=np.bool_)
    hop, way, steps = HOP, 0, 0
    while hop > 0 and steps < MOST_STEPS and asks < len(asked) and total < ENOUGH * len(seen):
        if way == len(_WAYS):
            hop, way = hop // 2, 0
            continue
        view[:] = best
        view[:3] += hop * _WAYS[way]
        x, y, z = view[:3]
        way += 1
        if x < 0.0 or y < 0.0 or z < 0.0 or x >= shape[0] or y >= shape[1] or z >= shape[2]:
            continue
        asked[asks] = _ask(reachable, shape, x, y, z)
        asks += 1
        if asked[asks - 1] < 0:
            continue
        _widen(extent, x, y)
        steps += 1
        shown, count = _turned(scene, view, points, first, total, seen, notes, count)
        if shown > total:
            total, way = shown, 0
            best[:], best_seen[:] = view, seen
    return asks, count


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
    scene: Scene, line: Sight, points: FloatArray, first: IntArray, probed: IntArray, notes: Notes, count: int
) -> tuple[int, int]:
    """How many of some cells a line of sight shows, and how many blockers there are now."""
    shown = 0
    for n in probed:
        sees, count = _sees(scene, line, points, first[n], first[n + 1], notes, count)
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
    scene, notes = (distance2, shape, lens), (np.zeros(BOOK, dtype=np.int32), blockers)
    best, best_total = np.zeros(5), 0
    best_seen, seen, view = np.zeros(cells, dtype=np.bool_), np.zeros(cells, dtype=np.bool_), np.empty(5)
    extent = np.array([points[0, 0], points[0, 1], points[0, 0], points[0, 1]])  # of all ends of lines: low x, y, high x, y
    for n in range(len(points)):
        _widen(extent, points[n, 0], points[n, 1])
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
                asked[asks] = _ask(reachable, shape, x, y, z)
                asks += 1
                if asked[asks - 1] < 0:
                    continue
                place = opened
                opened += 1
                left -= 1
                places[place, 0], places[place, 1], places[place, 2] = int(x) + 0.5, int(y) + 0.5, int(z) + 0.5
                _widen(extent, x, y)
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
                few[place], count = _probe(scene, line, points, first, probed[:firsts], notes, count)
            if step == 1 or (step == 0 and few[place] == firsts and tried < MORE_PLACES):
                tried += 1
                more[place], count = _probe(scene, line, points, first, probed[firsts:], notes, count)
                more[place] += few[place]
                few[place] = 0
            if step == 2 or more[place] == len(probed):
                counted += 1
                more[place] = 0
                view[0], view[1], view[2] = x, y, z
                view[3], view[4] = aim(lens, x, y, z, centre[0], centre[1], centre[2])
                if step < 2:
                    total, count = _count(scene, view, points, first, best_total / ENOUGH, seen, notes, count)
                else:
                    beat = int(best_total / ENOUGH)
                    total, count = _turned(scene, view, points, first, beat, seen, notes, count)
                if total > best_total / ENOUGH:
                    best_total = total
                    best[:], best_seen[:] = view, seen
    if 0 < best_total < ENOUGH * cells:
        total, count = _turned(scene, best, points, first, best_total, best_seen, notes, count)
        best_total = max(total, best_total)
        asks, count = _climb(
            scene, reachable, points, first, max(total, best_total), best, best_seen, asked, asks, extent,
            notes, count,
        )  # fmt: skip
    for n in range(cells):
        if best_seen[n]:
            best_seen[n], count = _confirmed(scene, best, points, first[n], first[n + 1], notes, count)
    beside = abs(lens[CAM_X]) + abs(lens[CAM_Y]) + 1.0  # from a place to its lines' ends
    box = np.empty(4, dtype=np.int64)
    box[0], box[1] = int(max(extent[0] - beside, 0.0)) // TILE, int(max(extent[1] - beside, 0.0)) // TILE
    box[2], box[3] = int(min(extent[2] + beside, nx - 1.0)) // TILE, int(min(extent[3] + beside, ny - 1.0)) // TILE
    return best, best_seen, asks, count, box


@kernel
def _confirmed(
    scene: Scene, view: FloatArray, points: FloatArray, a: int, b: int, notes: Notes, count: int
) -> tuple[bool, int]:
    """Ask as _sees(), in both directions: a line through an edge or a corner of voxels may pass in one of them alone."""
    distance2, shape, lens = scene
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
        count = _noted(voxel, notes, count)
    return False, count
