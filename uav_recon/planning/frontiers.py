"""Frontiers: known-free voxels beside unknown ones, in clusters small enough for one view (paper, section III-A; FUEL)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, UNKNOWN, GridSpec

MIN_CELLS = 8  # a smaller cluster is a speck on a surface or a sampling gap
MAX_EXTENT_M = 1.2  # along its first principal component: then one view from the shell holds it
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
