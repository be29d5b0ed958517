"""Frontiers: known-free voxels beside unknown ones, in clusters small enough for one view (paper, section III-A; FUEL)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from uav_recon.geometry.jit import kernel
from uav_recon.planning.cluster_table import ClusterTable
from uav_recon.planning.clusters import BLOCK, MAX_EXTENT_M, MIN_CELLS, scan
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, TILE, UNKNOWN, GridSpec, VoxelMap

_AROUND = np.ones((3, 3, 3), dtype=np.uint8)
FACES = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Frontier:
    """One cluster. cells (N, 3) int64 voxel indices; faces (N,) uint8, bit f set = the voxel at cells + FACES[f] is unknown."""

    cells: IntArray
    faces: ByteArray

    def centre_voxels(self) -> FloatArray:
        """Mean of the cells' centres, (3,) in voxel units."""
        centre: FloatArray = self.cells.mean(axis=0) + 0.5
        return centre


@dataclass(frozen=True, slots=True, eq=False)
class FrontierCensus:
    """Clusters worth a view, and how many were left out: too small, or looked at in vain."""

    frontiers: tuple[Frontier, ...]
    too_small: int
    exhausted: int


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
        blocks = np.argwhere(self._dirty)
        if len(blocks):
            self._dirty[:] = 0
            self.table.cut_again(self.faces, ignored, blocks, MAX_EXTENT_M / grid.resolution_m)

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

    def _start(self, low: IntArray, high: IntArray, shape: tuple[int, int, int]) -> None:
        """Forget all; faces: (nx, ny, nz) uint8 as Frontier.faces; closed: (tiles), see clusters.scan()."""
        self._low, self._high = np.array(low, dtype=np.int64), np.array(high, dtype=np.int64)
        self._revision = -1
        self._known = np.zeros((shape[0] + 2) * shape[1] * shape[2], dtype=np.uint8)
        self.faces = np.zeros(shape, dtype=np.uint8)
        self.closed = np.full((-(-shape[0] // TILE), -(-shape[1] // TILE)), -1, dtype=np.int64)
        self.table = ClusterTable(shape)
        self._dirty = np.zeros(self.table.head.shape, dtype=np.uint8)


@kernel
def unknown_faces(state: ByteArray, low: IntArray, high: IntArray) -> ByteArray:
    """Bits of the unknown face neighbours of each free voxel; voxels and neighbours both in [low, high). (nx, ny, nz) uint8."""
    out = np.zeros(state.shape, dtype=np.uint8)
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            for k in range(low[2], high[2]):
                if state[i, j, k] != FREE:
                    continue
                bits = 0
                if i > low[0] and state[i - 1, j, k] == UNKNOWN:
                    bits |= 1
                if i + 1 < high[0] and state[i + 1, j, k] == UNKNOWN:
                    bits |= 2
                if j > low[1] and state[i, j - 1, k] == UNKNOWN:
                    bits |= 4
                if j + 1 < high[1] and state[i, j + 1, k] == UNKNOWN:
                    bits |= 8
                if k > low[2] and state[i, j, k - 1] == UNKNOWN:
                    bits |= 16
                if k + 1 < high[2] and state[i, j, k + 1] == UNKNOWN:
                    bits |= 32
                out[i, j, k] = bits
    return out


def find_frontiers(faces: ByteArray, exhausted: BoolArray, resolution_m: float) -> FrontierCensus:
    """Cluster the frontier voxels of ``unknown_faces``, leaving out those that ``exhausted`` (nx, ny, nz) marks."""
    frontiers: list[Frontier] = []
    too_small = 0
    for cells in connected_cells((faces > 0) & ~exhausted):
        if len(cells) < MIN_CELLS:
            too_small += 1
            continue
        for part in split(cells, MAX_EXTENT_M / resolution_m):
            frontiers.append(Frontier(part, faces[part[:, 0], part[:, 1], part[:, 2]]))
    in_vain = sum(len(cells) >= MIN_CELLS for cells in connected_cells((faces > 0) & exhausted))
    return FrontierCensus(tuple(frontiers), too_small, in_vain)


def count_outside(state: ByteArray, faces: ByteArray) -> int:
    """How many clusters exist only because of unknown space beyond the fence."""
    whole = unknown_faces(state, np.zeros(3, dtype=np.int64), np.array(state.shape, dtype=np.int64))
    return sum(len(cells) >= MIN_CELLS for cells in connected_cells((whole > 0) & (faces == 0)))


def connected_cells(mask: BoolArray) -> list[IntArray]:
    """Voxel indices (N, 3) of each 26-connected component, in scan order."""
    labels, count = ndimage.label(mask, structure=_AROUND)
    cells = np.argwhere(mask)
    label_of = labels[cells[:, 0], cells[:, 1], cells[:, 2]]
    order = np.argsort(label_of, kind="stable")
    borders = np.searchsorted(label_of[order], np.arange(2, count + 1))
    return [part for part in np.split(cells[order], borders) if len(part)]


def split(cells: IntArray, max_extent: float) -> list[IntArray]:
    """Halve along the first principal component (3-D) until no part is longer than ``max_extent`` voxels along its own."""
    along = _along_main_axis(cells)
    if float(along.max() - along.min()) <= max_extent:
        return [cells]
    # an axis has no sign of its own: the half that holds the first cell comes first
    first = (along > 0) == (along[0] > 0)
    return split(cells[first], max_extent) + split(cells[~first], max_extent)


@kernel
def _along_main_axis(cells: IntArray) -> FloatArray:
    """Coordinate (N,) of each cell along the first principal component, from the mean."""
    offsets = cells.astype(np.float64)
    for axis in range(3):
        offsets[:, axis] -= offsets[:, axis].mean()
    covariance = np.zeros((3, 3))
    for n in range(len(offsets)):
        for a in range(3):
            for b in range(3):
                covariance[a, b] += offsets[n, a] * offsets[n, b]
    _, axes = np.linalg.eigh(covariance)
    along: FloatArray = offsets @ axes[:, 2].copy()
    return along
