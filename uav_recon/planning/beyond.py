"""How much unknown space lies behind a frontier: an opening into a room, or a gap in front of a wall.

A cluster of few cells may be either, and a tour that takes both for the same spends a flight on gaps. What is beyond is
reckoned in voxels: from each unknown face of each cell straight on, through unknown voxels, up to DEPTH of them and no
farther than the fence. The first few do not count: there the wall itself is what is not known, and the model closes so
small a gap. Volume as the gain of exploring: Connolly, "The determination of next best views" (1985).
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import ByteArray, IntArray
from uav_recon.types.maps import TILE, UNKNOWN

DEPTH = TILE  # voxels: what lies beyond hangs on the tiles around a cell's own, and on no others
SHALLOW = 2  # voxels that do not count


@kernel
def beyond(state: ByteArray, faces: ByteArray, cells: IntArray, low: IntArray, high: IntArray) -> int:
    """Unknown voxels met straight on from the unknown faces of frontier cells (N,), flat indices; inside [low, high) alone.

    The first SHALLOW of each face do not count.
    """
    _, ny, nz = state.shape
    total = 0
    for n in range(len(cells)):
        i, j, k = cells[n] // (ny * nz), cells[n] // nz % ny, cells[n] % nz
        bits = faces[i, j, k]
        for face in range(6):
            if not bits >> face & 1:
                continue
            axis, sign = face >> 1, (1 if face & 1 else -1)
            a, b, c = i, j, k
            for step in range(DEPTH):
                a += sign if axis == 0 else 0
                b += sign if axis == 1 else 0
                c += sign if axis == 2 else 0
                if a < low[0] or b < low[1] or c < low[2] or a >= high[0] or b >= high[1] or c >= high[2]:
                    break
                if state[a, b, c] != UNKNOWN:
                    break
                total += 1 if step >= SHALLOW else 0
    return total


@kernel
def beyond_each(state: ByteArray, faces: ByteArray, cells: IntArray, ends: IntArray, low: IntArray, high: IntArray) -> IntArray:
    """The same for N sets of cells in a row: set n is cells[ends[n] : ends[n + 1]]."""
    out = np.zeros(len(ends) - 1, dtype=np.int64)
    for n in range(len(out)):
        out[n] = beyond(state, faces, cells[ends[n] : ends[n + 1]], low, high)
    return out


@kernel
def weigh(
    state: ByteArray,
    faces: ByteArray,
    low: IntArray,
    high: IntArray,
    blocks: IntArray,
    head: IntArray,
    after: IntArray,
    count: IntArray,
    start: IntArray,
    pool: IntArray,
    out: IntArray,
) -> None:
    """Reckon anew what is beyond the clusters of ``blocks`` (N, 2); the columns of a ClusterTable, ``out`` by row."""
    for n in range(len(blocks)):
        row = head[blocks[n, 0], blocks[n, 1]] - 1
        while row >= 0:
            out[row] = beyond(state, faces, pool[start[row] : start[row] + count[row]], low, high)
            row = after[row] - 1
