"""Whether the product's map still holds what it held before a trouble, where there really is something."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.faults.injectors.base import Capabilities, InjectionContext, Injector

FREED, CLAIMED, AGAIN = "known occupied freed", "voxels marked free", "frames mapped again"
UNDER_WAY_S = 0.4  # frames of before the beginning are mapped, and the guard is told, so long after it
SETTLED_S = 0.5  # from the beginning until the map holds what was under way then, and says so
_FREE, _OCCUPIED = 1, 2


class MapIntegrityCheck(Injector):
    """No trouble: notes what percentage of the voxels known as occupied at the beginning, in which the scene has a surface,
    are known as free when the flight is over. Maps are shown once a second: of what frames of before freed, the guard knows.
    """

    needs = Capabilities.STAGES

    def __init__(self) -> None:
        self._walls: NDArray[np.bool_] | None = None
        self._settled = False

    def begin(self, at: InjectionContext) -> None:
        """What is known, and true."""
        known = at.channels.voxels.latest()
        if known is not None:
            self._walls = (known.state == _OCCUPIED) & filled(known.grid, at.world.clearance.bins.points)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Without what the last frames of before showed to be free."""
        free = _known_free(at) if since_s >= UNDER_WAY_S and not self._settled else None
        if free is not None and self._walls is not None:
            self._settled = True
            self._walls = self._walls & ~free[: self._walls.size].reshape(self._walls.shape)

    def end(self, at: InjectionContext) -> None:
        """Against what is known now."""
        known = at.channels.voxels.latest()
        if self._walls is not None and self._walls.any():
            at.notes[FREED] = 100.0 * float((known.state[self._walls] == _FREE).mean())


class Claims(Injector):
    """No trouble: notes how many voxels become known as free from SETTLED_S after the beginning on."""

    needs = Capabilities.STAGES

    def __init__(self) -> None:
        self._free: NDArray[np.bool_] | None = None

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """What is known as free then."""
        if self._free is None and since_s >= SETTLED_S:
            self._free = _known_free(at)

    def end(self, at: InjectionContext) -> None:
        """Against what is known now."""
        known = _known_free(at)
        if self._free is not None and known is not None:
            at.notes[CLAIMED] = float(np.count_nonzero(known & ~self._free))


class Tally(Injector):
    """No trouble: notes how many frames reach the map that it had before, by their pictures; noise makes each another one."""

    needs = Capabilities.STAGES

    def __init__(self) -> None:
        self._sequence = -1
        self._seen = set[bytes]()

    def begin(self, at: InjectionContext) -> None:
        """None so far."""
        at.notes[AGAIN] = 0.0

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Perception and mission both ran in the turn before; at most one frame comes in a turn."""
        sequence = at.channels.frames.sequence()
        posed = at.channels.frames.latest() if sequence != self._sequence else None
        self._sequence = sequence
        if posed is None:
            return
        picture = hashlib.sha256(posed.frame.depth_m.tobytes()).digest()
        at.notes[AGAIN] += picture in self._seen
        self._seen.add(picture)


def _known_free(at: InjectionContext) -> NDArray[np.bool_] | None:
    """As the guard was last told; None before that."""
    told = at.channels.free.latest()
    return None if told is None else np.unpackbits(told.bits).astype(np.bool_)


def filled(grid: Any, points_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """The voxels of a grid that hold any of the points (N, 3) of the world."""
    index = np.floor((points_m - grid.origin_world_m) / grid.resolution_m).astype(np.int64)
    index = index[np.all((index >= 0) & (index < np.array(grid.shape)), axis=1)]
    found = np.zeros(grid.shape, dtype=np.bool_)
    found[tuple(index.T)] = True
    return found
