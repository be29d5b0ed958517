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
from uav_recon.planning.free_space.subvoxel_clearance import CLEAR, SIDES2, SLOPE, blocking_voxel
from uav_recon.planning.frontier.camera_aiming import best_aim, count_in_frustum
from uav_recon.planning.frontier.visibility_bound import (
    HASH_SIZE,
    Int32Array,
    Targets,
    cells_with,
    distinct_targets,
    visibility_bound,
)
from uav_recon.planning.frontier.visibility_rays import (
    Blockers,
    Scene,
    candidate_rays,
    confirm_visible,
    inside,
    record_blocker,
    record_side_blockers,
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
PEAK_SHARE = 0.6  # ... if they show this share of the best view ...
HOPS = (4.0, 2.0, 1.0, 0.2)  # ... by these distances in voxels, along an axis or a space diagonal ...
FROM_CENTRE_TO_CENTRE = 1.0  # ... a shorter hop ends off a voxel centre, where the clearance is tested ...
STEPS = 40  # ... until rays have been cast from this number of positions
SAME_EYE = 1e-6  # voxels
MAX_MOVE_TESTS = 512  # max. positions tested while moving
HOP_DIRECTIONS = np.array(
    [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if abs(i) + abs(j) + abs(k) in (1, 3)],
    dtype=np.int64,
)
Cluster = tuple[FloatArray, IntArray, Targets, FloatArray]  # points, first: see view_cache.targets(); targets; centre
# work arrays for facing, found (U,), order (N,) and directions (3, N)
WorkArrays = tuple[Int32Array, ByteArray, IntArray, Float32Array]
Dependencies = tuple[Int32Array, FloatArray, Blockers]  # tested_cells, extents and blockers: the dependencies of the result


class SearchScene(NamedTuple):
    """The map and the space that a search reads, and the camera.

    distance2: (nx * ny * nz,) as in VoxelMap. shape: of the map. reachable: raveled, padded by one voxel on all sides.
    clearance_box: (9,), of the space. lens: see camera_frustum.
    """

    distance2: ByteArray
    shape: tuple[int, int, int]
    reachable: ByteArray
    clearance_box: FloatArray
    lens: FloatArray


@kernel
def _widen(extent: FloatArray, x: float, y: float) -> None:
    """Extend a box (low x, low y, high x, high y) to a point."""
    extent[0], extent[1] = min(extent[0], x), min(extent[1], y)
    extent[2], extent[3] = max(extent[2], x), max(extent[3], y)


@kernel
def _test_reachable(
    reachable: ByteArray, shape: tuple[int, int, int], x: float, y: float, z: float, record: Dependencies, tested: int
) -> tuple[bool, int]:
    """Return whether a position is in the map and reachable, and the number of positions tested.

    The position is recorded as a dependency.
    """
    tested_cells, extents, _ = record
    if x < 0.0 or y < 0.0 or z < 0.0 or x >= shape[0] or y >= shape[1] or z >= shape[2]:
        return False, tested
    at = ((int(x) + 1) * (shape[1] + 2) + int(y) + 1) * (shape[2] + 2) + int(z) + 1
    within = reachable[np.uint64(at)] != 0
    tested_cells[tested] = at if within else ~at
    _widen(extents[1], x, y)
    return within, tested + 1


@kernel
def _cast_rays_from(  # noqa: PLR0911
    scene: Scene,
    cluster: Cluster,
    place: FloatArray,
    best: int,
    to_exceed: int,
    work: WorkArrays,
    record: Dependencies,
    view: FloatArray,
    count: int,
) -> tuple[int, int, int]:
    """Cast rays from a position to the cells of a cluster.

    Returns the cells shown, the number of blockers, and 1 if rays were cast, else 0. The heading that shows most becomes
    the view. The number of cells is 0 if it does not exceed ``to_exceed``. No ray is cast if the position could not show more
    than ``best`` even without obstacles.
    """
    _, shape, lens, _ = scene
    _, _, targets, centre = cluster
    facing, found, order, directions = work
    _, extents, blockers = record
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
        most, yaw, pitch = best_aim(lens, directions, candidate_rays(targets, line, facing, directions), yaw, pitch)
        if most <= best:
            return 0, count, 0
    _widen(extents[0], x, y)
    visible, count = visible_cells(scene, targets, line, facing, fitting, to_exceed, order, found, directions, blockers, count)
    if visible <= to_exceed:
        return 0, count, 1
    total, yaw, pitch = best_aim(lens, directions, visible, yaw, pitch)
    if total <= to_exceed:
        return 0, count, 1
    turned = sight(lens, place, yaw, pitch)
    if (turned[0] - line[0]) ** 2 + (turned[1] - line[1]) ** 2 > SAME_EYE * SAME_EYE:
        # the camera is off the body's axis, so it moved with the heading
        if not inside(shape, turned):
            return 0, count, 1
        visibility_bound(targets, lens, turned, facing)
        visible, count = visible_cells(
            scene, targets, turned, facing, cells_with(targets, facing)[0], to_exceed, order, found, directions, blockers, count
        )
        total = count_in_frustum(lens, directions, visible, yaw, pitch)
    if total <= to_exceed:
        return 0, count, 1
    view[0], view[1], view[2], view[3], view[4] = x, y, z, yaw, pitch
    return total, count, 1


@kernel
def _tiles(extent: FloatArray, margin: float, shape: tuple[int, int, int], box: IntArray) -> None:
    """Write the first and last tile (i, j, i, j) of a box with a margin on all sides."""
    box[0], box[1] = int(max(extent[0] - margin, 0.0)) // TILE, int(max(extent[1] - margin, 0.0)) // TILE
    box[2], box[3] = int(min(extent[2] + margin, shape[0] - 1.0)) // TILE, int(min(extent[3] + margin, shape[1] - 1.0)) // TILE


@kernel
def _rank_shell(
    scene: Scene,
    reachable: ByteArray,
    shell: ViewShell,
    cluster: Cluster,
    work: WorkArrays,
    record: Dependencies,
    places: FloatArray,
    bounds: IntArray,
    view: FloatArray,
) -> tuple[int, int, int, int, int]:
    """Rank the positions of the shell by their upper bound, until one shows ENOUGH cells.

    Fills places (P, 3) and bounds (P,). Returns their number, the cells shown, and the numbers of positions tested, of
    blockers and of positions with rays cast.
    """
    _, shape, lens, _ = scene
    offsets, ends, quotas = shell
    _, first, targets, centre = cluster
    cells = len(first) - 1
    zero = 0 * cells  # no literal: for that the kernels called below would be compiled once more
    count, tested, reachable_count, best, cast = zero, zero, 0, zero, 0
    part, left, p = 0, quotas[0], 0
    while best < ENOUGH * cells and p < len(offsets):
        if p == ends[part] or left == 0:
            p = ends[part]
            part += 1
            left = quotas[part] if part < len(ends) else 0
            continue
        x, y, z = centre[0] + offsets[p, 0], centre[1] + offsets[p, 1], centre[2] + offsets[p, 2]
        p += 1
        within, tested = _test_reachable(reachable, shape, x, y, z, record, tested)
        if not within:
            continue
        left -= 1
        place = places[reachable_count]
        place[0], place[1], place[2] = int(x) + 0.5, int(y) + 0.5, int(z) + 0.5
        line = look_at(lens, place[0], place[1], place[2], centre[0], centre[1], centre[2])
        turned, centred = visibility_bound(targets, lens, line, work[0])
        bounds[reachable_count] = turned + centred
        reachable_count += 1
        if cast < AT_ONCE and 2 * centred >= cells and cells_with(targets, work[0])[1] >= ENOUGH * cells:
            bounds[reachable_count - 1] = 0
            total, count, _ = _cast_rays_from(scene, cluster, place, best, best, work, record, view, count)
            cast += 1
            best = max(best, total)
    return reachable_count, best, tested, count, cast


@kernel
def _ranked(bounds: IntArray, most: int) -> IntArray:
    """Return the indices of the positions, highest bound first, equal ones in their order.

    bounds: 0 to ``most`` each.
    """
    starts = np.zeros(most + 2, dtype=np.int64)
    for bound in bounds:
        starts[most - bound + 1] += 1
    for n in range(most):
        starts[n + 1] += starts[n]
    ranked = np.empty(len(bounds), dtype=np.int64)
    for p in range(len(bounds)):
        rank = most - bounds[p]
        ranked[starts[rank]] = p
        starts[rank] += 1
    return ranked


@kernel
def _insert_peak(view: FloatArray, total: int, peaks: FloatArray, totals: IntArray) -> None:
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
def _hill_climb(
    scene: Scene,
    reachable: ByteArray,
    clearance_box: FloatArray,
    cluster: Cluster,
    work: WorkArrays,
    record: Dependencies,
    view: FloatArray,
    total: int,
    tested: int,
    count: int,
) -> tuple[int, int, int]:
    """Move a view to positions around it while one shows more.

    total: cells shown by the view. Returns the cells shown, positions tested and blockers at the end.
    """
    distance2, shape, _, _ = scene
    tested_cells, extents, blockers = record
    cells, margin = len(cluster[1]) - 1, math.sqrt(clearance_box[SIDES2])
    hop, direction, steps = 0, 0, 0
    while hop < len(HOPS) and steps < STEPS and total < ENOUGH * cells and tested < len(tested_cells):
        if direction == len(HOP_DIRECTIONS):
            hop, direction = hop + 1, 0
            continue
        place = view[:3] + HOPS[hop] * HOP_DIRECTIONS[direction]
        x, y, z = place
        direction += 1
        within, tested = _test_reachable(reachable, shape, x, y, z, record, tested)
        if not within:
            continue
        if HOPS[hop] < FROM_CENTRE_TO_CENTRE:
            voxel = blocking_voxel(distance2, shape, clearance_box, x, y, z)
            if voxel >= 0:
                count = record_blocker(voxel, blockers, count)
            if voxel != CLEAR:
                continue
            _widen(extents[0], x - margin, y - margin)
            _widen(extents[0], x + margin, y + margin)
        shown, count, cast = _cast_rays_from(scene, cluster, place, total, total, work, record, view, count)
        steps += cast
        if shown > total:
            total, direction = shown, 0
    return total, tested, count


@kernel
def best_view(  # noqa: C901
    space: SearchScene,
    shell: ViewShell,
    centre: FloatArray,
    points: FloatArray,
    first: IntArray,
    tested_cells: Int32Array,
    blockers: Int32Array,
) -> tuple[FloatArray, BoolArray, int, int, IntArray]:
    """Find the view that shows most cells.

    The first view in the order of the shell that shows ENOUGH of the cells is returned at once.

    centre: (3,) centre of the cluster, voxels.
    points, first: see view_cache.targets(); fewer points than HASH_SIZE.
    tested_cells: output, (K + MAX_MOVE_TESTS,) for K offsets. Padded flat index of a tested position, or its complement if it
        was not reachable.
    blockers: output, fewer than HASH_SIZE. Voxels that blocked a ray, or were too near to a position.

    Returns the view (x, y, z, yaw, pitch down) in voxels and radians, and a mask of the cells it shows: none = no view.
    Then the dependencies of the result: the filled lengths of ``tested_cells`` and ``blockers`` (a larger length than the array
    means too many blockers), and boxes (2, 4) with the first and last tile, i and j of each, of all lines and of all tested
    positions.
    """
    distance2, shape, reachable, clearance_box, lens = space
    cells = len(first) - 1
    scene, blocker_record = (
        (distance2, shape, lens, clearance_box[SLOPE] ** 2),
        (np.zeros(HASH_SIZE, dtype=np.int32), blockers),
    )
    targets = distinct_targets(distance2, shape, points, first)
    cluster = (points, first, targets, centre)
    target_count = len(targets[1])
    work = (
        np.zeros(target_count, dtype=np.int32), np.zeros(target_count, dtype=np.uint8), np.arange(cells),
        np.empty((3, cells), dtype=np.float32)
    )  # fmt: skip
    extents = np.empty((2, 4))  # of all line ends, and of all tested positions: low x, y, high x, y
    for which in range(2):
        for k in range(4):
            extents[which, k] = points[0, k % 2]
    for n in range(len(points)):
        _widen(extents[0], points[n, 0], points[n, 1])
    record = (tested_cells, extents, blocker_record)
    places, bounds = np.empty((shell.places.sum(), 3)), np.zeros(shell.places.sum(), dtype=np.int64)
    peaks, totals, view = np.zeros((PEAKS, 5)), np.zeros(PEAKS, dtype=np.int64), np.zeros(5)
    reachable_count, total, tested, count, cast = _rank_shell(
        scene, reachable, shell, cluster, work, record, places, bounds, view
    )
    if total > 0:
        _insert_peak(view, total, peaks, totals)
    if totals[0] < ENOUGH * cells:
        for p in _ranked(bounds[:reachable_count], 2 * target_count):
            if cast == CASTS or bounds[p] == 0 or totals[0] >= ENOUGH * cells:
                break
            to_exceed = max(totals[-1], int(PEAK_SHARE * totals[0]))
            total, count, was_cast = _cast_rays_from(scene, cluster, places[p], totals[0], to_exceed, work, record, view, count)
            cast += was_cast
            if total > 0:
                _insert_peak(view, total, peaks, totals)
        for q in range(PEAKS):
            if totals[0] < ENOUGH * cells and totals[q] > PEAK_SHARE * totals[0]:
                totals[q], tested, count = _hill_climb(
                    scene, reachable, clearance_box, cluster, work, record, peaks[q], totals[q], tested, count
                )  # fmt: skip
    best = peaks[np.argmax(totals)]
    count = record_side_blockers(shape, targets, blocker_record, count)
    seen = np.zeros(cells, dtype=np.bool_)
    if totals.max() > 0:
        seen, count = confirm_visible(scene, best, points, first, blocker_record, count)
    boxes = np.empty((2, 4), dtype=np.int64)
    _tiles(extents[0], abs(lens[CAM_X]) + abs(lens[CAM_Y]) + 1.0, shape, boxes[0])  # from a position to the ends of its lines
    _tiles(extents[1], 0.0, shape, boxes[1])
    return best, seen, tested, count, boxes
