"""Surface elements for planning: thinned, with scaled uncertainty, grouped in cells."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import Float32Array, FloatArray, IntArray
from uav_recon.types.maps import GridSpec, SurfaceElements

CELL = 3.0  # voxels; elements in one cube of this edge with the same main normal direction form a cell
UNMODELLED_SIGMA = 2.0  # uncertainty of surface that no keyframe shows
RANKED_AT = 90  # percentile of the uncertainty that is scaled to 1
_FAR = 1 << 17  # voxels from the map's corner; elements farther away are ignored, and the number of their cube would overflow


@dataclass(frozen=True, slots=True, eq=False)
class Elements:
    """Thinned elements in voxel units, sorted by cell.

    position: (N, 3).
    normal: (N, 3) outward unit normals.
    sigma: (N,) uncertainty in 0..1.
    voxel: (N,) flat index, or -1 outside the grid.
    cells: (C, 3) int64, one row per cell: its first element, one past its last, and the one nearest to their mean.
    modelled: (M, 3) voxels of all elements before thinning, inside or outside the grid.
    """

    position: FloatArray
    normal: FloatArray
    sigma: FloatArray
    voxel: IntArray
    cells: IntArray
    modelled: IntArray

    @staticmethod
    def of(surface: SurfaceElements, grid: GridSpec, every: int) -> Elements:
        """Make elements of every N_down-th element; uncertainty is divided by its 90th percentile.

        The result is clipped to 1. The scale of the uncertainty is specific to the mapper and drifts during training, so
        only its ranking within this map is used.
        """
        shape = np.array(grid.shape, dtype=np.int64)
        everywhere = (surface.position_world - grid.origin_world_m) / grid.resolution_m
        position = np.asarray(everywhere[::every], dtype=np.float64)
        normal = np.asarray(surface.normal_world[::every], dtype=np.float64)
        sigma = np.asarray(surface.uncertainty[::every], dtype=np.float64)
        extent = np.abs(position[:, 0]) + np.abs(position[:, 1]) + np.abs(position[:, 2])
        # a comparison with NaN is false
        usable = (extent < _FAR) & np.isfinite(normal[:, 0] + normal[:, 1] + normal[:, 2] + sigma)
        if not usable.all():
            position, normal, sigma = position[usable], normal[usable], sigma[usable]
        sigma = np.maximum(sigma, 0.0)
        if len(sigma):
            scale = float(np.percentile(sigma, RANKED_AT)) or float(sigma.max()) or 1.0
            sigma = np.minimum(sigma / scale, 1.0)
        voxel = _voxel_of(np.ascontiguousarray(position), shape)
        order, cells = _gathered(position, normal)
        return Elements(
            np.ascontiguousarray(position[order]),
            np.ascontiguousarray(normal[order]),
            np.ascontiguousarray(sigma[order]),
            np.ascontiguousarray(voxel[order]),
            cells,
            _floors(np.ascontiguousarray(everywhere, dtype=np.float64)),
        )

    def with_unmodelled(self, position: FloatArray, normal: FloatArray, grid: GridSpec) -> Elements:
        """Add surface that the model does not contain, with the largest uncertainty.

        position, normal: (N, 3) positions and normals, in voxels.
        """
        if not len(position):
            return self
        order, cells = _gathered(position, normal)
        position, normal = np.ascontiguousarray(position[order]), np.ascontiguousarray(normal[order])
        return Elements(
            np.concatenate([self.position, position]),
            np.concatenate([self.normal, normal]),
            np.concatenate([self.sigma, np.full(len(position), UNMODELLED_SIGMA)]),
            np.concatenate([self.voxel, _voxel_of(position, np.array(grid.shape, dtype=np.int64))]),
            np.concatenate([self.cells, cells + len(self.position)]),
            self.modelled,
        )


class ElementsCache:
    """Caches the elements of the last surface, so that it is sorted once."""

    def __init__(self, every: int) -> None:
        """Create an empty cache. every: N_down."""
        self._every = every
        self._kept: tuple[SurfaceElements, tuple[object, ...], Elements] | None = None

    def of(self, surface: SurfaceElements, grid: GridSpec) -> Elements:
        """Return the thinned elements in cells, in voxels of a grid."""
        frame = (grid.shape, grid.resolution_m, *grid.origin_world_m.tolist())
        if self._kept is None or self._kept[0] is not surface or self._kept[1] != frame:
            self._kept = surface, frame, Elements.of(surface, grid, self._every)
        return self._kept[2]


def within(elements: Elements, centre: FloatArray, radius: float) -> IntArray:
    """Return the cells (C, 3) with a middle element within a radius of a point, in voxels."""
    away = elements.position[elements.cells[:, 2]] - centre
    inside: IntArray = elements.cells[(away**2).sum(axis=1) <= radius**2]
    return inside


def max_cosine_per_voxel(voxel: IntArray, cosine: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return each voxel (>= 0) once, with the largest cosine of its elements."""
    order = np.lexsort((-cosine, voxel))
    order = order[voxel[order] >= 0]
    once = order[np.flatnonzero(np.diff(voxel[order], prepend=-1))]
    return voxel[once], cosine[once]


def _gathered(position: FloatArray, normal: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the order (N,) of the elements by cell, and the cells (C, 3) in that order."""
    if not len(position):
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3), dtype=np.int64)
    axis = np.argmax(np.abs(normal), axis=1)
    side = np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] > 0
    cube = np.floor(position / CELL).astype(np.int64) + _FAR
    key = ((cube[:, 0] * 2 * _FAR + cube[:, 1]) * 2 * _FAR + cube[:, 2]) * 6 + axis * 2 + side
    order = np.argsort(key, kind="stable")
    key = key[order]
    borders = np.append(np.flatnonzero(np.diff(key, prepend=key[0] - 1)), len(key))
    return order, _cells(np.ascontiguousarray(position[order]), borders)


@kernel
def _cells(position: FloatArray, borders: IntArray) -> IntArray:
    out = np.empty((len(borders) - 1, 3), dtype=np.int64)
    for c in range(len(out)):
        first, last = borders[c], borders[c + 1]
        x, y, z = position[first:last, 0].mean(), position[first:last, 1].mean(), position[first:last, 2].mean()
        nearest = np.inf
        out[c, 0], out[c, 1], out[c, 2] = first, last, first
        for n in range(first, last):
            away2 = (position[n, 0] - x) ** 2 + (position[n, 1] - y) ** 2 + (position[n, 2] - z) ** 2
            if away2 < nearest:
                nearest = away2
                out[c, 2] = n
    return out


@kernel
def _floors(position: FloatArray) -> IntArray:
    """Return the voxels (N, 3) of positions (N, 3).

    A coordinate that is NaN or very far becomes -_FAR, which is outside every grid.
    """
    out = np.full(position.shape, -_FAR, dtype=np.int64)
    for n in range(len(position)):
        for axis in range(3):
            if abs(position[n, axis]) < _FAR:
                out[n, axis] = math.floor(position[n, axis])
    return out


@kernel
def _voxel_of(position: FloatArray, shape: IntArray) -> IntArray:
    out = np.full(len(position), -1, dtype=np.int64)
    for n in range(len(position)):
        x, y, z = position[n, 0], position[n, 1], position[n, 2]
        if x >= 0.0 and y >= 0.0 and z >= 0.0 and x < shape[0] and y < shape[1] and z < shape[2]:
            out[n] = (int(x) * shape[1] + int(y)) * shape[2] + int(z)
    return out


@kernel
def element_weights(
    cells: IntArray, sigma: FloatArray, voxel: IntArray, cosine_sums: Float32Array, discount: float
) -> FloatArray:
    """Return weights (N,) of the elements of some cells; 0 for other elements.

    A weight is sigma times ``discount`` to the power of the sum of cosines of earlier views.

    cosine_sums: (voxels,) flat, the sum of the cosines under which the surface of a voxel was seen.
    """
    out = np.zeros(len(sigma))
    for c in range(len(cells)):
        for n in range(cells[c, 0], cells[c, 1]):
            cosine_sum = cosine_sums[voxel[n]] if voxel[n] >= 0 else 0.0
            out[n] = sigma[n] * discount**cosine_sum if cosine_sum > 0.0 else sigma[n]
    return out
