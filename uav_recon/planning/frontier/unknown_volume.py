"""Unknown volume behind a frontier: distinguishes openings from gaps in front of a wall.

A small cluster may be either, and a tour that does not distinguish them wastes flight time on gaps. The volume is counted
in voxels: from each unknown face of each cell straight on through unknown voxels, up to DEPTH of them and not beyond the
fence. The first SHALLOW voxels do not count: there the wall itself is unknown, and the surface model closes so small a gap.
Volume as the gain of exploration: Connolly, "The determination of next best views" (1985).
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.planning.frontier.cluster_rows import ClusterRows
from uav_recon.types.frames import ByteArray, IntArray
from uav_recon.types.maps import TILE, UNKNOWN

DEPTH = TILE  # voxels; the count depends only on the tiles around a cell's own tile
SHALLOW = 2  # voxels that do not count


@kernel
def unknown_volume(state: ByteArray, faces: ByteArray, cells: IntArray, low: IntArray, high: IntArray) -> int:
    """Count the unknown voxels straight on from the unknown faces of frontier cells (N,).

    cells: flat indices. Only voxels in [low, high) count, and not the first SHALLOW of each face.
    """
    _, ny, nz = state.shape
    flat, flat_faces = state.reshape(-1), faces.reshape(-1)
    total = 0
    for n in range(len(cells)):
        at = cells[n]
        column = at // nz
        i, j, k = column // ny, column % ny, at - column * nz
        bits = flat_faces[at]
        if bits & 1:
            total += _run(flat, at, -ny * nz, i - low[0])
        if bits & 2:
            total += _run(flat, at, ny * nz, high[0] - 1 - i)
        if bits & 4:
            total += _run(flat, at, -nz, j - low[1])
        if bits & 8:
            total += _run(flat, at, nz, high[1] - 1 - j)
        if bits & 16:
            total += _run(flat, at, -1, k - low[2])
        if bits & 32:
            total += _run(flat, at, 1, high[2] - 1 - k)
    return total


@kernel
def _run(flat: ByteArray, at: int, stride: int, room: int) -> int:
    """Count consecutive unknown voxels from ``at`` in one direction, at most ``room``.

    The first SHALLOW are subtracted.
    """
    most = min(room, DEPTH)
    run = 0
    while run < most and flat[at + (run + 1) * stride] == UNKNOWN:
        run += 1
    return max(run - SHALLOW, 0)


@kernel
def unknown_volume_of_each(
    state: ByteArray, faces: ByteArray, cells: IntArray, ends: IntArray, low: IntArray, high: IntArray
) -> IntArray:
    """Return unknown_volume() of N sets of cells; set n is cells[ends[n] : ends[n + 1]]."""
    out = np.zeros(len(ends) - 1, dtype=np.int64)
    for n in range(len(out)):
        out[n] = unknown_volume(state, faces, cells[ends[n] : ends[n + 1]], low, high)
    return out


@kernel
def fill_unknown_volumes(
    state: ByteArray, faces: ByteArray, low: IntArray, high: IntArray, asked: ByteArray, rows: ClusterRows
) -> None:
    """Compute unknown_volume() of the clusters in the marked blocks, into rows.beyond.

    asked: (blocks) 1 = marked.
    """
    start, cells, pool = rows.start, rows.cells, rows.pool
    for i in range(asked.shape[0]):
        for j in range(asked.shape[1]):
            row = rows.head[i, j] - 1 if asked[i, j] else -1
            while row >= 0:
                rows.beyond[row] = unknown_volume(state, faces, pool[start[row] : start[row] + cells[row]], low, high)
                row = rows.after[row] - 1


@kernel
def around(blocks: ByteArray, tiles: IntArray, tiles_a_block: int) -> ByteArray:
    """Add to the marked blocks those that hold or border on a tile of ``tiles`` (M, 2).

    This covers the range of DEPTH.
    """
    out = blocks.copy()
    for n in range(len(tiles)):
        for a in (tiles[n, 0] - 1, tiles[n, 0] + 1):
            for b in (tiles[n, 1] - 1, tiles[n, 1] + 1):
                i, j = max(a, 0) // tiles_a_block, max(b, 0) // tiles_a_block
                out[min(i, out.shape[0] - 1), min(j, out.shape[1] - 1)] = 1
    return out
