"""Frontiers: free voxels beside unknown ones, in clusters that fit in one view.

Paper, section III-A; FUEL.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_recon.planning.frontier.cluster_table import OPENING, ClusterTable
from uav_recon.planning.frontier.clustering import BLOCK, MAX_EXTENT_M, scan
from uav_recon.planning.frontier.unknown_volume import around, unknown_volume_of_each
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import TILE, GridSpec, VoxelMap

FACES = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Frontier:
    """One frontier cluster.

    cells: (N, 3) int64 voxel indices.
    faces: (N,) uint8, bit f set = the voxel at cells + FACES[f] is unknown.
    """

    cells: IntArray
    faces: ByteArray


def fence_box(grid: GridSpec, fence_min_m: FloatArray, fence_max_m: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the first and one-past-last voxel index (3,) with centres inside a box in world.

    The indices are clipped to the grid.
    """
    low = np.ceil((fence_min_m - grid.origin_world_m) / grid.resolution_m - 0.5 - 1e-6).astype(np.int64)
    high = np.floor((fence_max_m - grid.origin_world_m) / grid.resolution_m - 0.5 + 1e-6).astype(np.int64) + 1
    shape = np.array(grid.shape, dtype=np.int64)
    return np.clip(low, 0, shape), np.clip(high, 0, shape)


class Frontiers:
    """The frontier clusters of a growing map, updated only where the map changed.

    The clusters equal those of a new object with the same map, box and ignored voxels. A cluster is a row of ``table``; its
    key is the same while its cells and their unknown neighbours are the same. A map of another epoch, grid or box clears
    everything.
    """

    def __init__(self) -> None:
        self._frame: tuple[object, ...] = ()
        self._revision = -1
        self._start(np.zeros(3, dtype=np.int64), np.zeros(3, dtype=np.int64), (0, 0, 0))

    def update(self, voxels: VoxelMap, low: IntArray, high: IntArray, ignored: ByteArray) -> None:
        """Update the clusters to a newer map.

        Only frontier cells and unknown neighbours in voxels [low, high) count.

        ignored: (nx, ny, nz) uint8, 1 = exhausted, not a frontier. Changes of it must be reported through ``touch``.
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
            self.table.cluster_again(self.faces, ignored, blocks, MAX_EXTENT_M / grid.resolution_m)
        self.table.update_unknown_volumes(voxels.state, self.faces, self._low, self._high, asked)

    def mark_changed(self, flat: IntArray) -> None:
        """Report voxels (N,) of ``ignored`` that changed. They take effect in the next update."""
        _, ny, nz = self.faces.shape
        self._dirty[flat // (ny * nz) // BLOCK, flat // nz % ny // BLOCK] = 1

    def __len__(self) -> int:
        return self.table.size()

    @property
    def openings(self) -> int:
        """Return the number of clusters with unknown space beyond them.

        The others are gaps in front of a wall.
        """
        return int(np.count_nonzero(self.table.rows.beyond[self.rows()] >= OPENING))

    def rows(self) -> IntArray:
        """Return the rows of the table that hold a cluster, in no particular order."""
        return np.flatnonzero((self.table.rows.cells > 0) & (self.table.rows.speck == 0))

    def clusters(self) -> list[Frontier]:
        """Return all clusters, in no particular order."""
        return [self.cluster(int(row)) for row in self.rows()]

    def cluster(self, row: int) -> Frontier:
        """Return the cluster in one row of the table."""
        flat = self.flat(row)
        cells = np.stack(np.unravel_index(flat, self.faces.shape), axis=-1).astype(np.int64)
        return Frontier(cells, self.faces.reshape(-1)[flat])

    def flat(self, row: int) -> IntArray:
        """Return a copy of the flat cell indices (N,) of one row of the table, ascending."""
        start = self.table.rows.start[row]
        return self.table.rows.pool[start : start + self.table.rows.cells[row]].copy()

    def unknown_beyond(self, voxels: VoxelMap, cell_sets: Sequence[IntArray]) -> IntArray:
        """Return the number of unknown voxels (N,) behind each of N sets of frontier cells.

        See unknown_volume.py.

        cell_sets: flat indices of the cells of each set.
        """
        ends = np.cumsum([0, *(len(cells) for cells in cell_sets)])
        cells = np.concatenate([np.zeros(0, dtype=np.int64), *cell_sets])
        counts: IntArray = unknown_volume_of_each(voxels.state, self.faces, cells, ends, self._low, self._high)
        return counts

    def _start(self, low: IntArray, high: IntArray, shape: tuple[int, int, int]) -> None:
        """Clear everything.

        Sets faces, (nx, ny, nz) uint8 as Frontier.faces, and closed, (tiles), see clustering.scan().
        """
        self._low = np.array(low, dtype=np.int64)
        self._high = np.array(high, dtype=np.int64)
        self._revision = -1
        self._known = np.zeros((shape[0] + 2) * shape[1] * shape[2], dtype=np.uint8)
        self.faces = np.zeros(shape, dtype=np.uint8)
        self.closed = np.full((-(-shape[0] // TILE), -(-shape[1] // TILE)), -1, dtype=np.int64)
        self.table = ClusterTable(shape)
        self._dirty = np.zeros(self.table.rows.head.shape, dtype=np.uint8)
