"""The best view of a frontier by brute force, and what a view sees by other means than the planner's.

A cell is seen when an UNKNOWN face neighbour of it, inside the fence, has its centre in the picture and in range, and every
sample of the line to it, a twentieth of a voxel apart, lies in a known-free voxel or in that neighbour itself. All lengths are
in voxels: voxel (i, j, k) spans [(i,j,k), (i,j,k)+1].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, UNKNOWN

CANDIDATES = 1000
TRIES_PER_CANDIDATE = 20
STEP = 0.05
_FACES = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Lens:
    """tan_h, tan_v: of the half angles. near, reach: range in voxels. pitch_min_rad, pitch_max_rad: down, of the mount."""

    tan_h: float
    tan_v: float
    near: float
    reach: float
    pitch_min_rad: float
    pitch_max_rad: float

    def numbers(self) -> FloatArray:
        """For the kernels, in the order of the fields."""
        return np.array([self.tan_h, self.tan_v, self.near, self.reach, self.pitch_min_rad, self.pitch_max_rad])


@dataclass(frozen=True, slots=True, eq=False)
class Frontier:
    """cells (N, 3): free voxels beside unknown ones. low, high (3,): the fence, [low, high)."""

    cells: IntArray
    low: IntArray
    high: IntArray

    def targets(self, state: ByteArray) -> IntArray:
        """Unknown neighbours (M, 4): the number of the cell, then the voxel."""
        around = self.cells[:, None, :] + _FACES
        inside: BoolArray = np.all((around >= self.low) & (around < self.high), axis=-1)
        at = np.where(inside[..., None], around, 0)
        unknown = inside & (state[at[..., 0], at[..., 1], at[..., 2]] == UNKNOWN)
        cell, face = np.nonzero(unknown)
        return np.column_stack([cell, around[cell, face]]).astype(np.int64)


def cells_seen(state: ByteArray, lens: Lens, view: FloatArray, frontier: Frontier) -> int:
    """How many of the frontier's cells a view (x, y, z, yaw, pitch down) sees; the eye is at x, y, z."""
    return _count(state, lens.numbers(), view, frontier.targets(state), len(frontier.cells), 0)


def best_seen(
    state: ByteArray, lens: Lens, reachable: BoolArray, frontier: Frontier, shell: tuple[float, float], seed: int
) -> int:
    """Most cells that any of 1,000 seeded random views sees: 0 if there is no place for one.

    Places are in reachable voxels (nx, ny, nz) at a distance inside ``shell`` from the middle of the cells; half of them look
    at that middle, half at a random cell.
    """
    targets = frontier.targets(state)
    views = _random_views(lens, reachable, frontier.cells, shell, np.random.default_rng(seed))
    return _most(state, lens.numbers(), views, targets, len(frontier.cells))


def _random_views(
    lens: Lens, reachable: BoolArray, cells: IntArray, shell: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    middle = cells.mean(axis=0) + 0.5
    count = CANDIDATES * TRIES_PER_CANDIDATE
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    place = middle + direction * rng.uniform(*shell, size=(count, 1))
    index = np.floor(place).astype(np.int64)
    inside = ((index >= 0) & (index < np.array(reachable.shape))).all(axis=1)
    at = np.where(inside[:, None], index, 0)
    place = place[inside & reachable[at[:, 0], at[:, 1], at[:, 2]]][:CANDIDATES]
    aims = np.where(np.arange(len(place))[:, None] % 2 == 0, middle, cells[rng.integers(len(cells), size=len(place))] + 0.5)
    way = aims - place
    pitch = np.arctan2(-way[:, 2], np.hypot(way[:, 0], way[:, 1]))
    yaw = np.arctan2(way[:, 1], way[:, 0])
    return np.column_stack([place, yaw, np.clip(pitch, lens.pitch_min_rad, lens.pitch_max_rad)])


@kernel
def _is_lit(state: ByteArray, view: FloatArray, i: int, j: int, k: int, length: float) -> bool:
    x, y, z = view[0], view[1], view[2]
    dx, dy, dz = i + 0.5 - x, j + 0.5 - y, k + 0.5 - z
    count = math.ceil(length / STEP)
    for n in range(count):
        t = n / count
        a, b, c = math.floor(x + t * dx), math.floor(y + t * dy), math.floor(z + t * dz)
        if a == i and b == j and c == k:
            return True
        if a < 0 or b < 0 or c < 0 or a >= state.shape[0] or b >= state.shape[1] or c >= state.shape[2]:
            return False
        if state[a, b, c] != FREE:
            return False
    return True


@kernel
def _count(state: ByteArray, lens: FloatArray, view: FloatArray, targets: IntArray, cells: int, beat: int) -> int:
    """Count the cells seen; give up (and return less than ``beat``) once it cannot be reached."""
    cos_y, sin_y, cos_p, sin_p = math.cos(view[3]), math.sin(view[3]), math.cos(view[4]), math.sin(view[4])
    seen, passed, last_seen = 0, 0, -1
    for n in range(len(targets)):
        cell = targets[n, 0]
        if n == 0 or cell != targets[n - 1, 0]:
            passed += 1
            if seen + cells - passed + 1 < beat:
                return seen
        if cell == last_seen:
            continue
        dx, dy, dz = targets[n, 1] + 0.5 - view[0], targets[n, 2] + 0.5 - view[1], targets[n, 3] + 0.5 - view[2]
        forward = cos_p * (cos_y * dx + sin_y * dy) - sin_p * dz
        left = -sin_y * dx + cos_y * dy
        up = sin_p * (cos_y * dx + sin_y * dy) + cos_p * dz
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if forward <= 0.0 or abs(left) > forward * lens[0] or abs(up) > forward * lens[1]:
            continue
        if length < lens[2] or length > lens[3]:
            continue
        if _is_lit(state, view, targets[n, 1], targets[n, 2], targets[n, 3], length):
            seen += 1
            last_seen = cell
    return seen


@kernel
def _most(state: ByteArray, lens: FloatArray, views: FloatArray, targets: IntArray, cells: int) -> int:
    best = 0
    for n in range(len(views)):
        best = max(best, _count(state, lens, views[n], targets, cells, best))
    return best
