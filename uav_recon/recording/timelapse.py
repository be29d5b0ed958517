"""Timelapse of the learned surface: states of it in ``folder``/surfaces, one file each.

Files are written atomically. Like the recorder, it reads a last-value channel, and flight code does not depend on it. About
ten bytes per element before compression, four after: a room's surface of 50,000 elements takes 0.2 MB and 15 ms.
"""

from __future__ import annotations

import logging
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uav_recon import atomic_file
from uav_recon.interfaces import Channel, Clock
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.maps import SurfaceElements

SURFACES = "surfaces"
PERIOD_S = 3.0  # minimum time between two states
_STEP_M = 0.001  # resolution of stored positions, in a room of up to 65 m; coarser in a larger one
_LARGEST = 65535
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceState:
    """The surface as known at stamp_s, with the revision of the mapper.

    position_world (N, 3), unit normal_world (N, 3).
    """

    stamp_s: float
    revision: int
    position_world: FloatArray
    normal_world: FloatArray


class Timelapse:
    """Stores states of the surface in ``folder``/surfaces, numbered after existing ones.

    The constructor raises OSError if the folder cannot be created. A full disk later is logged once and only loses states.
    """

    def __init__(self, folder: Path, surface: Channel[SurfaceElements], clock: Clock) -> None:
        self._folder = folder / SURFACES
        self._surface = surface
        self._clock = clock
        self._folder.mkdir(exist_ok=True)
        self._number = 1 + max((int(path.stem) for path in _files(self._folder)), default=-1)
        self._seen = self._kept = surface.sequence()  # ignore the value that an earlier flight left in the channel
        self._seen_s = clock.now_s()
        self._due_s = -np.inf
        self._lost = 0

    def step(self) -> None:
        """Record the time of a new surface, and store it if the last state is old enough.

        Blocks for 15 ms every PERIOD_S.
        """
        now_s, sequence = self._clock.now_s(), self._surface.sequence()
        if sequence != self._seen:
            self._seen = sequence
            self._seen_s = now_s
        if now_s >= self._due_s:
            self._keep(now_s)

    def close(self) -> None:
        """Store the last state, even if the one before is recent."""
        self.step()
        self._keep(self._clock.now_s())

    def _keep(self, now_s: float) -> None:
        elements = self._surface.latest() if self._seen != self._kept else None
        if elements is None:
            return
        self._kept = self._seen
        self._due_s = now_s + PERIOD_S
        state = SurfaceState(self._seen_s, elements.revision, elements.position_world, elements.normal_world)
        try:
            _save(self._folder / f"{self._number:05d}.npz", state)
        except OSError as error:
            if self._lost == 0:
                _LOG.warning("%s: %s; states of the surface are being lost", self._folder, error.strerror)
            self._lost += 1
            return
        self._number += 1


def load_states(folder: Path) -> list[SurfaceState]:
    """Return the stored states of a flight, oldest first; files that cannot be read are skipped.

    A skipped file is logged.
    """
    states = []
    for path in _files(folder / SURFACES):
        try:
            states.append(_load(path))
        except (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
            _LOG.warning("%s cannot be read: %s", path, error)
    return sorted(states, key=lambda state: state.stamp_s)


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*.npz") if path.stem.isdigit())


def _save(path: Path, state: SurfaceState) -> None:
    """Write positions as integer steps from the lowest corner, each as a difference to the last.

    Consecutive elements are neighbours, so the differences are small.
    """
    low_m = state.position_world.min(axis=0) if len(state.position_world) else np.zeros(3)
    offset_m = state.position_world - low_m
    step_m = max(_STEP_M, float(offset_m.max(initial=0.0)) / _LARGEST)
    steps = np.round(offset_m / step_m).astype(np.uint16)
    with atomic_file.writing(path, durable=False) as file:
        np.savez_compressed(
            file,
            stamp_s=state.stamp_s,
            revision=state.revision,
            low_m=low_m,
            step_m=step_m,
            change_steps=np.diff(steps, axis=0, prepend=np.zeros((1, 3), np.uint16)).T,  # wraps around, and back when summed
            normal=np.round(127.0 * state.normal_world).astype(np.int8).T,
        )


def _load(path: Path) -> SurfaceState:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
        steps: AnyArray = np.cumsum(data["change_steps"], axis=1, dtype=np.uint16).T
        normal = data["normal"].T.astype(np.float64)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1.0)
        position = data["low_m"] + steps * float(data["step_m"])
        return SurfaceState(float(data["stamp_s"]), int(data["revision"]), position, normal)
