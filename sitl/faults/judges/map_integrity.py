"""Checks that the map keeps the true occupied voxels that it held before a fault."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.faults.injectors.base import Capabilities, InjectionContext, Injector

FREED = "known occupied freed"
CLAIMED = "voxels marked free"
AGAIN = "frames mapped again"
UNDER_WAY_S = 0.4  # after the beginning: earlier frames are mapped, and the guard has received the map
SETTLED_S = 0.5  # from the beginning until the published map contains the frames then in transit
_FREE = 1
_OCCUPIED = 2


class MapIntegrityCheck(Injector):
    """Measure the share of known-occupied voxels that a fault frees; it injects no fault.

    It notes the percentage of the voxels known as occupied at the beginning, in which the scene has a surface, that are
    known as free at the end of the flight. Maps are published once a second. Voxels freed by frames from before the fault
    are excluded, by the free space that the guard has received.
    """

    needs = Capabilities.STAGES

    def __init__(self) -> None:
        self._walls: NDArray[np.bool_] | None = None
        self._settled = False

    def begin(self, at: InjectionContext) -> None:
        """Record the voxels that are known as occupied and in which the scene has a surface."""
        known = at.channels.voxels.latest()
        if known is not None:
            self._walls = (known.state == _OCCUPIED) & filled(known.grid, at.world.clearance.bins.points)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Exclude the voxels freed by the last frames from before the fault."""
        free = _known_free(at) if since_s >= UNDER_WAY_S and not self._settled else None
        if free is not None and self._walls is not None:
            self._settled = True
            self._walls = self._walls & ~free[: self._walls.size].reshape(self._walls.shape)

    def end(self, at: InjectionContext) -> None:
        """Compare with the voxels that are known as free now."""
        known = at.channels.voxels.latest()
        if self._walls is not None and self._walls.any():
            at.notes[FREED] = 100.0 * float((known.state[self._walls] == _FREE).mean())


class Claims(Injector):
    """Count the voxels that become known as free.

    It counts from SETTLED_S after the beginning on. It injects no fault.
    """

    needs = Capabilities.STAGES

    def __init__(self) -> None:
        self._free: NDArray[np.bool_] | None = None

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Record the voxels that are known as free at SETTLED_S."""
        if self._free is None and since_s >= SETTLED_S:
            self._free = _known_free(at)

    def end(self, at: InjectionContext) -> None:
        """Compare with the voxels that are known as free now."""
        known = _known_free(at)
        if self._free is not None and known is not None:
            at.notes[CLAIMED] = float(np.count_nonzero(known & ~self._free))


class Tally(Injector):
    """Count the frames that reach the map more than once; it injects no fault.

    Frames are compared by a hash of their depth images. Noise makes each image unique.
    """

    needs = Capabilities.STAGES

    def __init__(self) -> None:
        self._sequence = -1
        self._seen = set[bytes]()

    def begin(self, at: InjectionContext) -> None:
        """Start the count at zero."""
        at.notes[AGAIN] = 0.0

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Count a repeated frame.

        Perception and mission both ran in the previous turn. At most one frame arrives in a turn.
        """
        sequence = at.channels.frames.sequence()
        posed = at.channels.frames.latest() if sequence != self._sequence else None
        self._sequence = sequence
        if posed is None:
            return
        picture = hashlib.sha256(posed.frame.depth_m.tobytes()).digest()
        at.notes[AGAIN] += picture in self._seen
        self._seen.add(picture)


def _known_free(at: InjectionContext) -> NDArray[np.bool_] | None:
    """Return the free space that the guard received last, or None before the first."""
    published = at.channels.free.latest()
    return None if published is None else np.unpackbits(published.bits).astype(np.bool_)


def filled(grid: Any, points_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return a mask of the grid's voxels that contain any of the world points (N, 3)."""
    index = np.floor((points_m - grid.origin_world_m) / grid.resolution_m).astype(np.int64)
    index = index[np.all((index >= 0) & (index < np.array(grid.shape)), axis=1)]
    found = np.zeros(grid.shape, dtype=np.bool_)
    found[tuple(index.T)] = True
    return found
