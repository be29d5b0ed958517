"""Pool of map snapshots: a buffer is reused once its snapshot is no longer referenced."""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.occupancy.distance_field import CHUNK
from uav_recon.types.frames import AnyArray, ByteArray, IntArray
from uav_recon.types.maps import EUCLIDEAN, TILE, GridSpec, HeightMeasure, VoxelMap


class SnapshotBuffer:
    """State and squared distance of a whole map at one revision (flat uint8).

    A new buffer is all unknown.
    """

    def __init__(self, size: int, revision: int) -> None:
        self.memory = np.zeros(2 * size + CHUNK, dtype=np.uint8)  # untouched zero pages use no physical memory
        self.state: ByteArray = self.memory[:size]
        self.distance2: ByteArray = self.memory[size:]
        self.revision = revision
        self.shown = False


class SnapshotPool:
    """The buffer that is being written, and those with a published snapshot.

    One owner writes; snapshots may be released in any thread.
    """

    def __init__(self, grid: GridSpec, revision: int, heights: HeightMeasure = EUCLIDEAN) -> None:
        """Start with one buffer, all unknown, at a revision. heights: see VoxelMap."""
        self._heights = heights
        self._grid = grid
        self._blank_revision = revision
        self._size = int(np.prod(grid.shape))
        self.current = SnapshotBuffer(self._size, revision)
        self._canvases = [self.current]

    def writable_buffer(self, tile_revision: IntArray) -> SnapshotBuffer:
        """Return the buffer to write to, with the current content.

        If the current buffer has a snapshot in use, this is another buffer with the same content. tile_revision: that of the
        current buffer. Only the tiles that changed since the other buffer was last written are copied.
        """
        if self.current.shown:
            shown, self.current = self.current, self._free()
            _copy_changed_tiles(shown.memory, self._grid.shape, tile_revision, self.current.revision, self.current.memory)
            self.current.revision = shown.revision
        return self.current

    def show(self, tile_revision: IntArray, revision: int, map_epoch: int) -> VoxelMap:
        """Return a snapshot of the current buffer.

        The buffer is not written while any array of the snapshot is referenced.
        """
        canvas = self.current
        canvas.revision, canvas.shown = revision, True
        view = np.asarray(_BufferOwner(canvas, (2, *self._grid.shape)))
        dated = tile_revision.copy()
        dated.setflags(write=False)
        return VoxelMap(self._grid, view[0], view[1], dated, revision, map_epoch, self._heights)

    def _free(self) -> SnapshotBuffer:
        """Return the newest buffer without a snapshot in use, or a blank one.

        Of the older free buffers all but one are dropped.
        """
        free = sorted((canvas for canvas in self._canvases if not canvas.shown), key=lambda canvas: canvas.revision)
        chosen = free[-1] if free else SnapshotBuffer(self._size, self._blank_revision)
        self._canvases = [canvas for canvas in self._canvases if canvas.shown] + free[-2:-1] + [chosen]
        return chosen


class _BufferOwner:
    """Owner of the arrays of a snapshot.

    numpy keeps it alive as the base of the arrays, also of views of views. Its finalizer releases the buffer.
    """

    def __init__(self, canvas: SnapshotBuffer, shape: tuple[int, ...]) -> None:
        address = canvas.memory.__array_interface__["data"][0]
        self.__array_interface__: dict[str, Any] = {"version": 3, "typestr": "|u1", "shape": shape, "data": (address, True)}
        weakref.finalize(self, _take_back, canvas).atexit = False


def _take_back(canvas: SnapshotBuffer) -> None:
    canvas.shown = False


@kernel
def _copy_changed_tiles(
    source: AnyArray, shape: tuple[int, int, int], tile_revision: AnyArray, revision: int, target: AnyArray
) -> None:
    """Copy both layers of the tiles that changed after a revision."""
    nx, ny, nz = shape
    for a in range(tile_revision.shape[0]):
        dated = tile_revision[a]
        for b in range(tile_revision.shape[1]):
            if dated[b] <= revision:
                continue
            low, size = TILE * b * nz, (min(TILE * b + TILE, ny) - TILE * b) * nz
            for x in range(TILE * a, min(TILE * a + TILE, nx)):
                for layer in range(2):
                    base = (layer * nx + x) * ny * nz + low
                    ours, theirs = target[base : base + size], source[base : base + size]
                    for n in range(size):
                        ours[n] = theirs[n]
