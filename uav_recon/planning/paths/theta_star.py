"""Weighted lazy Theta* path search (Nash, Koenig and Tovey, 2010) on voxel blocks.

The nodes are the connected parts of blocks of 4 x 4 x 4 voxels, each represented by one of its voxels; start and goal
represent themselves. The result is a polyline with bends near the corners that it passes. After string pulling it is about
as long as the shortest path. Positions are in padded voxel units.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.rows import copy_row
from uav_recon.planning.free_space.reachability import PartArray
from uav_recon.planning.free_space.voxel_blocks import MAX_PARTS, ONE, VoxelBlocks, corner_of, touches
from uav_recon.planning.paths.segments import distance, length_of, segment_is_open
from uav_recon.types.frames import ByteArray, FloatArray, IntArray

# weight of the heuristic: about half as many parts are expanded, and string pulling removes the difference in length
HEURISTIC_WEIGHT = 1.1
DETOUR = 6.0  # voxels; max. extra length of a bend between neighbouring parts without a line of sight
_PUSHES = 32  # heap capacity per block; a part is pushed again whenever a shorter path leads to it


class SearchMemory(NamedTuple):
    """Work arrays of the search, reused between searches.

    Stamps mark entries of earlier searches.

    now: (1,) the last stamp.
    opened, closed: (8 * blocks,) stamps.
    length, before: length of the shortest known path to a part, and the part where its last segment begins.
    heap_cost, heap_part: a binary heap.
    """

    now: IntArray
    opened: PartArray
    closed: PartArray
    before: PartArray
    length: FloatArray
    heap_cost: FloatArray
    heap_part: PartArray


def make_search_memory(blocks: VoxelBlocks) -> SearchMemory:
    """Return new work arrays; the system commits only the memory that searches touch."""
    number = len(blocks.counts)
    return SearchMemory(
        now=np.zeros(1, dtype=np.int64),
        opened=np.zeros(MAX_PARTS * number, dtype=np.int32),
        closed=np.zeros(MAX_PARTS * number, dtype=np.int32),
        before=np.zeros(MAX_PARTS * number, dtype=np.int32),
        length=np.zeros(MAX_PARTS * number, dtype=np.float64),
        heap_cost=np.empty(_PUSHES * number, dtype=np.float64),
        heap_part=np.empty(_PUSHES * number, dtype=np.int32),
    )


@kernel
def _push(heap_cost: FloatArray, heap_part: PartArray, size: int, cost: float, part: int) -> int:
    if size == len(heap_cost):
        return size
    at = size
    while at > 0:
        above = (at - 1) >> 1
        if heap_cost[above] < cost or (heap_cost[above] == cost and heap_part[above] <= part):
            break
        heap_cost[at], heap_part[at] = heap_cost[above], heap_part[above]
        at = above
    heap_cost[at], heap_part[at] = cost, part
    return size + 1


@kernel
def _pop(heap_cost: FloatArray, heap_part: PartArray, size: int) -> int:
    """Remove the first entry of the heap and return the number of remaining entries.

    The first entry has the least cost and, among equal costs, the least part number.
    """
    size -= 1
    cost, part = heap_cost[size], heap_part[size]
    at = 0
    while True:
        below = 2 * at + 1
        if below >= size:
            break
        if below + 1 < size:
            left, right = heap_cost[below], heap_cost[below + 1]
            if right < left or (right == left and heap_part[below + 1] < heap_part[below]):
                below += 1
        if heap_cost[below] > cost or (heap_cost[below] == cost and heap_part[below] >= part):
            break
        heap_cost[at], heap_part[at] = heap_cost[below], heap_part[below]
        at = below
    heap_cost[at], heap_part[at] = cost, part
    return size


@kernel
def _search(  # noqa: C901, PLR0912
    blocks: VoxelBlocks, open_samples: ByteArray, memory: SearchMemory, ends: IntArray, places: FloatArray
) -> tuple[bool, float]:
    """Search from start to goal; return whether there is a path, and the largest cost expanded.

    Fills ``memory.before``, which leads from the goal back to the start.
    """
    # unpacked once: passing the tuple on in the inner loops costs more than the loops themselves
    steps, counts, words, links, centres = blocks.steps, blocks.counts, blocks.words, blocks.links, blocks.centre
    opened, closed, before, length = memory.opened, memory.closed, memory.before, memory.length
    heap_cost, heap_part = memory.heap_cost, memory.heap_part
    number = len(counts)
    memory.now[0] += 1
    now = memory.now[0]
    start, goal = ends[0], ends[1]
    # start and goal represent their parts during this search
    start_centre, goal_centre = centres[start].copy(), centres[goal].copy()
    copy_row(centres, start, places[0])
    copy_row(centres, goal, places[1])
    gx, gy, gz = places[1, 0], places[1, 1], places[1, 2]
    opened[start], length[start], before[start] = now, 0.0, start
    size = _push(heap_cost, heap_part, 0, 0.0, start)
    greatest = 0.0
    while size > 0:
        part, cost = heap_part[0], heap_cost[0]
        size = _pop(heap_cost, heap_part, size)
        if closed[part] == now:
            continue
        greatest = max(greatest, cost)
        x, y, z = centres[part, 0], centres[part, 1], centres[part, 2]
        origin = before[part]
        ox, oy, oz = centres[origin, 0], centres[origin, 1], centres[origin, 2]
        block = part % number
        if part != start and not segment_is_open(open_samples, ox, oy, oz, x, y, z):
            # the assumed line of sight does not exist: take the shortest path through a closed neighbour (lazy Theta*)
            length[part] = np.inf
            for side in range(26):
                beside = block + steps[side]
                for c in range(counts[beside] if (links[part] >> side) & 1 else 0):
                    other = c * number + beside
                    if closed[other] == now and (counts[beside] == 1 or touches(words[part], words[other], side)):
                        reached = length[other] + distance(x, y, z, centres[other, 0], centres[other, 1], centres[other, 2])
                        if reached < length[part]:
                            length[part], before[part], origin = reached, other, other
            ox, oy, oz = centres[origin, 0], centres[origin, 1], centres[origin, 2]
        closed[part] = now
        if part == goal:
            break
        for side in range(26):
            beside = block + steps[side]
            for c in range(counts[beside] if (links[part] >> side) & 1 else 0):
                other = c * number + beside
                if closed[other] == now or (opened[other] == now and before[other] == origin):
                    continue
                if counts[beside] > 1 and not touches(words[part], words[other], side):
                    continue
                qx, qy, qz = centres[other, 0], centres[other, 1], centres[other, 2]
                reached = length[origin] + distance(ox, oy, oz, qx, qy, qz)
                if opened[other] != now or reached < length[other]:
                    opened[other], length[other], before[other] = now, reached, origin
                    size = _push(
                        heap_cost, heap_part, size, reached + HEURISTIC_WEIGHT * distance(gx, gy, gz, qx, qy, qz), other
                    )
    copy_row(centres, start, start_centre)
    copy_row(centres, goal, goal_centre)
    return closed[goal] == now, greatest


@kernel
def _bend(
    blocks: VoxelBlocks, open_samples: ByteArray, a: FloatArray, part_a: int, b: FloatArray, part_b: int, found: FloatArray
) -> int:
    """Write points ``found`` (M, 3) that lead from a to b through their two parts; return M.

    The points are the one voxel that sees both ends with the least detour or, without such a voxel, a path from voxel to
    voxel.
    """
    best = distance(a[0], a[1], a[2], b[0], b[1], b[2]) + DETOUR
    count = 0
    for part in (part_a, part_b):
        i, j, k = corner_of(blocks, part % len(blocks.counts))
        for bit in range(64):
            if (blocks.words[part] >> np.uint64(bit)) & ONE:
                x, y, z = i + bit // 16 + 0.5, j + bit // 4 % 4 + 0.5, k + bit % 4 + 0.5
                detour = distance(a[0], a[1], a[2], x, y, z) + distance(x, y, z, b[0], b[1], b[2])
                better = detour < best and segment_is_open(open_samples, a[0], a[1], a[2], x, y, z)
                if better and segment_is_open(open_samples, x, y, z, b[0], b[1], b[2]):
                    best, count = detour, 1
                    found[0, 0], found[0, 1], found[0, 2] = x, y, z
    return count if count else _voxel_by_voxel(blocks, a, part_a, b, part_b, found)


@kernel
def _voxel_by_voxel(blocks: VoxelBlocks, a: FloatArray, part_a: int, b: FloatArray, part_b: int, found: FloatArray) -> int:  # noqa: C901
    """Write the path with the fewest steps from a to b inside two touching parts.

    Returns the number of points. The points are voxel centres, without the ends if these are centres themselves.
    """
    cells = np.empty((128, 3))
    count, goal, start = 0, -1, -1
    for part in (part_a, part_b):
        if count > 0 and part_a == part_b:
            break
        i, j, k = corner_of(blocks, part % len(blocks.counts))
        for bit in range(64):
            if (blocks.words[part] >> np.uint64(bit)) & ONE:
                cells[count, 0], cells[count, 1], cells[count, 2] = i + bit // 16, j + bit // 4 % 4, k + bit % 4
                if np.all(np.floor(a) == cells[count]):
                    start = count
                if np.all(np.floor(b) == cells[count]):
                    goal = count
                count += 1
    after = np.full(count, -1)  # searched from the goal, so that following the links leads from the start to the goal
    after[goal] = goal
    queue = np.empty(count, dtype=np.int64)
    queue[0] = goal
    first, queued = 0, 1
    while first < queued:
        at = queue[first]
        first += 1
        for n in range(count):
            if after[n] < 0 and np.abs(cells[n] - cells[at]).max() <= 1.0:
                after[n] = at
                queue[queued] = n
                queued += 1
    # from an end off its voxel's centre, a line to another voxel may clip a third one; so the path goes through the centre
    number, at = 0, start
    while True:
        if (at != start or np.any(a != cells[at] + 0.5)) and (at != goal or np.any(b != cells[at] + 0.5)):
            copy_row(found, number, cells[at] + 0.5)
            number += 1
        if at == goal:
            return number
        at = after[at]


@kernel
def search_polyline(
    blocks: VoxelBlocks, open_samples: ByteArray, memory: SearchMemory, ends: IntArray, places: FloatArray, points: FloatArray
) -> tuple[int, float]:
    """Write an open polyline into ``points`` (M, 3); return its number of points and its span.

    The number is 0 if there is no path or ``points`` is too short.

    ends: (2,) parts of start and goal.
    places: (2, 3) positions of start and goal, in a voxel of these parts.
    open_samples: see segment_is_open.
    span: only voxels x with |start - x| + |x - goal| <= span were read. No other voxel can change the polyline, before or
        after string pulling.
    """
    found, span = True, 0.0
    if ends[0] == ends[1]:
        memory.before[ends[1]] = ends[0]
    else:
        found, span = _search(blocks, open_samples, memory, ends, places)
    if not found:
        return 0, np.inf
    # collected from the goal back, then reversed
    bends = np.empty((128, 3))
    count, part, reached = 1, ends[1], 0.0
    copy_row(points, 0, places[1])
    here = places[1].copy()
    while True:
        before = memory.before[part] + 0
        there = places[0].copy() if before == ends[0] else blocks.centre[before].copy()
        between = 0
        if not segment_is_open(open_samples, here[0], here[1], here[2], there[0], there[1], there[2]):
            between = _bend(blocks, open_samples, here, part, there, before, bends)
            reached += DETOUR
        if count + between + 1 > len(points):
            return 0, np.inf
        for n in range(between):
            copy_row(points, count + n, bends[n])
        copy_row(points, count + between, there)
        count += between + 1
        here, part = there, before
        if part == ends[0]:
            break
    for n in range(count // 2):
        swapped = points[n].copy()
        copy_row(points, n, points[count - 1 - n])
        copy_row(points, count - 1 - n, swapped)
    return count, max(span, reached + length_of(points[:count]))
