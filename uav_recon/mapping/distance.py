"""Exact Euclidean distance from every voxel to the nearest one that is not known free, capped."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, ByteArray
from uav_recon.types.maps import FREE, LARGEST_DISTANCE_VOXELS


@kernel
def _squared_distance(state: AnyArray, reach: int, out: AnyArray, plane: AnyArray) -> None:
    """Squared distance in voxels, (nx, ny, nz) uint16, exact below ``reach`` and ``reach**2`` from there on.

    Separable: two scans along z, then windowed minima along y and x (Saito and Toriwaki 1994: D(p) = min over q of
    D(q) + (p - q)²); the window is the cap, so there is no need for parabola envelopes. The inner loops run along
    contiguous memory. Outside the grid counts as not free.
    """
    nx, ny, nz = state.shape
    cap = np.uint16(reach * reach)
    for x in range(nx):
        for y in range(ny):
            run = 0
            for z in range(nz):
                run = 0 if state[x, y, z] != FREE else min(run + 1, reach)
                out[x, y, z] = np.uint16(run)
            run = 0
            for z in range(nz - 1, -1, -1):
                run = 0 if out[x, y, z] == 0 else min(run + 1, reach)
                nearest = min(run, int(out[x, y, z]))
                out[x, y, z] = np.uint16(nearest * nearest)
    for x in range(nx):
        for y in range(ny):
            border = min(y + 1, ny - y)
            row = plane[y]
            best = np.uint16(min(border * border, reach * reach))
            own = out[x, y]
            for z in range(nz):
                row[z] = min(own[z], best)
            for other in range(max(0, y - reach + 1), min(ny, y + reach)):
                step = np.uint16((other - y) * (other - y))
                source = out[x, other]
                for z in range(nz):
                    row[z] = min(row[z], np.uint16(source[z] + step))
        for y in range(ny):
            for z in range(nz):
                out[x, y, z] = min(plane[y, z], cap)


@kernel
def _sweep_x(squared: AnyArray, reach: int, row: AnyArray, distance2: AnyArray) -> None:
    """Last pass along x."""
    nx, ny, nz = squared.shape
    for x in range(nx):
        border = min(x + 1, nx - x)
        best = np.uint16(min(border * border, reach * reach))
        for y in range(ny):
            own = squared[x, y]
            for z in range(nz):
                row[z] = min(own[z], best)
            for other in range(max(0, x - reach + 1), min(nx, x + reach)):
                step = np.uint16((other - x) * (other - x))
                source = squared[other, y]
                for z in range(nz):
                    row[z] = min(row[z], np.uint16(source[z] + step))
            target = distance2[x, y]
            for z in range(nz):
                target[z] = np.uint8(row[z])


def distance2_to_not_free(state: ByteArray, reach: int) -> ByteArray:
    """SQUARED distance in voxels from each voxel's centre to the centre of the nearest voxel that is not FREE.

    state: (nx, ny, nz) uint8. Returns (nx, ny, nz) uint8, exact below reach² and reach² from there on; 0 in voxels that are
    not free. Voxels outside the grid are not free. reach: at most LARGEST_DISTANCE_VOXELS, else ValueError.
    """
    if not 0 < reach <= LARGEST_DISTANCE_VOXELS:
        raise ValueError(f"reach {reach}: want 1 to {LARGEST_DISTANCE_VOXELS} voxels")
    squared = np.empty(state.shape, dtype=np.uint16)
    distance2 = np.empty(state.shape, dtype=np.uint8)
    _squared_distance(state, reach, squared, np.empty(state.shape[1:], dtype=np.uint16))
    _sweep_x(squared, reach, np.empty(state.shape[2], dtype=np.uint16), distance2)
    return distance2


def warm_up() -> None:
    """Compile the kernels."""
    distance2_to_not_free(np.full((3, 3, 3), FREE, dtype=np.uint8), 3)
