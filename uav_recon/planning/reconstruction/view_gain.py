"""View gain: the sum of |n.v| sigma over the visible surface, and the best-view search.

Paper, Algorithm 1. All candidates are ranked by patches, which represent the elements of a cell. The best few are ranked by
the elements, with one line of sight per cell. The best of those are evaluated in full. Positions are in voxel units.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.traversal import is_visible
from uav_recon.planning.camera_frustum import RANGE, TAN_H, TAN_V, LineOfSight, aim, in_view, sight
from uav_recon.types.frames import ByteArray, FloatArray, IntArray

TAIL = 1.5  # voxels in front of an element that may be occupied or unknown, because they belong to the element's own wall
MIN_FACING = 0.18  # n.v; at a smaller angle to the surface, about 10 degrees, a depth camera measures nothing
PATCH_SHARE = 0.95  # share of the weight in reach; the many cells of the rest are ignored
_CELL_WIDTH = 5.2  # voxels; the diagonal of a cell, the max. distance of an element from its middle element


@kernel
def _facing(line: LineOfSight, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Return n.v, the cosine between an outward normal and the direction to the eye.

    It is 0 for an element seen from behind, or at too small an angle.
    """
    dx, dy, dz = line[0] - x, line[1] - y, line[2] - z
    cosine = (nx * dx + ny * dy + nz * dz) / math.sqrt(dx * dx + dy * dy + dz * dz)
    return cosine if cosine >= MIN_FACING else 0.0


@kernel
def patches_near(
    centre: FloatArray,
    radius: float,
    position: FloatArray,
    normal: FloatArray,
    weight: FloatArray,
    cells: IntArray,
) -> FloatArray:
    """Return one row per cell within ``radius``, heaviest first.

    Rows are added until they have PATCH_SHARE of the weight. (M, 7): position and normal of the cell's middle element, and
    the weight of all its elements.
    """
    rows = np.empty((len(cells), 7))
    count = 0
    for c in range(len(cells)):
        m = cells[c, 2]
        dx, dy, dz = position[m, 0] - centre[0], position[m, 1] - centre[1], position[m, 2] - centre[2]
        if dx * dx + dy * dy + dz * dz > radius * radius:
            continue
        total = 0.0
        for n in range(cells[c, 0], cells[c, 1]):
            total += weight[n]
        if total > 0.0:
            for k in range(3):
                rows[count, k], rows[count, 3 + k] = position[m, k], normal[m, k]
            rows[count, 6] = total
            count += 1
    order = np.argsort(-rows[:count, 6], kind="mergesort")
    wanted = PATCH_SHARE * rows[:count, 6].sum()
    taken, total = 0, 0.0
    while taken < count and total < wanted:
        total += rows[order[taken], 6]
        taken += 1
    return rows[order[:taken]]


@kernel
def best_candidates(  # noqa: C901, PLR0912
    state: ByteArray,
    reachable: ByteArray,
    lens: FloatArray,
    places: FloatArray,
    centre: FloatArray,
    patches: FloatArray,
    wanted: int,
) -> IntArray:
    """Return the (at most) ``wanted`` best of the reachable positions (P, 3), best first.

    Positions are ranked by patches (M, 7): first without occlusion, which gives an upper bound, then with lines of sight in
    the order of that bound, until the rest cannot be among the best.
    """
    bound = np.zeros(len(places))
    yaw, pitch = np.zeros(len(places)), np.zeros(len(places))
    for p in range(len(places)):
        x, y, z = places[p, 0], places[p, 1], places[p, 2]
        i, j, k = int(x) + 1, int(y) + 1, int(z) + 1
        if min(x, y, z) < 0.0 or i >= reachable.shape[0] or j >= reachable.shape[1] or k >= reachable.shape[2]:
            continue
        if reachable[i, j, k] == 0:
            continue
        yaw[p], pitch[p] = aim(lens, x, y, z, centre[0], centre[1], centre[2])
        line = sight(lens, places[p], yaw[p], pitch[p])
        for m in range(len(patches)):
            px, py, pz = patches[m, 0], patches[m, 1], patches[m, 2]
            if in_view(lens, line, px, py, pz):
                bound[p] += _facing(line, px, py, pz, patches[m, 3], patches[m, 4], patches[m, 5]) * patches[m, 6]
    best = np.full(wanted, -1, dtype=np.int64)
    score = np.zeros(wanted)
    for p in np.argsort(-bound, kind="mergesort"):
        if bound[p] <= score[wanted - 1]:
            break
        line = sight(lens, places[p], yaw[p], pitch[p])
        total, left = 0.0, bound[p]
        for m in range(len(patches)):
            px, py, pz = patches[m, 0], patches[m, 1], patches[m, 2]
            if not in_view(lens, line, px, py, pz):
                continue
            facing = _facing(line, px, py, pz, patches[m, 3], patches[m, 4], patches[m, 5])
            if facing <= 0.0:
                continue
            left -= facing * patches[m, 6]
            if is_visible(state, line[0], line[1], line[2], px, py, pz, TAIL):
                total += facing * patches[m, 6]
            elif total + left <= score[wanted - 1]:
                break
        if total <= score[wanted - 1]:
            continue
        same = False  # two directions of a small shell may end in one voxel
        for b in range(wanted):
            same = same or (best[b] >= 0 and (places[best[b]] == places[p]).all())
        if same:
            continue
        slot = wanted - 1
        while slot > 0 and score[slot - 1] < total:
            best[slot], score[slot] = best[slot - 1], score[slot - 1]
            slot -= 1
        best[slot], score[slot] = p, total
    return best[best >= 0]


@kernel
def visible_gain(
    state: ByteArray,
    lens: FloatArray,
    line: LineOfSight,
    position: FloatArray,
    normal: FloatArray,
    weight: FloatArray,
    cells: IntArray,
    in_full: bool,
    cosine: FloatArray,
) -> tuple[float, int]:
    """Return the sum of (n.v) weight over the visible elements, and their number.

    cosine: (N,) output, n.v of each element, 0 = not seen.
    in_full: one line of sight per element; otherwise one to the middle element of each cell.
    """
    ex, ey, ez, cy, sy, cp, sp = line
    reach2 = (lens[RANGE] + _CELL_WIDTH) ** 2
    # max. distance of a cell's middle element from a side plane of the frustum while its rim is still inside
    beside = _CELL_WIDTH * math.sqrt(1.0 + lens[TAN_H] ** 2)
    above = _CELL_WIDTH * math.sqrt(1.0 + lens[TAN_V] ** 2)
    total, count = 0.0, 0
    cosine[:] = 0.0
    for c in range(len(cells)):
        m = cells[c, 2]
        dx, dy, dz = position[m, 0] - ex, position[m, 1] - ey, position[m, 2] - ez
        along = cy * dx + sy * dy
        forward, left, up = cp * along - sp * dz, cy * dy - sy * dx, sp * along + cp * dz
        if dx * dx + dy * dy + dz * dz > reach2:
            continue
        if abs(left) > forward * lens[TAN_H] + beside or abs(up) > forward * lens[TAN_V] + above:
            continue
        asked = in_full
        for n in range(cells[c, 0], cells[c, 1]):
            x, y, z = position[n, 0], position[n, 1], position[n, 2]
            if not in_view(lens, line, x, y, z):
                continue
            facing = _facing(line, x, y, z, normal[n, 0], normal[n, 1], normal[n, 2])
            if facing <= 0.0 or (in_full and not is_visible(state, ex, ey, ez, x, y, z, TAIL)):
                continue
            if not asked:
                asked = True
                if not is_visible(state, ex, ey, ez, position[m, 0], position[m, 1], position[m, 2], TAIL):
                    break
            cosine[n] = facing
            total += facing * weight[n]
            count += 1
    return total, count


@kernel
def best_view(
    state: ByteArray,
    lens: FloatArray,
    places: FloatArray,
    centre: FloatArray,
    position: FloatArray,
    normal: FloatArray,
    weight: FloatArray,
    cells: IntArray,
    min_visible: int,
    full: int,
    cosine: FloatArray,
) -> tuple[int, float, float, float]:
    """Return index, yaw, pitch and gain of the position (of P, 3) whose view gains most.

    All views look at ``centre``. The index is -1 if there is none. Only the ``full`` positions with the largest estimated gain
    are evaluated in full.

    cosine: (N,) output, n.v of the elements seen in the best view, 0 = not seen.
    """
    estimated_gain = np.zeros(len(places))
    for p in range(len(places)):
        yaw, pitch = aim(lens, places[p, 0], places[p, 1], places[p, 2], centre[0], centre[1], centre[2])
        line = sight(lens, places[p], yaw, pitch)
        estimated_gain[p] = visible_gain(state, lens, line, position, normal, weight, cells, False, cosine)[0]
    best, best_yaw, best_pitch, best_gain = -1, 0.0, 0.0, 0.0
    trial = np.empty(len(cosine))
    cosine[:] = 0.0
    for p in np.argsort(-estimated_gain, kind="mergesort")[:full]:
        yaw, pitch = aim(lens, places[p, 0], places[p, 1], places[p, 2], centre[0], centre[1], centre[2])
        line = sight(lens, places[p], yaw, pitch)
        gain, count = visible_gain(state, lens, line, position, normal, weight, cells, True, trial)
        if count >= min_visible and gain > best_gain:
            best, best_yaw, best_pitch, best_gain = p, yaw, pitch, gain
            for n in range(len(cosine)):
                cosine[n] = trial[n]
    return best, best_yaw, best_pitch, best_gain
