"""The table of frontier clusters: one row each, indexed by block.

The rows of a block are released when the block is clustered again.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.planning.frontier.clustering import BLOCK, MIN_CELLS, cut, is_speck
from uav_recon.planning.frontier.unknown_volume import weigh
from uav_recon.types.frames import ByteArray, FloatArray, IntArray

_FIRST_ROWS = 256
_AROUND = 5  # blocks along each side of the square that is searched first
OPENING = 150  # voxels; a cluster with less unknown space beyond it is a gap in front of a wall ...
FARTHER = 100.0  # ... and its distance counts this many voxels more
# indices of ClusterTable.fill
POOL = 0
SPARE = 1


class ClusterTable:
    """The frontier clusters of one grid, one row per cluster.

    head: (blocks) first row of a block + 1, or 0.
    after: (M,) next row of the block + 1, or 0.
    count: (M,) number of cells; 0 = the row is unused.
    speck: (M,) 1 = too few connected cells to be worth a view.
    key: (M,) hash of the cells and their unknown faces.
    start: (M,) start of the cells' flat indices in ``pool``.
    centre: (M, 3) mean of the cells' centres, voxels.
    beyond: (M,) unknown voxels behind the cluster, see unknown_volume.py.
    """

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.head = np.zeros((-(-shape[0] // BLOCK), -(-shape[1] // BLOCK)), dtype=np.int64)
        self.after = np.zeros(0, dtype=np.int64)
        self.count = np.zeros(0, dtype=np.int64)
        self.speck = np.zeros(0, dtype=np.uint8)
        self.key = np.zeros(0, dtype=np.int64)
        self.start = np.zeros(0, dtype=np.int64)
        self.centre = np.zeros((0, 3))
        self.beyond = np.zeros(0, dtype=np.int64)
        self.spare = np.zeros(0, dtype=np.int64)  # stack of unused rows
        self.fill = np.zeros(2, dtype=np.int64)  # used length of pool, number of unused rows
        self.pool = np.zeros(0, dtype=np.int64)
        self._more_rows()
        self._more_pool(0)

    def cut_again(self, faces: ByteArray, ignored: ByteArray, blocks: IntArray, max_extent: float) -> None:
        """Replace the clusters of ``blocks`` (N, 2)."""
        done = 0
        while True:
            done, cells, clusters = _cut_blocks(
                faces, ignored, blocks, done, max_extent, self.head, self.after, self.count, self.speck, self.key,
                self.start, self.centre, self.spare, self.fill, self.pool,
            )  # fmt: skip
            if done == len(blocks):
                break
            if self.fill[SPARE] < clusters:
                self._more_rows()
            if len(self.pool) - self.fill[POOL] < cells:
                self._more_pool(cells)
        _mark_specks(faces, ignored, blocks, self.head, self.after, self.count, self.speck, self.start, self.pool)

    def weigh(self, state: ByteArray, faces: ByteArray, low: IntArray, high: IntArray, asked: ByteArray) -> None:
        """Update ``beyond`` for the clusters of the marked blocks; see unknown_volume.py.

        asked: (blocks) 1 = marked.
        """
        weigh(state, faces, low, high, asked, self.head, self.after, self.count, self.start, self.pool, self.beyond)

    def nearest(self, place: FloatArray, most: int, *, specks: bool = False) -> IntArray:
        """Return the rows of the ``most`` clusters nearest to a position (3,), voxels.

        Ties are ordered by key, so that the order depends on the map only. A cluster with less than OPENING voxels beyond
        it counts as FARTHER voxels farther away. specks: those count too.
        """
        skipped = np.zeros_like(self.speck) if specks else self.speck
        return _nearest(self.head, self.after, self.count, skipped, self.key, self.centre, self.beyond, place, most)

    def size(self, *, specks: bool = False) -> int:
        """Return the number of clusters. specks: those count too."""
        used = self.count > 0
        return int(np.count_nonzero(used if specks else used & (self.speck == 0)))

    def _more_rows(self) -> None:
        old = len(self.count)
        new = max(2 * old, _FIRST_ROWS)
        for name in ("after", "count", "speck", "key", "start", "centre", "beyond"):
            column = getattr(self, name)
            grown = np.zeros((new, *column.shape[1:]), dtype=column.dtype)
            grown[:old] = column
            setattr(self, name, grown)
        spare = np.zeros(new, dtype=np.int64)
        left = int(self.fill[SPARE])
        spare[:left] = self.spare[:left]
        spare[left : left + new - old] = np.arange(new - 1, old - 1, -1)
        self.spare = spare
        self.fill[SPARE] = left + new - old

    def _more_pool(self, wanted: int) -> None:
        """Compact the pool; leave room for the same amount again and for ``wanted`` entries."""
        live = int(self.count.sum())
        pool = np.zeros(2 * live + wanted + 4096, dtype=np.int64)
        self.fill[POOL] = _pack(self.count, self.start, self.pool, pool)
        self.pool = pool


@kernel
def _cut_blocks(
    faces: ByteArray,
    ignored: ByteArray,
    blocks: IntArray,
    done: int,
    max_extent: float,
    head: IntArray,
    after: IntArray,
    count: IntArray,
    speck: ByteArray,
    key: IntArray,
    start: IntArray,
    centre: FloatArray,
    spare: IntArray,
    fill: IntArray,
    pool: IntArray,
) -> tuple[int, int, int]:
    """Cluster blocks[done:]; return the index where it stopped, and the missing room.

    The missing room is the number of cells and rows of the next block, 0 if all blocks are done.
    """
    _, ny, nz = faces.shape
    cells = np.empty(BLOCK * BLOCK * nz, dtype=np.int64)
    starts = np.empty(BLOCK * BLOCK * nz + 1, dtype=np.int64)
    for n in range(done, len(blocks)):
        bi, bj = blocks[n, 0], blocks[n, 1]
        clusters = cut(faces, ignored, bi, bj, max_extent, cells, starts)
        total = starts[clusters]
        if len(pool) - fill[POOL] < total or fill[SPARE] < clusters:
            return n, total, clusters
        row = head[bi, bj] - 1
        while row >= 0:
            count[row] = 0
            spare[fill[SPARE]] = row
            fill[SPARE] += 1
            row = after[row] - 1
        head[bi, bj] = 0
        for cluster in range(clusters):
            fill[SPARE] -= 1
            row = spare[fill[SPARE]]
            after[row] = head[bi, bj]
            head[bi, bj] = row + 1
            a, b = starts[cluster], starts[cluster + 1]
            start[row], count[row], speck[row] = fill[POOL], b - a, 0
            digest, sx, sy, sz = b - a, 0, 0, 0
            for m in range(a, b):
                flat = cells[m]
                pool[fill[POOL]] = flat
                fill[POOL] += 1
                i, j, k = flat // (ny * nz), flat // nz % ny, flat % nz
                sx += i
                sy += j
                sz += k
                digest = (digest ^ (flat * 64 + faces[i, j, k])) * 1099511628211  # FNV-1a, one cell at a time
                digest ^= digest >> 29
            key[row] = digest
            centre[row, 0], centre[row, 1], centre[row, 2] = sx / (b - a) + 0.5, sy / (b - a) + 0.5, sz / (b - a) + 0.5
    return len(blocks), 0, 0


@kernel
def _mark_specks(
    faces: ByteArray,
    ignored: ByteArray,
    blocks: IntArray,
    head: IntArray,
    after: IntArray,
    count: IntArray,
    speck: ByteArray,
    start: IntArray,
    pool: IntArray,
) -> None:
    """Update ``speck`` of the small clusters in and around ``blocks``."""
    asked = np.zeros(head.shape, dtype=np.bool_)
    for n in range(len(blocks)):
        for bi in range(max(blocks[n, 0] - 1, 0), min(blocks[n, 0] + 2, head.shape[0])):
            for bj in range(max(blocks[n, 1] - 1, 0), min(blocks[n, 1] + 2, head.shape[1])):
                if asked[bi, bj]:
                    continue
                asked[bi, bj] = True
                row = head[bi, bj] - 1
                while row >= 0:
                    if count[row] < MIN_CELLS:
                        speck[row] = 1 if is_speck(faces, ignored, pool[start[row]]) else 0
                    row = after[row] - 1


@kernel
def _nearest(  # noqa: C901
    head: IntArray,
    after: IntArray,
    count: IntArray,
    speck: ByteArray,
    key: IntArray,
    centre: FloatArray,
    beyond: IntArray,
    place: FloatArray,
    most: int,
) -> IntArray:
    rows = np.empty(most, dtype=np.int64)
    far2 = np.empty(most)
    found = 0
    here_i, here_j = int(place[0]) // BLOCK, int(place[1]) // BLOCK
    # the blocks around the position first; then nearly all others are rejected by their distance alone
    for block in range(_AROUND * _AROUND + head.size):
        if block < _AROUND * _AROUND:
            bi, bj = here_i + block // _AROUND - _AROUND // 2, here_j + block % _AROUND - _AROUND // 2
            if bi < 0 or bj < 0 or bi >= head.shape[0] or bj >= head.shape[1]:
                continue
        else:
            bi, bj = (block - _AROUND * _AROUND) // head.shape[1], (block - _AROUND * _AROUND) % head.shape[1]
            if abs(bi - here_i) <= _AROUND // 2 and abs(bj - here_j) <= _AROUND // 2:
                continue
        if head[bi, bj] > 0:
            off_x = max(bi * BLOCK - place[0], place[0] - (bi + 1) * BLOCK, 0.0)
            off_y = max(bj * BLOCK - place[1], place[1] - (bj + 1) * BLOCK, 0.0)
            if found == most and off_x * off_x + off_y * off_y > far2[most - 1]:
                continue
            row = head[bi, bj] - 1
            while row >= 0:
                dx, dy, dz = centre[row, 0] - place[0], centre[row, 1] - place[1], centre[row, 2] - place[2]
                d2 = dx * dx + dy * dy + dz * dz
                if beyond[row] < OPENING:
                    d2 = (math.sqrt(d2) + FARTHER) ** 2
                at = found
                while at > 0 and (d2 < far2[at - 1] or (d2 == far2[at - 1] and key[row] < key[rows[at - 1]])):
                    at -= 1
                if speck[row] == 0 and at < most:
                    found = min(found + 1, most)
                    for m in range(found - 1, at, -1):
                        rows[m], far2[m] = rows[m - 1], far2[m - 1]
                    rows[at], far2[at] = row, d2
                row = after[row] - 1
    return rows[:found].copy()


@kernel
def _pack(count: IntArray, start: IntArray, pool: IntArray, packed: IntArray) -> int:
    used = 0
    for row in range(len(count)):
        for n in range(count[row]):
            packed[used + n] = pool[start[row] + n]
        start[row] = used
        used += count[row]
    return used
