"""Search for narrow passages: ways with little clearance to flyable space behind them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.types.frames import ByteArray, IntArray
from uav_recon.types.maps import VoxelMap

MIN_BEHIND_VOXELS = 100  # flyable voxels behind a passage; fewer are not worth it
MAX_STEPS = 18  # voxels of a passage; a longer one is no door
WIDE2 = 16  # squared distance in voxels from which on a way is not better for being wider
MAX_FOUND = 16  # passages of one search


class FoundPassage(NamedTuple):
    """A way with little clearance.

    cells: (N,) flat PADDED indices from the last voxel with the usual clearance to the first one behind the passage.
    voxels_behind: number of flyable voxels that it leads to.
    """

    cells: IntArray
    voxels_behind: int


class PassageMemory(NamedTuple):
    """Work arrays of the search, one element for each padded voxel.

    The stamps tell which entries are of this search.
    """

    stamp: NDArray[np.int32]
    depth: NDArray[np.int32]
    width2: ByteArray
    parent: NDArray[np.int32]
    queue: NDArray[np.int32]


class PassageSearch:
    """Finds the shortest passage to each part of the flyable space that is not reachable."""

    def __init__(self) -> None:
        self._now = 0
        self._memory = _make_memory(0)

    def find(self, voxels: VoxelMap, usual: FlyableSpace, tight: FlyableSpace, height_m: float) -> list[FoundPassage]:
        """Return the shortest passage to each part.

        Of those of equal length it is the widest, of these the nearest to height_m in world. usual: space with the usual
        clearance. tight: space with the least clearance of a passage. Both are up to date, and the vehicle is located in both.
        """
        behind = np.flatnonzero(usual.mask & tight.reachable & (1 - usual.reachable))
        if len(behind) < MIN_BEHIND_VOXELS:
            return []
        if len(self._memory.stamp) != usual.mask.size:
            self._memory = _make_memory(usual.mask.size)
            self._now = 0
        cells = np.empty((MAX_FOUND, MAX_STEPS + 2), dtype=np.int64)
        sizes, lengths = np.zeros(MAX_FOUND, dtype=np.int64), np.zeros(MAX_FOUND, dtype=np.int64)
        count, self._now = _trace(
            behind, usual.mask, usual.reachable, tight.reachable, voxels.distance2, self._memory, self._now,
            usual.padded_from_world(np.array([0.0, 0.0, height_m]))[2], cells, lengths, sizes,
        )  # fmt: skip
        return [FoundPassage(cells[n, : lengths[n]].copy(), int(sizes[n])) for n in range(count)]


def _make_memory(size: int) -> PassageMemory:
    return PassageMemory(
        stamp=np.zeros(size, dtype=np.int32),
        depth=np.zeros(size, dtype=np.int32),
        width2=np.zeros(size, dtype=np.uint8),
        parent=np.zeros(size, dtype=np.int32),
        queue=np.zeros(size, dtype=np.int32),
    )


@kernel
def _trace(  # noqa: C901, PLR0912, PLR0915
    seeds: IntArray, usual: ByteArray, reachable: ByteArray, tight: ByteArray, distance2: ByteArray, memory: PassageMemory,
    now: int, level: float, cells: IntArray, lengths: IntArray, sizes: IntArray,
) -> tuple[int, int]:  # fmt: skip
    """Fill ``cells`` (P, L), ``lengths`` (P,) and ``sizes`` (P,) with the passages.

    Returns their number and the last stamp. level: preferred height, padded voxels. Each part behind a passage is flooded. From
    all of it a breadth-first search goes through the tight space to the first reachable voxels. In each layer a voxel keeps the
    parent with the widest way.
    """
    _, ny, nz = usual.shape
    own, near, through = usual.reshape(-1), reachable.reshape(-1), tight.reshape(-1)
    stamp, depth, width2, parent, queue = memory
    begun, count = now, 0
    for seed in seeds:
        if stamp[seed] > begun:
            continue
        now += 1
        stamp[seed] = now
        queue[0], first, size = seed, 0, 1
        while first < size:
            cell = queue[first]
            first += 1
            for step in range(27):
                to = cell + (step // 9 - 1) * ny * nz + (step // 3 % 3 - 1) * nz + step % 3 - 1
                if own[to] and not near[to] and stamp[to] != now:
                    stamp[to] = now
                    queue[size] = to
                    size += 1
        behind = size
        if behind < MIN_BEHIND_VOXELS:
            continue
        off = np.empty(size)
        for n in range(size):
            depth[queue[n]], width2[queue[n]], parent[queue[n]] = 0, 255, -1
            off[n] = abs(queue[n] % nz + 0.5 - level)
        queue[:size] = queue[:size][np.argsort(off)]  # ways from about the preferred height are found first
        first, best = 0, -1
        while first < size:
            cell = queue[first]
            first += 1
            if depth[cell] > MAX_STEPS or (best >= 0 and depth[cell] >= depth[best]):
                break
            for step in range(27):
                to = cell + (step // 9 - 1) * ny * nz + (step // 3 % 3 - 1) * nz + step % 3 - 1
                if not through[to] or (own[to] and not near[to]):
                    continue
                wide2 = min(width2[cell], distance2[to // (ny * nz) - 1, to // nz % ny - 1, to % nz - 1], WIDE2)
                if stamp[to] != now:
                    stamp[to] = now
                    depth[to], width2[to], parent[to] = depth[cell] + 1, wide2, cell
                    queue[size] = to
                    size += 1
                elif depth[to] == depth[cell] + 1 and wide2 > width2[to]:
                    width2[to], parent[to] = wide2, cell
                if near[to] and (
                    best < 0
                    or width2[to] > width2[best]
                    or (width2[to] == width2[best] and abs(to % nz + 0.5 - level) < abs(best % nz + 0.5 - level))
                ):
                    best = to
        if best < 0 or depth[best] > MAX_STEPS:
            continue
        length, cell = 0, best
        while cell >= 0:
            cells[count, length] = cell
            length += 1
            cell = parent[cell]
        lengths[count], sizes[count] = length, behind
        count += 1
        if count == MAX_FOUND:
            break
    return count, now
