"""The best view of a frontier by brute force, with an independent visibility test.

A cell is seen if an UNKNOWN face neighbour of it, inside the fence, has its centre in the image and in range, and if every
voxel that the line from the eye to it crosses, except that neighbour itself, is known free. Touching an edge or a corner is
not crossing. The line is cut into slabs, these into rows, and these into voxels, so that there is no stepping from voxel to
voxel as in the planner's rays. All lengths are in voxels: voxel (i, j, k) spans [(i,j,k), (i,j,k)+1].
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
LEAST = 1e-9  # min. share of the line inside a voxel that counts as crossing
_FACES = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], dtype=np.int64)


@dataclass(frozen=True, slots=True)
class OracleLens:
    """Camera parameters of the oracle.

    tan_h, tan_v: tangents of the half angles.
    near, reach: range in voxels.
    pitch_min_rad, pitch_max_rad: pitch range of the mount, positive looks down.
    """

    tan_h: float
    tan_v: float
    near: float
    reach: float
    pitch_min_rad: float
    pitch_max_rad: float

    def numbers(self) -> FloatArray:
        """Return the fields in order, as an array for the kernels."""
        return np.array([self.tan_h, self.tan_v, self.near, self.reach, self.pitch_min_rad, self.pitch_max_rad])


@dataclass(frozen=True, slots=True, eq=False)
class OracleFrontier:
    """A frontier of the oracle.

    cells: (N, 3) free voxels beside unknown ones.
    low, high: (3,) the fence, [low, high).
    """

    cells: IntArray
    low: IntArray
    high: IntArray

    def targets(self, state: ByteArray) -> IntArray:
        """Return the unknown neighbours (M, 4): cell number, then voxel."""
        around = self.cells[:, None, :] + _FACES
        inside: BoolArray = np.all((around >= self.low) & (around < self.high), axis=-1)
        at = np.where(inside[..., None], around, 0)
        unknown = inside & (state[at[..., 0], at[..., 1], at[..., 2]] == UNKNOWN)
        cell, face = np.nonzero(unknown)
        return np.column_stack([cell, around[cell, face]]).astype(np.int64)


def cells_seen(state: ByteArray, lens: OracleLens, view: FloatArray, frontier: OracleFrontier) -> int:
    """Return how many cells of the frontier a view (x, y, z, yaw, pitch down) sees.

    The eye is at x, y, z.
    """
    return _count(state, lens.numbers(), view, frontier.targets(state), len(frontier.cells), 0)


def best_seen(
    state: ByteArray, lens: OracleLens, reachable: BoolArray, frontier: OracleFrontier, shell: tuple[float, float], seed: int
) -> int:
    """Return the most cells seen by any of 1,000 seeded random views.

    Returns 0 if no position is possible.

    The positions are in reachable voxels (nx, ny, nz), at a distance inside ``shell`` from the middle of the cells. Half of
    the views look at that middle, half at a random cell.
    """
    targets = frontier.targets(state)
    views = _random_views(lens, reachable, frontier.cells, shell, np.random.default_rng(seed))
    return _most(state, lens.numbers(), views, targets, len(frontier.cells))


def _random_views(
    lens: OracleLens, reachable: BoolArray, cells: IntArray, shell: tuple[float, float], rng: np.random.Generator
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
def _inside(start: float, change: float, low: float, a: float, b: float) -> tuple[float, float]:
    """Return the part of [a, b] in which start + t * change is between low and low + 1."""
    if change == 0.0:
        return (a, b) if low <= start < low + 1.0 else (a, a)
    t0, t1 = (low - start) / change, (low + 1.0 - start) / change
    return max(a, min(t0, t1)), min(b, max(t0, t1))


@kernel
def _span(start: float, change: float, a: float, b: float) -> tuple[int, int]:
    """Return the first and last voxel of one axis between two points of the line."""
    u, v = start + a * change, start + b * change
    return math.floor(min(u, v)), math.floor(max(u, v))


@kernel
def _is_lit(state: ByteArray, view: FloatArray, i: int, j: int, k: int) -> bool:
    nx, ny, nz = state.shape
    x, y, z = view[0], view[1], view[2]
    dx, dy, dz = i + 0.5 - x, j + 0.5 - y, k + 0.5 - z
    first_a, last_a = _span(x, dx, 0.0, 1.0)
    for a in range(first_a, last_a + 1):
        slab = _inside(x, dx, a, 0.0, 1.0)
        if slab[1] - slab[0] <= LEAST:
            continue
        first_b, last_b = _span(y, dy, slab[0], slab[1])
        for b in range(first_b, last_b + 1):
            row = _inside(y, dy, b, slab[0], slab[1])
            if row[1] - row[0] <= LEAST:
                continue
            first_c, last_c = _span(z, dz, row[0], row[1])
            for c in range(first_c, last_c + 1):
                part = _inside(z, dz, c, row[0], row[1])
                if part[1] - part[0] <= LEAST or (a == i and b == j and c == k):
                    continue
                if a < 0 or b < 0 or c < 0 or a >= nx or b >= ny or c >= nz or state[a, b, c] != FREE:
                    return False
    return True


@kernel
def _count(state: ByteArray, lens: FloatArray, view: FloatArray, targets: IntArray, cells: int, beat: int) -> int:
    """Count the cells seen; stop and return less than ``beat`` if it cannot be reached."""
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
        if _is_lit(state, view, targets[n, 1], targets[n, 2], targets[n, 3]):
            seen += 1
            last_seen = cell
    return seen


@kernel
def _most(state: ByteArray, lens: FloatArray, views: FloatArray, targets: IntArray, cells: int) -> int:
    best = 0
    for n in range(len(views)):
        best = max(best, _count(state, lens, views[n], targets, cells, best))
    return best
