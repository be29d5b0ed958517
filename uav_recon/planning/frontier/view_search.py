"""Search for the best view of one frontier cluster; records the dependencies of the result.

Many positions are ranked by an upper bound (visibility_bound). Rays are cast from the best of them, and aborted when they
cannot show more than the best view found. Then the best few are moved step by step to positions that show more. The
dependencies allow the result to be cached until one of them changes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.rows import copy_row
from uav_recon.planning.camera_frustum import CAM_X, CAM_Y, aim, look_at, sight
from uav_recon.planning.free_space.subvoxel_clearance import CLEAR, SIDES2, blocking_voxel
from uav_recon.planning.frontier.camera_aiming import aimed, framed
from uav_recon.planning.frontier.visibility_bound import HASH_SIZE, Int32Array, Targets, cells_with, distinct, visibility_bound
from uav_recon.planning.frontier.visibility_rays import (
    Blockers,
    Scene,
    candidate_rays,
    confirm_visible,
    inside,
    note_sides,
    record_blocker,
    visible_cells,
)
from uav_recon.planning.view_sampling import ViewShell
from uav_recon.types.frames import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from uav_recon.types.maps import TILE

ENOUGH = 0.97  # share of the cells; a view that shows it ends the search
AT_ONCE = 8  # positions with a bound of ENOUGH cells from which rays are cast at once
CASTS = 64  # max. positions from which rays are cast, highest bound first
PEAKS = 4  # number of best positions, APART voxels from each other, that are moved ...
APART = 7.0
WORTH_MOVING = 0.6  # ... if they show this share of the best view ...
HOPS = (4.0, 2.0, 1.0, 0.2)  # ... by these distances in voxels, along an axis or a space diagonal ...
FROM_CENTRE_TO_CENTRE = 1.0  # ... a shorter hop ends off a voxel centre, where the clearance is tested ...
STEPS = 40  # ... until rays have been cast from this number of positions
SAME_EYE = 1e-6  # voxels
ROOM = 512  # max. positions tested while moving
_WAYS = np.array(
    [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if abs(i) + abs(j) + abs(k) in (1, 3)],
    dtype=np.int64,
)
Cluster = tuple[FloatArray, IntArray, Targets, FloatArray]  # points, first: see view_cache.targets(); targets; centre
# work arrays for facing, found (U,), order (N,) and directions (3, N)
WorkArrays = tuple[Int32Array, ByteArray, IntArray, Float32Array]
Dependencies = tuple[Int32Array, FloatArray, Blockers]  # asked, extents and notes: the dependencies of the result


class SearchScene(NamedTuple):
    """The map and the space that a search reads, and the camera.

    distance2: (nx * ny * nz,) as in VoxelMap. shape: of the map. reachable: raveled, padded by one voxel on all sides. berth:
    (7,) clearance box of the space. lens: see camera_frustum.
    """

    distance2: ByteArray
    shape: tuple[int, int, int]
    reachable: ByteArray
    berth: FloatArray
    lens: FloatArray


@kernel
def _widen(extent: FloatArray, x: float, y: float) -> None:
    """Extend a box (low x, low y, high x, high y) to a point."""
    extent[0], extent[1] = min(extent[0], x), min(extent[1], y)
    extent[2], extent[3] = max(extent[2], x), max(extent[3], y)


@kernel
def _test_reachable(
    reachable: ByteArray, shape: tuple[int, int, int], x: float, y: float, z: float, record: Dependencies, asks: int
) -> tuple[bool, int]:
    """Return whether a position is in the map and reachable, and the number of positions tested.

    The position is recorded as a dependency.
    """
    asked, extents, _ = record
    if x < 0.0 or y < 0.0 or z < 0.0 or x >= shape[0] or y >= shape[1] or z >= shape[2]:
        return False, asks
    at = ((int(x) + 1) * (shape[1] + 2) + int(y) + 1) * (shape[2] + 2) + int(z) + 1
    within = reachable[np.uint64(at)] != 0
    asked[asks] = at if within else ~at
    _widen(extents[1], x, y)
    return within, asks + 1


@kernel
def _look(  # noqa: PLR0911
    scene: Scene,
    cluster: Cluster,
    place: FloatArray,
    best: int,
    beat: int,
    work: WorkArrays,
    record: Dependencies,
    view: FloatArray,
    count: int,
) -> tuple[int, int, int]:
    """Cast rays from a position to the cells of a cluster.

    Returns the cells shown, the number of blockers, and 1 if rays were cast, else 0. The heading that shows most becomes
    the view. The number of cells is 0 if it does not exceed ``beat``. No ray is cast if the position could not show more
    than ``best`` even without obstacles.
    """
    _, shape, lens = scene
    _, _, targets, centre = cluster
    facing, found, order, ways = work
    _, extents, notes = record
    x, y, z = place
    line = look_at(lens, x, y, z, centre[0], centre[1], centre[2])
    if not inside(shape, line):
        return 0, count, 0
    visibility_bound(targets, lens, line, facing)
    fitting, centred = cells_with(targets, facing)
    if fitting <= best:
        return 0, count, 0
    yaw, pitch = aim(lens, x, y, z, centre[0], centre[1], centre[2])
    if centred <= best:
        most, yaw, pitch = aimed(lens, ways, candidate_rays(targets, line, facing, ways), yaw, pitch)
        if most <= best:
            return 0, count, 0
    _widen(extents[0], x, y)
    visible, count = visible_cells(scene, targets, line, facing, fitting, beat, order, found, ways, notes, count)
    if visible <= beat:
        return 0, count, 1
    total, yaw, pitch = aimed(lens, ways, visible, yaw, pitch)
    if total <= beat:
        return 0, count, 1
    turned = sight(lens, place, yaw, pitch)
    if (turned[0] - line[0]) ** 2 + (turned[1] - line[1]) ** 2 > SAME_EYE * SAME_EYE:
        # the camera is off the body's axis, so it moved with the heading
        if not inside(shape, turned):
            return 0, count, 1
        visibility_bound(targets, lens, turned, facing)
        visible, count = visible_cells(
            scene, targets, turned, facing, cells_with(targets, facing)[0], beat, order, found, ways, notes, count
        )
        total = framed(lens, ways, visible, yaw, pitch)
    if total <= beat:
        return 0, count, 1
    view[0], view[1], view[2], view[3], view[4] = x, y, z, yaw, pitch
    return total, count, 1


@kernel
def _tiles(extent: FloatArray, beside: float, shape: tuple[int, int, int], box: IntArray) -> None:
    """Write the first and last tile (i, j, i, j) of a box with a margin ``beside`` on all sides."""
    box[0], box[1] = int(max(extent[0] - beside, 0.0)) // TILE, int(max(extent[1] - beside, 0.0)) // TILE
    box[2], box[3] = int(min(extent[2] + beside, shape[0] - 1.0)) // TILE, int(min(extent[3] + beside, shape[1] - 1.0)) // TILE


@kernel
def _survey(
    scene: Scene,
    reachable: ByteArray,
    shell: ViewShell,
    cluster: Cluster,
    work: WorkArrays,
    record: Dependencies,
    places: FloatArray,
    promises: IntArray,
    view: FloatArray,
) -> tuple[int, int, int, int, int]:
    """Rank the positions of the shell by their upper bound, until one shows ENOUGH cells.

    Fills places (P, 3) and promises (P,). Returns their number, the cells shown, and the numbers of positions tested, of
    blockers and of positions with rays cast.
    """
    _, shape, lens = scene
    offsets, ends, quotas = shell
    _, first, targets, centre = cluster
    cells = len(first) - 1
    zero = 0 * cells  # no literal: for that the kernels called below would be compiled once more
    count, asks, opened, best, cast = zero, zero, 0, zero, 0
    part, left, p = 0, quotas[0], 0
    while best < ENOUGH * cells and p < len(offsets):
        if p == ends[part] or left == 0:
            p = ends[part]
            part += 1
            left = quotas[part] if part < len(ends) else 0
            continue
        x, y, z = centre[0] + offsets[p, 0], centre[1] + offsets[p, 1], centre[2] + offsets[p, 2]
        p += 1
        within, asks = _test_reachable(reachable, shape, x, y, z, record, asks)
        if not within:
            continue
        left -= 1
        place = places[opened]
        place[0], place[1], place[2] = int(x) + 0.5, int(y) + 0.5, int(z) + 0.5
        line = look_at(lens, place[0], place[1], place[2], centre[0], centre[1], centre[2])
        turned, centred = visibility_bound(targets, lens, line, work[0])
        promises[opened] = turned + centred
        opened += 1
        if cast < AT_ONCE and 2 * centred >= cells and cells_with(targets, work[0])[1] >= ENOUGH * cells:
            promises[opened - 1] = 0
            total, count, _ = _look(scene, cluster, place, best, best, work, record, view, count)
            cast += 1
            best = max(best, total)
    return opened, best, asks, count, cast


@kernel
def _ranked(promises: IntArray, most: int) -> IntArray:
    """Return the indices of the positions, highest bound first, equal ones in their order.

    promises: bounds, 0 to ``most`` each.
    """
    starts = np.zeros(most + 2, dtype=np.int64)
    for promise in promises:
        starts[most - promise + 1] += 1
    for n in range(most):
        starts[n + 1] += starts[n]
    ranked = np.empty(len(promises), dtype=np.int64)
    for p in range(len(promises)):
        rank = most - promises[p]
        ranked[starts[rank]] = p
        starts[rank] += 1
    return ranked


@kernel
def _enter(view: FloatArray, total: int, peaks: FloatArray, totals: IntArray) -> None:
    """Insert a view into the peaks (P, 5), best first, if it shows more than another peak.

    The other peak is one within APART, else the last one; the view replaces it.
    """
    at = len(totals) - 1
    for q in range(len(totals)):
        x, y, z = peaks[q, 0] - view[0], peaks[q, 1] - view[1], peaks[q, 2] - view[2]
        if totals[q] > 0 and x * x + y * y + z * z < APART * APART:
            at = q
            break
    if total <= totals[at]:
        return
    while at > 0 and total > totals[at - 1]:
        copy_row(peaks, at, peaks[at - 1])
        totals[at] = totals[at - 1]
        at -= 1
    copy_row(peaks, at, view)
    totals[at] = total


@kernel
def _climb(
    scene: Scene,
    reachable: ByteArray,
    berth: FloatArray,
    cluster: Cluster,
    work: WorkArrays,
    record: Dependencies,
    view: FloatArray,
    total: int,
    asks: int,
    count: int,
) -> tuple[int, int, int]:
    """Move a view to positions around it while one shows more.

    total: cells shown by the view. Returns the cells shown, positions tested and blockers at the end.
    """
    distance2, shape, _ = scene
    asked, extents, notes = record
    cells, beside = len(cluster[1]) - 1, math.sqrt(berth[SIDES2])
    hop, way, steps = 0, 0, 0
    while hop < len(HOPS) and steps < STEPS and total < ENOUGH * cells and asks < len(asked):
        if way == len(_WAYS):
            hop, way = hop + 1, 0
            continue
        place = view[:3] + HOPS[hop] * _WAYS[way]
        x, y, z = place
        way += 1
        within, asks = _test_reachable(reachable, shape, x, y, z, record, asks)
        if not within:
            continue
        if HOPS[hop] < FROM_CENTRE_TO_CENTRE:
            voxel = blocking_voxel(distance2, shape, berth, x, y, z)
            if voxel >= 0:
                count = record_blocker(voxel, notes, count)
            if voxel != CLEAR:
                continue
            _widen(extents[0], x - beside, y - beside)
            _widen(extents[0], x + beside, y + beside)
        shown, count, cast = _look(scene, cluster, place, total, total, work, record, view, count)
        steps += cast
        if shown > total:
            total, way = shown, 0
    return total, asks, count


@kernel
def best_view(  # noqa: C901
    space: SearchScene,
    shell: ViewShell,
    centre: FloatArray,
    points: FloatArray,
    first: IntArray,
    asked: Int32Array,
    blockers: Int32Array,
) -> tuple[FloatArray, BoolArray, int, int, IntArray]:
    """Find the view that shows most cells.

    The first view in the order of the shell that shows ENOUGH of the cells is returned at once.

    centre: (3,) centre of the cluster, voxels.
    points, first: see view_cache.targets(); fewer points than BOOK.
    asked: output, (K + ROOM,) for K offsets. Padded flat index of a tested position, or its complement if it was not
        reachable.
    blockers: output, fewer than BOOK. Voxels that blocked a ray, or were too near to a position.

    Returns the view (x, y, z, yaw, pitch down) in voxels and radians, and a mask of the cells it shows: none = no view.
    Then the dependencies of the result: the filled lengths of ``asked`` and ``blockers`` (a larger length than the array
    means too many blockers), and boxes (2, 4) with the first and last tile, i and j of each, of all lines and of all tested
    positions.
    """
    distance2, shape, reachable, berth, lens = space
    cells = len(first) - 1
    scene, notes = (distance2, shape, lens), (np.zeros(HASH_SIZE, dtype=np.int32), blockers)
    targets = distinct(distance2, shape, points, first)
    cluster = (points, first, targets, centre)
    many = len(targets[1])
    work = (
        np.zeros(many, dtype=np.int32), np.zeros(many, dtype=np.uint8), np.arange(cells), np.empty((3, cells), dtype=np.float32)
    )  # fmt: skip
    extents = np.empty((2, 4))  # of all line ends, and of all tested positions: low x, y, high x, y
    for which in range(2):
        for k in range(4):
            extents[which, k] = points[0, k % 2]
    for n in range(len(points)):
        _widen(extents[0], points[n, 0], points[n, 1])
    record = (asked, extents, notes)
    places, promises = np.empty((shell.places.sum(), 3)), np.zeros(shell.places.sum(), dtype=np.int64)
    peaks, totals, view = np.zeros((PEAKS, 5)), np.zeros(PEAKS, dtype=np.int64), np.zeros(5)
    opened, total, asks, count, cast = _survey(scene, reachable, shell, cluster, work, record, places, promises, view)
    if total > 0:
        _enter(view, total, peaks, totals)
    if totals[0] < ENOUGH * cells:
        for p in _ranked(promises[:opened], 2 * many):
            if cast == CASTS or promises[p] == 0 or totals[0] >= ENOUGH * cells:
                break
            beat = max(totals[-1], int(WORTH_MOVING * totals[0]))
            total, count, asking = _look(scene, cluster, places[p], totals[0], beat, work, record, view, count)
            cast += asking
            if total > 0:
                _enter(view, total, peaks, totals)
        for q in range(PEAKS):
            if totals[0] < ENOUGH * cells and totals[q] > WORTH_MOVING * totals[0]:
                totals[q], asks, count = _climb(
                    scene, reachable, berth, cluster, work, record, peaks[q], totals[q], asks, count
                )  # fmt: skip
    best = peaks[np.argmax(totals)]
    count = note_sides(shape, targets, notes, count)
    seen = np.zeros(cells, dtype=np.bool_)
    if totals.max() > 0:
        seen, count = confirm_visible(scene, best, points, first, notes, count)
    boxes = np.empty((2, 4), dtype=np.int64)
    _tiles(extents[0], abs(lens[CAM_X]) + abs(lens[CAM_Y]) + 1.0, shape, boxes[0])  # from a position to the ends of its lines
    _tiles(extents[1], 0.0, shape, boxes[1])
    return best, seen, asks, count, boxes
