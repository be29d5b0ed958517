"""Where the body may be, and the way out when it stands where it may not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.planning.search import chain, distances_from
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, GridSpec, VoxelMap

ESCAPE_LIMIT_M = 2.0  # a way out longer than this is no way out


@dataclass(frozen=True, slots=True, eq=False)
class FlyableSpace:
    """Voxels in which the body's centre may be.

    mask: (nx+2, ny+2, nz+2) uint8, 1 = flyable, with a border of zeros, so that a search never asks for bounds.
    free: the same for known-free voxels. Positions in kernels are in PADDED voxel units: (p - origin) / resolution + 1.
    """

    grid: GridSpec
    mask: ByteArray
    free: ByteArray

    @staticmethod
    def of(voxels: VoxelMap, clearance_m: float, low: IntArray, high: IntArray) -> FlyableSpace:
        """Free voxels far enough from all that is not, with indices in [low, high).

        Half a voxel is added: the field measures to a voxel's centre, and an obstacle may reach to its near face.
        """
        needed2 = (clearance_m / voxels.grid.resolution_m + 0.5 - 1e-3) ** 2
        inside = np.zeros(voxels.state.shape, dtype=np.bool_)
        inside[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = True
        free = voxels.state == FREE
        return FlyableSpace(voxels.grid, _padded(free & inside & (voxels.distance2 >= needed2)), _padded(free))

    def padded(self, points_world: FloatArray) -> FloatArray:
        """World (3,) or (N, 3) to padded voxel units."""
        out: FloatArray = (points_world - self.grid.origin_world_m) / self.grid.resolution_m + 1.0
        return out

    def world(self, points_padded: FloatArray) -> FloatArray:
        """Padded voxel units to world."""
        out: FloatArray = (points_padded - 1.0) * self.grid.resolution_m + self.grid.origin_world_m
        return out

    def flat(self, cell_padded: IntArray) -> int:
        """Flat index of a padded cell (3,), clipped to the border when it lies outside."""
        cell = np.clip(cell_padded, 0, np.array(self.mask.shape) - 1)
        return int(np.ravel_multi_index((int(cell[0]), int(cell[1]), int(cell[2])), self.mask.shape))

    def centre(self, flat: IntArray) -> FloatArray:
        """Centres in padded voxel units of flat indices: (N,) to (N, 3)."""
        centre: FloatArray = np.stack(np.unravel_index(flat, self.mask.shape), axis=-1) + np.float64(0.5)
        return centre


def way_out(space: FlyableSpace, position_world: FloatArray) -> IntArray | None:
    """Flat cells from the vehicle's own cell to the nearest flyable one, both included; one cell where it may fly already.

    Just after take-off, or when the map has changed, the vehicle may stand where it may not fly: it leaves through
    known-free cells alone (its own is exempt). None if there is no such way within ESCAPE_LIMIT_M.
    """
    start = space.flat(np.floor(space.padded(position_world)).astype(np.int64))
    if space.mask.ravel()[start]:
        return np.array([start], dtype=np.int64)
    passable = space.free.copy()
    passable.ravel()[start] = 1
    passable[[0, -1]] = 0
    passable[:, [0, -1]] = 0
    passable[:, :, [0, -1]] = 0
    if not passable.ravel()[start]:
        return None
    limit = ESCAPE_LIMIT_M / space.grid.resolution_m
    distance, previous = distances_from(passable, start, np.zeros(0, dtype=np.int64), limit)
    reachable = np.flatnonzero(space.mask.ravel() & np.isfinite(distance))
    if not len(reachable):
        return None
    return chain(previous, int(reachable[np.argmin(distance[reachable])]))


def _padded(mask: BoolArray) -> ByteArray:
    return np.ascontiguousarray(np.pad(mask, 1).astype(np.uint8))
