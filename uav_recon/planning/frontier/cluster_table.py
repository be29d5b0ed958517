"""The table of frontier clusters: one row each, indexed by block.

The rows of a block are released when the block is clustered again.
"""

from __future__ import annotations

import math
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.planning.frontier.cluster_rows import ClusterRows
from uav_recon.planning.frontier.clustering import BLOCK, MIN_CELLS, cut, is_speck
from uav_recon.planning.frontier.unknown_volume import fill_unknown_volumes
from uav_recon.types.frames import ByteArray, FloatArray, IntArray

_FIRST_ROWS = 256
_AROUND = 5  # blocks along each side of the square that is searched first
OPENING = 150  # voxels; a cluster with less unknown space beyond it is a gap in front of a wall ...
FARTHER = 100.0  # ... and its distance counts this many voxels more
# indices of ClusterRows.fill
POOL = 0
SPARE = 1
_Column = TypeVar("_Column", bound=NDArray[Any])


class ClusterTable:
    """The frontier clusters of one grid, one row per cluster."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.rows = ClusterRows(
            head=np.zeros((-(-shape[0] // BLOCK), -(-shape[1] // BLOCK)), dtype=np.int64),
            after=np.zeros(0, dtype=np.int64),
            cells=np.zeros(0, dtype=np.int64),
            speck=np.zeros(0, dtype=np.uint8),
            key=np.zeros(0, dtype=np.int64),
            start=np.zeros(0, dtype=np.int64),
            centre=np.zeros((0, 3)),
            beyond=np.zeros(0, dtype=np.int64),
            spare=np.zeros(0, dtype=np.int64),
            fill=np.zeros(2, dtype=np.int64),
            pool=np.zeros(0, dtype=np.int64),
        )
        self._more_rows()
        self._more_pool(0)

    def cluster_again(self, faces: ByteArray, ignored: ByteArray, blocks: IntArray, max_extent: float) -> None:
        """Replace the clusters of ``blocks`` (N, 2)."""
        done = 0
        while True:
            done, cells, clusters = _cut_blocks(faces, ignored, blocks, done, max_extent, self.rows)
            if done == len(blocks):
                break
            if self.rows.fill[SPARE] < clusters:
                self._more_rows()
            if len(self.rows.pool) - self.rows.fill[POOL] < cells:
                self._more_pool(cells)
        _mark_specks(faces, ignored, blocks, self.rows)

    def update_unknown_volumes(
        self, state: ByteArray, faces: ByteArray, low: IntArray, high: IntArray, asked: ByteArray
    ) -> None:
        """Update ``beyond`` for the clusters of the marked blocks; see unknown_volume.py.

        asked: (blocks) 1 = marked.
        """
        fill_unknown_volumes(state, faces, low, high, asked, self.rows)

    def nearest(self, place: FloatArray, most: int, *, specks: bool = False) -> IntArray:
        """Return the rows of the ``most`` clusters nearest to a position (3,), voxels.

        Ties are ordered by key, so that the order depends on the map only. A cluster with less than OPENING voxels beyond
        it counts as FARTHER voxels farther away. specks: those count too.
        """
        rows = self.rows._replace(speck=np.zeros_like(self.rows.speck)) if specks else self.rows
        return _nearest(rows, place, most)

    def size(self, *, specks: bool = False) -> int:
        """Return the number of clusters. specks: those count too."""
        used = self.rows.cells > 0
        return int(np.count_nonzero(used if specks else used & (self.rows.speck == 0)))

    def _more_rows(self) -> None:
        rows, old = self.rows, len(self.rows.cells)
        new = max(2 * old, _FIRST_ROWS)
        spare = np.zeros(new, dtype=np.int64)
        left = int(rows.fill[SPARE])
        spare[:left] = rows.spare[:left]
        spare[left : left + new - old] = np.arange(new - 1, old - 1, -1)
        rows.fill[SPARE] = left + new - old
        self.rows = rows._replace(
            after=_grown(rows.after, new),
            cells=_grown(rows.cells, new),
            speck=_grown(rows.speck, new),
            key=_grown(rows.key, new),
            start=_grown(rows.start, new),
            centre=_grown(rows.centre, new),
            beyond=_grown(rows.beyond, new),
            spare=spare,
        )

    def _more_pool(self, wanted: int) -> None:
        """Compact the pool; leave room for the same amount again and for ``wanted`` entries."""
        live = int(self.rows.cells.sum())
        pool = np.zeros(2 * live + wanted + 4096, dtype=np.int64)
        self.rows.fill[POOL] = _pack(self.rows, pool)
        self.rows = self.rows._replace(pool=pool)


def _grown(column: _Column, length: int) -> _Column:
    """Return a column of a greater length, filled up with zeros."""
    grown = np.zeros((length, *column.shape[1:]), dtype=column.dtype)
    grown[: len(column)] = column
    return cast("_Column", grown)


@kernel
def _cut_blocks(
    faces: ByteArray, ignored: ByteArray, blocks: IntArray, done: int, max_extent: float, rows: ClusterRows
) -> tuple[int, int, int]:
    """Cluster blocks[done:]; return the index where it stopped, and the missing room.

    The missing room is the number of cells and rows of the next block, 0 if all blocks are done.
    """
    _, ny, nz = faces.shape
    head, after, spare, fill, pool, centre = rows.head, rows.after, rows.spare, rows.fill, rows.pool, rows.centre
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
            rows.cells[row] = 0
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
            rows.start[row], rows.cells[row], rows.speck[row] = fill[POOL], b - a, 0
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
            rows.key[row] = digest
            centre[row, 0], centre[row, 1], centre[row, 2] = sx / (b - a) + 0.5, sy / (b - a) + 0.5, sz / (b - a) + 0.5
    return len(blocks), 0, 0


@kernel
def _mark_specks(faces: ByteArray, ignored: ByteArray, blocks: IntArray, rows: ClusterRows) -> None:
    """Update ``speck`` of the small clusters in and around ``blocks``."""
    head = rows.head
    asked = np.zeros(head.shape, dtype=np.bool_)
    for n in range(len(blocks)):
        for bi in range(max(blocks[n, 0] - 1, 0), min(blocks[n, 0] + 2, head.shape[0])):
            for bj in range(max(blocks[n, 1] - 1, 0), min(blocks[n, 1] + 2, head.shape[1])):
                if asked[bi, bj]:
                    continue
                asked[bi, bj] = True
                row = head[bi, bj] - 1
                while row >= 0:
                    if rows.cells[row] < MIN_CELLS:
                        rows.speck[row] = 1 if is_speck(faces, ignored, rows.pool[rows.start[row]]) else 0
                    row = rows.after[row] - 1


@kernel
def _nearest(table: ClusterRows, place: FloatArray, most: int) -> IntArray:  # noqa: C901
    head, after, speck, key, centre, beyond = table.head, table.after, table.speck, table.key, table.centre, table.beyond
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
def _pack(rows: ClusterRows, packed: IntArray) -> int:
    used = 0
    for row in range(len(rows.cells)):
        for n in range(rows.cells[row]):
            packed[used + n] = rows.pool[rows.start[row] + n]
        rows.start[row] = used
        used += rows.cells[row]
    return used
