"""Frontiers: known-free voxels beside unknown ones, in clusters small enough for one view (paper, section III-A; FUEL)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_recon.planning.frontier.cluster_table import ClusterTable
from uav_recon.planning.frontier.clustering import BLOCK, MAX_EXTENT_M, scan
from uav_recon.planning.frontier.unknown_volume import around, unknown_volume_of_each
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import TILE, GridSpec, VoxelMap

FACES = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Frontier:
    """One cluster. cells (N, 3) int64 voxel indices; faces (N,) uint8, bit f set = the voxel at cells + FACES[f] is unknown."""

    cells: IntArray
    faces: ByteArray


def fence_box(grid: GridSpec, fence_min_m: FloatArray, fence_max_m: FloatArray) -> tuple[IntArray, IntArray]:
    """First and one-past-last voxel index (3,) whose centres lie inside a box in world, clipped to the grid."""
    low = np.ceil((fence_min_m - grid.origin_world_m) / grid.resolution_m - 0.5 - 1e-6).astype(np.int64)
    high = np.floor((fence_max_m - grid.origin_world_m) / grid.resolution_m - 0.5 + 1e-6).astype(np.int64) + 1
    shape = np.array(grid.shape, dtype=np.int64)
    return np.clip(low, 0, shape), np.clip(high, 0, shape)


class Frontiers:
    """The frontier clusters of a map as it grows; only what changed is looked at again.

    They equal those of a fresh object given the same map, box and ignored voxels. A cluster is a row of ``table``; its key is
    the same as long as its cells and their unknown neighbours are. A map of another epoch, grid or box starts afresh.
    """

    def __init__(self) -> None:
        self._frame: tuple[object, ...] = ()
        self._revision = -1
        self._start(np.zeros(3, dtype=np.int64), np.zeros(3, dtype=np.int64), (0, 0, 0))

    def update(self, voxels: VoxelMap, low: IntArray, high: IntArray, ignored: ByteArray) -> None:
        """Follow the map. Frontier cells and their unknown neighbours lie in voxels [low, high).

        ignored: (nx, ny, nz) uint8, 1 = looked at in vain, no frontier; what changes in it is told by ``touch``.
        """
        grid = voxels.grid
        frame = (voxels.map_epoch, grid.shape, grid.resolution_m, *grid.origin_world_m.tolist(), *low.tolist(), *high.tolist())
        if frame != self._frame or voxels.revision < self._revision:
            self._start(low, high, grid.shape)
            self._frame = frame
        tiles = voxels.changed_tiles(self._revision)
        self._revision = voxels.revision
        scan(voxels.state, self._known, self.faces, self._low, self._high, tiles, voxels.revision, self.closed, self._dirty)
        blocks = np.ascontiguousarray(np.argwhere(self._dirty))  # of one block it is C-ordered, of several F-ordered
        asked = around(self._dirty, tiles, BLOCK // TILE)
        if len(blocks):
            self._dirty[:] = 0
            self.table.cut_again(self.faces, ignored, blocks, MAX_EXTENT_M / grid.resolution_m)
        self.table.weigh(voxels.state, self.faces, self._low, self._high, asked)

    def touch(self, flat: IntArray) -> None:
        """Tell which voxels (N,) of ``ignored`` have changed: they count from the next update on."""
        _, ny, nz = self.faces.shape
        self._dirty[flat // (ny * nz) // BLOCK, flat // nz % ny // BLOCK] = 1

    def __len__(self) -> int:
        return int(self.table.size)

    def rows(self) -> IntArray:
        """Rows of the table that hold a cluster, in no order of their own."""
        return np.flatnonzero((self.table.count > 0) & (self.table.speck == 0))

    def clusters(self) -> list[Frontier]:
        """All of them, in no order of their own."""
        return [self.cluster(int(row)) for row in self.rows()]

    def cluster(self, row: int) -> Frontier:
        """The cells of one row of the table."""
        flat = self.flat(row)
        cells = np.stack(np.unravel_index(flat, self.faces.shape), axis=-1).astype(np.int64)
        return Frontier(cells, self.faces.reshape(-1)[flat])

    def flat(self, row: int) -> IntArray:
        """Flat indices (N,) of the cells of one row of the table, ascending; a copy."""
        start = self.table.start[row]
        return self.table.pool[start : start + self.table.count[row]].copy()

    def beyond(self, voxels: VoxelMap, promised: Sequence[IntArray]) -> IntArray:
        """Unknown voxels (N,) behind each of N sets of frontier cells, flat indices; see beyond.py."""
        ends = np.cumsum([0, *(len(cells) for cells in promised)])
        cells = np.concatenate([np.zeros(0, dtype=np.int64), *promised])
        counts: IntArray = unknown_volume_of_each(voxels.state, self.faces, cells, ends, self._low, self._high)
        return counts

    def _start(self, low: IntArray, high: IntArray, shape: tuple[int, int, int]) -> None:
        """Forget all; faces: (nx, ny, nz) uint8 as Frontier.faces; closed: (tiles), see clusters.scan()."""
        self._low, self._high = np.array(low, dtype=np.int64), np.array(high, dtype=np.int64)
        self._revision = -1
        self._known = np.zeros((shape[0] + 2) * shape[1] * shape[2], dtype=np.uint8)
        self.faces = np.zeros(shape, dtype=np.uint8)
        self.closed = np.full((-(-shape[0] // TILE), -(-shape[1] // TILE)), -1, dtype=np.int64)
        self.table = ClusterTable(shape)
        self._dirty = np.zeros(self.table.head.shape, dtype=np.uint8)
