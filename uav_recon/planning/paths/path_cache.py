"""Shortest paths between vehicle and tasks, cached until a map change may affect them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.rows import copy_row
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.free_space.voxel_blocks import EDGE, VoxelBlocks, corner_of, part_at
from uav_recon.planning.paths.segments import departure, distance, length_of, segment_is_open
from uav_recon.planning.paths.string_pulling import pull_taut
from uav_recon.planning.paths.theta_star import SearchMemory, make_search_memory, search_polyline
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import TILE

PLACES = 64  # number of tasks whose paths are cached: those of a plan, and those that the next plans ask for again
MAX_POINTS = 24  # max. points of a cached path; a longer one is searched again when it is requested
_ROOM = 1024  # max. points of a path before string pulling


class CachedPaths(NamedTuple):
    """Paths between cached positions, as arrays for kernels.

    Entry [a, b] is the path from position a to position b, where a comes first in the order of _comes_first().

    place: (P, 3), NaN = unused entry.
    used: (P,) number of the plan that last requested the position.
    kept: (P, P) True = the entry is valid.
    length: (P, P) in voxels.
    span: (P, P), see ``search_polyline``.
    number: (P, P) number of points.
    points: (P, P, MAX_POINTS, 3).
    leaves: (P, P, 2, 3) unit directions in which the path leaves a, and leaves b.
    """

    place: FloatArray
    used: IntArray
    kept: BoolArray
    length: FloatArray
    span: FloatArray
    number: IntArray
    points: FloatArray
    leaves: FloatArray


class PathCache:
    """Paths between node 0 (the vehicle) and nodes 1..N (the tasks); one object per flight.

    A path is the straight line if it is open, else a path through flyable parts after string pulling. A cached path is
    bit-identical to the result of a new search.

    lengths_m: (N+1, N+1), symmetric, inf where there is no path.
    departures: (N+1, N+1, 3) unit directions in which the path from i to j leaves i; zero if it does not move.
    """

    def __init__(self, space: FlyableSpace) -> None:
        self._space = space
        self._plan = 0
        self.lengths_m = np.zeros((1, 1))
        self.departures = np.zeros((1, 1, 3))
        self._start(PLACES)

    def _start(self, places: int) -> None:
        self._reachable_space = self._space.reachable_space
        self._memory = make_search_memory(self._reachable_space.blocks)
        self._seen = self._space.revision
        self._buffer = np.empty((_ROOM, 3))
        self._known = CachedPaths(
            place=np.full((places, 3), np.nan),
            used=np.zeros(places, dtype=np.int64),
            kept=np.zeros((places, places), dtype=np.bool_),
            length=np.zeros((places, places)),
            span=np.zeros((places, places)),
            number=np.zeros((places, places), dtype=np.int64),
            points=np.zeros((places, places, MAX_POINTS, 3)),
            leaves=np.zeros((places, places, 2, 3)),
        )

    def update(self, exit_cells: IntArray, position_world: FloatArray, places: FloatArray) -> None:
        """Find the paths for the current map.

        exit_cells: result of ``FlyableSpace.locate_vehicle`` for position_world.
        places: (N, 3) positions of the tasks' views, padded voxel units, each in a flyable voxel.
        """
        if self._space.reachable_space is not self._reachable_space or len(places) > len(self._known.place):
            self._start(max(2 * len(places), PLACES))
        space, blocks = self._space, self._reachable_space.blocks
        self._plan += 1
        if space.revision != self._seen:
            _forget(self._known, space.open_samples, blocks, space.mask_revision, space.block_revision, self._seen)
            self._seen = space.revision
        self._places = np.ascontiguousarray(places, dtype=np.float64)
        self._slots = _assigned_slots(self._known, self._places, self._plan)
        self._head = space.cell_centres(exit_cells)
        self._head[0] = space.padded_from_world(position_world)
        lengths, self.departures = _connect(
            self._known, blocks, space.open_samples, self._memory, self._slots, self._head, self._buffer
        )
        self.lengths_m = lengths * space.grid.resolution_m

    def path_world(self, i: int, j: int) -> FloatArray:
        """Return the polyline (M, 3) in world from node i to node j, both ends included.

        It is one point if both nodes have the same position.
        """
        path = self._path(i, j)
        moved = np.concatenate(([True], np.any(np.abs(np.diff(path, axis=0)) > 1e-9, axis=1)))
        return np.ascontiguousarray(self._space.world_from_padded(path[moved]))

    def _path(self, i: int, j: int) -> FloatArray:
        if i == j:
            return self._head[:1] if i == 0 else self._places[i - 1 : i]
        if i > 0 and j > 0:
            a, b = int(self._slots[i - 1]), int(self._slots[j - 1])
            if a == b:
                return self._places[i - 1 : i]
            if _comes_first(self._known.place, b, a):
                return self._path(j, i)[::-1]
            if self._known.number[a, b] <= MAX_POINTS:
                return self._known.points[a, b, : self._known.number[a, b]]
            start = self._places[i - 1]
        elif j == 0:
            return self._path(j, i)[::-1]
        else:
            start = self._head[-1]
        count, _, _ = _path_between(
            self._reachable_space.blocks, self._space.open_samples, self._memory, start, self._places[j - 1], self._buffer
        )
        path = self._buffer[:count].copy()
        return np.concatenate([self._head[:-1], path]) if i == 0 else path


@kernel
def _forget(
    known: CachedPaths,
    open_samples: ByteArray,
    blocks: VoxelBlocks,
    mask_revision: IntArray,
    block_revision: IntArray,
    seen: int,
) -> None:
    """Invalidate each path whose span contains a change of the mask since revision ``seen``."""
    away = np.empty(len(known.place))
    for tile in np.argwhere(mask_revision > seen):
        low, high = _changed_box(blocks, block_revision, tile[0], tile[1], seen)
        for a in range(len(known.place)):
            away2 = 0.0
            for axis in range(3):
                away2 += max(low[axis] - known.place[a, axis], known.place[a, axis] - high[axis], 0.0) ** 2
            away[a] = np.sqrt(away2)
        for a in range(len(known.place)):
            for b in range(len(known.place)):
                if known.kept[a, b] and away[a] + away[b] <= known.span[a, b] + 1e-6:
                    known.kept[a, b] = False


@kernel
def _changed_box(
    blocks: VoxelBlocks, block_revision: IntArray, across: int, along: int, seen: int
) -> tuple[FloatArray, FloatArray]:
    """Return the box around the blocks of a tile that changed since revision ``seen``.

    The corners (3,), (3,) are in padded voxel units.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    per_tile = TILE // EDGE
    for bx in range(across * per_tile + 1, min(across * per_tile + per_tile, blocks.shape[0] - 2) + 1):
        for by in range(along * per_tile + 1, min(along * per_tile + per_tile, blocks.shape[1] - 2) + 1):
            for bz in range(1, blocks.shape[2] - 1):
                block = (bx * blocks.shape[1] + by) * blocks.shape[2] + bz
                if block_revision[block] > seen:
                    corner = corner_of(blocks, block)
                    for axis in range(3):
                        low[axis] = min(low[axis], float(corner[axis]))
                        high[axis] = max(high[axis], float(corner[axis] + EDGE))
    return low, high


@kernel
def _comes_first(places: FloatArray, a: int, b: int) -> bool:
    """Return True if position a (of P, 3) comes before position b: by x, then y, then z.

    False if they are equal or if either is unused.
    """
    for axis in range(3):
        if places[a, axis] != places[b, axis]:
            return bool(places[a, axis] < places[b, axis])
    return False


@kernel
def _slot_of(known: CachedPaths, place: FloatArray) -> int:
    """Return the entry of a cached position (3,), or -1."""
    for a in range(len(known.place)):
        if known.place[a, 0] == place[0] and known.place[a, 1] == place[1] and known.place[a, 2] == place[2]:
            return a
    return -1


@kernel
def _assigned_slots(known: CachedPaths, places: FloatArray, plan: int) -> IntArray:
    """Assign an entry (N,) to each position (N, 3).

    A cached position keeps its entry. A new one takes the entry that was unused for the longest time.
    """
    slots = np.full(len(places), -1)
    for n in range(len(places)):
        slots[n] = _slot_of(known, places[n])
        if slots[n] >= 0:
            known.used[slots[n]] = plan
    for n in range(len(places)):
        if slots[n] < 0:
            slots[n] = _slot_of(known, places[n])  # the same position may be in the list twice
        if slots[n] < 0:
            a = int(np.argmin(known.used))
            slots[n], known.used[a] = a, plan
            copy_row(known.place, a, places[n])
            known.kept[a, :] = False
            known.kept[:, a] = False
    return slots


@kernel
def _path_between(
    blocks: VoxelBlocks, open_samples: ByteArray, memory: SearchMemory, start: FloatArray, goal: FloatArray, points: FloatArray
) -> tuple[int, float, float]:
    """Write the path into ``points``; return its number of points (0: none), length and span.

    Length and span are in voxels.
    """
    if segment_is_open(open_samples, start[0], start[1], start[2], goal[0], goal[1], goal[2]):
        copy_row(points, 0, start)
        copy_row(points, 1, goal)
        length = distance(start[0], start[1], start[2], goal[0], goal[1], goal[2])
        return 2, length, length
    ends, places = np.empty(2, dtype=np.int64), np.empty((2, 3))
    copy_row(places, 0, start)
    copy_row(places, 1, goal)
    for n in range(2):
        ends[n] = part_at(blocks, int(places[n, 0]), int(places[n, 1]), int(places[n, 2]))
        if ends[n] < 0:
            return 0, np.inf, np.inf
    count, span = search_polyline(blocks, open_samples, memory, ends, places, points)
    if count == 0:
        return 0, np.inf, np.inf
    count = pull_taut(open_samples, points, count)
    return count, length_of(points[:count]), span


@kernel
def _connect(  # noqa: C901
    known: CachedPaths,
    blocks: VoxelBlocks,
    open_samples: ByteArray,
    memory: SearchMemory,
    slots: IntArray,
    head: FloatArray,
    points: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the lengths and departures of all paths, after searching the missing ones.

    Lengths are (N+1, N+1) in voxels, departures (N+1, N+1, 3).

    head: (M, 3) from the vehicle's position to the nearest flyable cell.
    """
    nodes = len(slots) + 1
    lengths, departures = np.full((nodes, nodes), np.inf), np.zeros((nodes, nodes, 3))
    for n in range(nodes):
        lengths[n, n] = 0.0
    for n in range(1, nodes):
        count, length, _ = _path_between(blocks, open_samples, memory, head[-1], known.place[slots[n - 1]], points)
        if count == 0:
            continue
        lengths[0, n] = lengths[n, 0] = length + length_of(head)
        copy_row(departures[0], n, departure(head) if len(head) > 1 else departure(points[:count]))
        copy_row(departures[n], 0, departure(points[:count][::-1]))
    for m in range(1, nodes):
        for n in range(1, nodes):
            a, b = slots[m - 1], slots[n - 1]
            if a == b:
                lengths[m, n] = 0.0
            if not _comes_first(known.place, a, b):
                continue
            if not known.kept[a, b]:
                count, length, span = _path_between(blocks, open_samples, memory, known.place[a], known.place[b], points)
                known.kept[a, b], known.number[a, b], known.length[a, b], known.span[a, b] = count > 0, count, length, span
                copy_row(known.leaves[a, b], 0, departure(points[:count]))
                copy_row(known.leaves[a, b], 1, departure(points[:count][::-1]))
                if count <= MAX_POINTS:
                    for k in range(count):
                        copy_row(known.points[a, b], k, points[k])
            lengths[m, n] = lengths[n, m] = known.length[a, b]
            copy_row(departures[m], n, known.leaves[a, b, 0])
            copy_row(departures[n], m, known.leaves[a, b, 1])
    return lengths, departures
