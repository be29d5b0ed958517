"""Incremental surface for the planner: the cost of a view is independent of the room size.

The room is divided into tiles of TILE³ evidence cells. A view marks the tiles around its end points as stale. refresh()
extracts the surface again in those, and in a few of the others, oldest first, because training changes the field everywhere.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.mapping.neural.surface.extraction import EVIDENCE_CELL_M, FILL_M, MIN_END_POINTS, MeasuredCells, extract
from uav_recon.mapping.neural.surface.uncertainty import SurfaceUncertainty
from uav_recon.types.frames import AnyArray, BoolArray, Float32Array, FloatArray, IntArray
from uav_recon.types.maps import SurfaceElements

TILE = 8  # evidence cells along a tile: 40 cm
MARGIN_M = FILL_M + EVIDENCE_CELL_M  # maximum distance from an end point at which it can create surface
OLD_SHARE = 0.05  # share of the tiles with surface that each refresh repeats because of their age


class IncrementalSurface:
    """Surface elements by tile. voxel_m: distance between the elements."""

    def __init__(self, evidence: MeasuredCells, voxel_m: float) -> None:
        self._evidence = evidence
        self._voxel_m = voxel_m
        self._tiles = tuple(-(-n // TILE) for n in evidence.count.shape)
        self._stale = np.zeros(self._tiles, dtype=np.bool_)
        self._done = np.zeros(self._tiles, dtype=np.int64)  # refresh at which a tile was last extracted, 0 = never
        self._refreshes = 0
        self._position = np.zeros((0, 3), dtype=np.float32)
        self._normal = np.zeros((0, 3), dtype=np.float32)
        self._uncertainty = np.zeros(0, dtype=np.float32)

    def touch(self, points: Float32Array) -> None:
        """Mark the tiles around measured end points (N, 3) as stale."""
        _touch(self._stale, self._evidence.origin_m, TILE * EVIDENCE_CELL_M, points, MARGIN_M)

    def refresh(self, field: NumbaSdfField, uncertainty: SurfaceUncertainty) -> None:
        """Extract the stale tiles and the oldest of the others."""
        self._refreshes += 1
        stale = self._stale | self._oldest()
        near = self._evidence.near_in(MIN_END_POINTS, _cells_of(stale, self._evidence.count.shape, self._halo_cells()))
        position, normal = extract(field, self._evidence, near, self._voxel_m)
        fresh = stale[self._tile_of(position)]
        position, normal = position[fresh], normal[fresh]
        agreed = ~self._evidence.contradicts(position, normal)
        position, normal = position[agreed], normal[agreed]
        keep = ~stale[self._tile_of(self._position)]
        self._position = np.concatenate([self._position[keep], position])
        self._normal = np.concatenate([self._normal[keep], normal])
        self._uncertainty = np.concatenate([self._uncertainty[keep], uncertainty.at(position)])
        self._done[stale] = self._refreshes
        self._stale[:] = False

    def elements(self, revision: int, map_epoch: int) -> SurfaceElements:
        """Return all elements, as of the last refresh()."""
        return SurfaceElements(
            self._position.astype(np.float64),
            self._normal.astype(np.float64),
            self._uncertainty.astype(np.float64),
            revision,
            map_epoch,
        )

    def _oldest(self) -> BoolArray:
        done = np.flatnonzero(self._done.ravel())
        count = int(np.ceil(OLD_SHARE * len(done)))
        oldest = np.zeros(self._done.size, dtype=np.bool_)
        oldest[done[np.argsort(self._done.ravel()[done], kind="stable")[:count]]] = True
        return oldest.reshape(self._tiles)

    def _halo_cells(self) -> int:
        """Return the number of cells around a tile that its vertices need.

        A vertex needs the nodes around it, which may lie in the next tile.
        """
        return int(np.ceil(self._voxel_m / EVIDENCE_CELL_M))

    def _tile_of(self, points: Float32Array) -> tuple[IntArray, ...]:
        scale = 1.0 / (TILE * EVIDENCE_CELL_M)
        tile = ((points - self._evidence.origin_m.astype(np.float32)) * np.float32(scale)).astype(np.int64)
        return tuple(np.clip(tile, 0, np.array(self._tiles) - 1).T)


def _cells_of(tiles: BoolArray, shape: tuple[int, ...], halo: int) -> BoolArray:
    """Return the evidence cells (nx, ny, nz) of some tiles and of ``halo`` cells around them."""
    out = np.zeros(shape, dtype=np.bool_)
    _mark_cells(tiles, halo, out)
    return out


@kernel
def _mark_cells(tiles: BoolArray, halo: int, out: BoolArray) -> None:
    nx, ny, nz = out.shape
    for a in range(tiles.shape[0]):
        for b in range(tiles.shape[1]):
            for c in range(tiles.shape[2]):
                if not tiles[a, b, c]:
                    continue
                for i in range(max(a * TILE - halo, 0), min((a + 1) * TILE + halo, nx)):
                    for j in range(max(b * TILE - halo, 0), min((b + 1) * TILE + halo, ny)):
                        for k in range(max(c * TILE - halo, 0), min((c + 1) * TILE + halo, nz)):
                            out[i, j, k] = True


@kernel
def _touch(stale: BoolArray, origin: FloatArray, tile_m: float, points: AnyArray, margin_m: float) -> None:
    nx, ny, nz = stale.shape
    for n in range(points.shape[0]):
        for corner in range(8):
            i = int(np.floor((points[n, 0] - origin[0] + (margin_m if corner & 4 else -margin_m)) / tile_m))
            j = int(np.floor((points[n, 1] - origin[1] + (margin_m if corner & 2 else -margin_m)) / tile_m))
            k = int(np.floor((points[n, 2] - origin[2] + (margin_m if corner & 1 else -margin_m)) / tile_m))
            if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
                stale[i, j, k] = True
