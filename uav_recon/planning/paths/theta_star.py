"""Ways from part to part of flyable space: weighted lazy Theta* (Nash, Koenig and Tovey, 2010) on blocks of 4 x 4 x 4 voxels.

Each part stands for one of its voxels, the two ends for themselves. What is found is a polyline whose bends lie near the
corners that it has to pass; pulled taut it is as long as the shortest way. Positions are in padded voxel units.
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

EAGERNESS = 1.1  # towards the goal: half as many parts are looked at, for ways that differ by less than what pulling evens out
DETOUR = 6.0  # voxels: a bend between neighbouring parts that do not see each other costs at most so much
_PUSHES = 32  # room for so many entries of the heap for each block; a part is entered again whenever a shorter way leads to it


class Memory(NamedTuple):
    """Work arrays of the search, kept between searches: what an earlier one left is known by its stamp.

    now: (1,) the last stamp. opened, closed: (8 * blocks,) stamps. length, before: shortest known way to a part, and the part
    where its last segment begins. heap_cost, heap_part: a heap.
    """

    now: IntArray
    opened: PartArray
    closed: PartArray
    before: PartArray
    length: FloatArray
    heap_cost: FloatArray
    heap_part: PartArray


def memory_for(blocks: VoxelBlocks) -> Memory:
    """Return fresh work arrays; the system commits only what searches touch."""
    number = len(blocks.counts)
    return Memory(
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
    """Take away the first (the least cost, of equal ones the least number); how many are left."""
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
def _search(blocks: VoxelBlocks, leap: ByteArray, memory: Memory, ends: IntArray, places: FloatArray) -> tuple[bool, float]:
    """Find the parts' ``before`` from the goal back to the start; whether there is a way, and the greatest cost looked at."""
    # unpacked once: to hand on such a tuple in the inner loops costs more than what they do
    steps, counts, words, links, stands = blocks.steps, blocks.counts, blocks.words, blocks.links, blocks.centre
    opened, closed, before, length = memory.opened, memory.closed, memory.before, memory.length
    heap_cost, heap_part = memory.heap_cost, memory.heap_part
    number = len(counts)
    memory.now[0] += 1
    now = memory.now[0]
    start, goal = ends[0], ends[1]
    # the ends stand for themselves while this search runs
    start_stood, goal_stood = stands[start].copy(), stands[goal].copy()
    copy_row(stands, start, places[0])
    copy_row(stands, goal, places[1])
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
        x, y, z = stands[part, 0], stands[part, 1], stands[part, 2]
        origin = before[part]
        ox, oy, oz = stands[origin, 0], stands[origin, 1], stands[origin, 2]
        block = part % number
        if part != start and not segment_is_open(leap, ox, oy, oz, x, y, z):
            # hoped for in vain: the best way through a neighbour that is settled already
            length[part] = np.inf
            for side in range(26):
                beside = block + steps[side]
                for c in range(counts[beside] if (links[part] >> side) & 1 else 0):
                    other = c * number + beside
                    if closed[other] == now and (counts[beside] == 1 or touches(words[part], words[other], side)):
                        reached = length[other] + distance(x, y, z, stands[other, 0], stands[other, 1], stands[other, 2])
                        if reached < length[part]:
                            length[part], before[part], origin = reached, other, other
            ox, oy, oz = stands[origin, 0], stands[origin, 1], stands[origin, 2]
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
                qx, qy, qz = stands[other, 0], stands[other, 1], stands[other, 2]
                reached = length[origin] + distance(ox, oy, oz, qx, qy, qz)
                if opened[other] != now or reached < length[other]:
                    opened[other], length[other], before[other] = now, reached, origin
                    size = _push(heap_cost, heap_part, size, reached + EAGERNESS * distance(gx, gy, gz, qx, qy, qz), other)
    copy_row(stands, start, start_stood)
    copy_row(stands, goal, goal_stood)
    return closed[goal] == now, greatest


@kernel
def _bend(
    blocks: VoxelBlocks, leap: ByteArray, a: FloatArray, part_a: int, b: FloatArray, part_b: int, found: FloatArray
) -> int:
    """Write points ``found`` (M, 3) that lead from a to b through their touching parts; how many.

    One voxel that sees both, the one with the least detour; where there is none, voxel by voxel.
    """
    best = distance(a[0], a[1], a[2], b[0], b[1], b[2]) + DETOUR
    count = 0
    for part in (part_a, part_b):
        i, j, k = corner_of(blocks, part % len(blocks.counts))
        for bit in range(64):
            if (blocks.words[part] >> np.uint64(bit)) & ONE:
                x, y, z = i + bit // 16 + 0.5, j + bit // 4 % 4 + 0.5, k + bit % 4 + 0.5
                detour = distance(a[0], a[1], a[2], x, y, z) + distance(x, y, z, b[0], b[1], b[2])
                better = detour < best and segment_is_open(leap, a[0], a[1], a[2], x, y, z)
                if better and segment_is_open(leap, x, y, z, b[0], b[1], b[2]):
                    best, count = detour, 1
                    found[0, 0], found[0, 1], found[0, 2] = x, y, z
    return count if count else _voxel_by_voxel(blocks, a, part_a, b, part_b, found)


@kernel
def _voxel_by_voxel(blocks: VoxelBlocks, a: FloatArray, part_a: int, b: FloatArray, part_b: int, found: FloatArray) -> int:
    """Shortest way (in steps) from a to b inside two touching parts: centres of voxels, but for ends that are centres."""
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
    after = np.full(count, -1)  # found from the goal back, so that following it leads from the start on
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
    # from an end off its voxel's centre a line to another voxel may clip a third one: it is left and reached by the centre
    number, at = 0, start
    while True:
        if (at != start or np.any(a != cells[at] + 0.5)) and (at != goal or np.any(b != cells[at] + 0.5)):
            copy_row(found, number, cells[at] + 0.5)
            number += 1
        if at == goal:
            return number
        at = after[at]


@kernel
def find_bends(
    blocks: VoxelBlocks, leap: ByteArray, memory: Memory, ends: IntArray, places: FloatArray, points: FloatArray
) -> tuple[int, float]:
    """Write an open polyline into ``points`` (M, 3); how many points it has (0: no way, or no room), and its span.

    ends: (2,) parts of start and goal; places: (2, 3) start and goal, in a voxel of these parts. leap: see segment_is_open.
    span: voxels with |start - x| + |x - goal| greater than it were not asked and could not have changed the answer, whatever
    they were; neither can they change what is made of the polyline by pulling it taut.
    """
    found, span = True, 0.0
    if ends[0] == ends[1]:
        memory.before[ends[1]] = ends[0]
    else:
        found, span = _search(blocks, leap, memory, ends, places)
    if not found:
        return 0, np.inf
    # from the goal back, then turned round
    bends = np.empty((128, 3))
    count, part, reached = 1, ends[1], 0.0
    copy_row(points, 0, places[1])
    here = places[1].copy()
    while True:
        before = memory.before[part] + 0
        there = places[0].copy() if before == ends[0] else blocks.centre[before].copy()
        between = 0
        if not segment_is_open(leap, here[0], here[1], here[2], there[0], there[1], there[2]):
            between = _bend(blocks, leap, here, part, there, before, bends)
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
