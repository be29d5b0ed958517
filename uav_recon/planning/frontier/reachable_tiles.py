"""Tiles with a reachable voxel: a cluster far from all of them needs no view search."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import TILE


class ReachableInterface(Protocol):
    """The part of the flyable space used here; see FlyableSpace."""

    @property
    def reachable(self) -> ByteArray:
        """Return the mask (nx + 2, ny + 2, nz + 2) uint8, padded by zeros: 1 = reachable."""

    @property
    def revision(self) -> int:
        """Return a number that increases with each change of ``reachable``."""

    @property
    def reachable_revision(self) -> IntArray:
        """Return the revision (tiles) at which ``reachable`` last changed in a tile.

        A tile is TILE x TILE columns.
        """


class ReachableTiles:
    """Tiles of columns that contain a reachable voxel, updated only where the space changed."""

    def __init__(self) -> None:
        self._space: ReachableInterface | None = None
        self._seen = -1
        self._tiles: BoolArray = np.zeros((0, 0), dtype=np.bool_)

    def update(self, space: ReachableInterface) -> None:
        """Update the tiles to a space; a different space is read from the beginning."""
        if space is not self._space or space.revision < self._seen:
            self._space = space
            self._seen = -1
            self._tiles = np.zeros(space.reachable_revision.shape, dtype=np.bool_)
        _renew(space.reachable, space.reachable_revision, self._seen, self._tiles)
        self._seen = space.revision

    def near(self, centres: FloatArray, radius: float) -> BoolArray:
        """Return a mask (N,) of the positions (N, 3), in voxels, with a reachable tile nearby.

        Nearby means within ``radius`` along both horizontal axes.
        """
        near: BoolArray = _near(self._tiles, centres, radius)
        return near


@kernel
def _any_in(reachable: ByteArray, a: int, b: int) -> bool:
    nx, ny, nz = reachable.shape
    for i in range(a * TILE + 1, min(a * TILE + TILE, nx - 2) + 1):
        for j in range(b * TILE + 1, min(b * TILE + TILE, ny - 2) + 1):
            for k in range(1, nz - 1):
                if reachable[i, j, k] != 0:
                    return True
    return False


@kernel
def _renew(reachable: ByteArray, changed: IntArray, since: int, tiles: BoolArray) -> None:
    for a in range(tiles.shape[0]):
        for b in range(tiles.shape[1]):
            if changed[a, b] > since:
                tiles[a, b] = _any_in(reachable, a, b)


@kernel
def _any_near(tiles: BoolArray, x: float, y: float, radius: float) -> bool:
    first_a, last_a = int(max(x - radius, 0.0)) // TILE, min(int(max(x + radius, 0.0)) // TILE, tiles.shape[0] - 1)
    first_b, last_b = int(max(y - radius, 0.0)) // TILE, min(int(max(y + radius, 0.0)) // TILE, tiles.shape[1] - 1)
    for a in range(first_a, last_a + 1):
        for b in range(first_b, last_b + 1):
            if tiles[a, b]:
                return True
    return False


@kernel
def _near(tiles: BoolArray, centres: FloatArray, radius: float) -> BoolArray:
    out = np.zeros(len(centres), dtype=np.bool_)
    for n in range(len(centres)):
        out[n] = _any_near(tiles, centres[n, 0], centres[n, 1], radius)
    return out
