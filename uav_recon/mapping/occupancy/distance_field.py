"""Incremental exact distance to the nearest voxel that is not known free.

It is Euclidean, or heights count more, see VoxelMap.heights. Separable (Saito and Toriwaki 1994: D(p) = min over q of
D(q) + (p - q)²): along z and y in one plane of constant x, then along x. The distances within each plane are stored. A change
therefore recomputes its own planes, and of the other planes only those within reach and only the interval of rows that really
differ. Distances are capped at the reach. All loops are flat over (y, z) in bytes: a shift along y is an offset.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, ByteArray, IntArray
from uav_recon.types.maps import EUCLIDEAN, FREE, LARGEST_DISTANCE_VOXELS, TILE, HeightMeasure

CHUNK = 64  # bytes; flat loops run over whole chunks and need no tail loop


class FieldMemory(NamedTuple):
    """Arrays kept between updates of a grid (nx, ny, nz).

    first, last: (nx,) the rows [first, last) of each plane of constant x that may have changed.
    border: (ny * nz + CHUNK,) distance to the nearer end of the voxel's column along z, at most the reach.
    heights2: (reach + 1,) squared distance of each number of voxels along z.
    outside: (ny * nz + CHUNK,) a plane of voxels that are not free.
    planes: (nx * ny * nz + CHUNK,) squared distance within each plane of constant x.
    scratch: (3, ...) work arrays of one plane.
    """

    first: IntArray
    last: IntArray
    border: ByteArray
    heights2: ByteArray
    outside: ByteArray
    planes: ByteArray
    scratch: ByteArray


class DistanceField:
    """Updates the squared distances of a map where its state changed."""

    def __init__(self, shape: tuple[int, int, int], reach: int, heights: HeightMeasure = EUCLIDEAN) -> None:
        """Start with a grid (nx, ny, nz) without free voxels.

        reach: distance cap in voxels, 1 to LARGEST_DISTANCE_VOXELS, else ValueError. heights: see VoxelMap.
        """
        if not 0 < reach <= LARGEST_DISTANCE_VOXELS:
            raise ValueError(f"reach {reach}: want 1 to {LARGEST_DISTANCE_VOXELS} voxels")
        self._shape = shape
        self._reach = reach
        nx, ny, nz = shape
        z = np.arange(nz)
        border = np.minimum(np.minimum(z + 1, nz - z), reach).astype(np.uint8)
        self.first = np.full(nx, ny, dtype=np.int64)
        self.last = np.zeros(nx, dtype=np.int64)
        self._memory = FieldMemory(
            first=self.first,
            last=self.last,
            border=np.resize(border, ny * nz + CHUNK),
            heights2=np.minimum(heights.squares(np.arange(reach + 1)), reach**2).astype(np.uint8),
            outside=np.zeros(ny * nz + CHUNK, dtype=np.uint8),
            planes=np.zeros(nx * ny * nz + CHUNK, dtype=np.uint8),
            scratch=np.zeros((3, (ny + 2 * LARGEST_DISTANCE_VOXELS) * nz + 3 * CHUNK), dtype=np.uint8),
        )

    def invalidate_all(self) -> None:
        """Mark the whole grid as changed."""
        self.first[:], self.last[:] = 0, self._shape[1]

    def update(self, state: ByteArray, distance2: ByteArray, tile_revision: IntArray, revision: int) -> None:
        """Update distance2 for a changed state and record the revision of the tiles that changed.

        Only the rows [first[x], last[x]) of each x may have changed their free space. state, distance2: flat; distance2 is
        CHUNK longer than the grid. tile_revision of each tile in which distance2 changed is set to ``revision``.
        """
        _update(state, self._shape, self._reach, self._memory, distance2, tile_revision, revision)


def distance2_to_not_free(state: ByteArray, reach: int, heights: HeightMeasure = EUCLIDEAN) -> ByteArray:
    """Return the SQUARED distance in voxels from each voxel to the nearest that is not FREE.

    Distances are measured between voxel centres. state: (nx, ny, nz) uint8. Returns (nx, ny, nz) uint8, exact below reach²
    and reach² from there on; 0 in voxels that are not free. Voxels outside the grid are not free. reach: at most
    LARGEST_DISTANCE_VOXELS, else ValueError. heights: see VoxelMap.
    """
    nx, ny, nz = state.shape
    field, distance2 = DistanceField((nx, ny, nz), reach, heights), np.zeros(state.size + CHUNK, dtype=np.uint8)
    field.invalidate_all()
    tiles = np.zeros((-(-nx // TILE), -(-ny // TILE)), dtype=np.int64)
    field.update(np.ascontiguousarray(state).reshape(-1), distance2, tiles, 1)
    return distance2[: state.size].reshape(state.shape)


def warm_up() -> None:
    """Compile the kernels."""
    distance2_to_not_free(np.full((3, 3, 3), FREE, dtype=np.uint8), 3)


@kernel
def _along_z(states: AnyArray, border: AnyArray, heights2: AnyArray, reach: int, now: AnyArray, then: AnyArray) -> None:
    """Compute the squared distance along z for whole columns into now[CHUNK:].

    states: flat; heights2: see FieldMemory; then: scratch; border: distance to the ends of the voxel's own column, beyond
    which nothing is free. A shift can reach into the neighbouring column. This does not change the result, because the column
    end that it crosses is nearer. The bytes beyond the columns do not change the result for the same reason.
    """
    size = -(-states.size // CHUNK) * CHUNK
    here, there = now[CHUNK:], then[CHUNK:]
    for n in range(states.size):
        here[n] = border[n] if states[n] == FREE else np.uint8(0)
    shift = 1
    while shift < reach:
        _shift(now[CHUNK - shift :], here, now[CHUNK + shift :], size, np.uint8(shift), there)
        for n in range(size):
            here[n] = there[n]
        shift *= 2
    for n in range(size):
        here[n] = heights2[min(here[n], reach)]


@kernel
def _shift(before: AnyArray, here: AnyArray, after: AnyArray, size: int, step: np.uint8, out: AnyArray) -> None:
    """Compute out = min(here, before + step, after + step) in saturating bytes."""
    limit = np.uint8(255 - step)
    for n in range(size):
        a, b, c = before[n], after[n], here[n]
        a = a if a < b else b
        a = np.uint8((a if a < limit else limit) + step)
        out[n] = a if a < c else c


@kernel
def _improve(before: AnyArray, after: AnyArray, size: int, step: np.uint8, best: AnyArray) -> None:
    """Compute best = min(best, before + step, after + step) in saturating bytes."""
    limit = np.uint8(255 - step)
    for n in range(size):
        a, b, c = before[n], after[n], best[n]
        a = a if a < b else b
        a = np.uint8((a if a < limit else limit) + step)
        best[n] = a if a < c else c


@kernel
def _copy(source: AnyArray, first: int, last: int, target: AnyArray) -> None:
    """Copy source[first:last] to target[first:last]."""
    for n in range(first, last):
        target[n] = source[n]


@kernel
def _differ(one: AnyArray, other: AnyArray) -> bool:
    """Return True if two chunks differ."""
    found = np.uint8(0)
    for n in range(CHUNK):
        found |= np.uint8(one[n] ^ other[n])
    return bool(found != 0)


@kernel
def _update(
    state: ByteArray, shape: tuple[int, int, int], reach: int, memory: FieldMemory, distance2: ByteArray,
    tile_revision: IntArray, revision: int,
) -> None:  # fmt: skip
    """Update the planes, then distance2; see DistanceField.update. Leaves [first, last) empty."""
    nx, _, _ = shape
    first, last = memory.first, memory.last
    begin, end = nx, 0
    for x in range(nx):
        if first[x] < last[x]:
            begin, end = min(begin, x), x + 1
            _renew_plane(state, shape, x, reach, memory)
    for x in range(max(begin - reach + 1, 0), min(end + reach - 1, nx)):
        low, high = shape[1], 0
        for near in range(max(x - reach + 1, begin), min(x + reach, end)):
            low, high = min(low, first[near]), max(high, last[near])
        if low < high:
            _renew_across(shape, x, reach, low, high, memory, distance2, tile_revision, revision)
    for x in range(begin, end):
        first[x], last[x] = shape[1], 0


@kernel
def _renew_plane(state: ByteArray, shape: tuple[int, int, int], x: int, reach: int, memory: FieldMemory) -> None:
    """Update the distances within the plane x.

    Sets [first[x], last[x]) to the rows in which they changed.
    """
    _, ny, nz = shape
    first, last, planes = memory.first, memory.last, memory.planes
    low, high = max(first[x] - reach + 1, 0), min(last[x] + reach - 1, ny)
    from_row, to_row = low - reach + 1, high + reach - 1
    inner, outer = max(from_row, 0), min(to_row, ny)
    best, lines, spare = memory.scratch
    base = (inner - from_row) * nz
    plane = x * ny * nz
    _along_z(state[plane + inner * nz : plane + outer * nz], memory.border, memory.heights2, reach, lines[base:], spare)
    lines[CHUNK : CHUNK + base] = 0
    lines[CHUNK + (outer - from_row) * nz : CHUNK + (to_row - from_row) * nz] = 0
    size = (high - low) * nz
    old = planes[plane + low * nz :]
    whole = -(-size // CHUNK) * CHUNK
    _copy(lines[CHUNK + (reach - 1) * nz :], 0, whole, best)
    for away in range(1, reach):
        before, after = lines[CHUNK + (reach - 1 - away) * nz :], lines[CHUNK + (reach - 1 + away) * nz :]
        _improve(before, after, whole, np.uint8(away * away), best)
    _copy(old, size, whole, best)
    first[x], last[x] = ny, 0
    for base in range(0, whole, CHUNK):
        if _differ(best[base:], old[base:]):
            first[x], last[x] = min(first[x], low + base // nz), min(low + (base + CHUNK - 1) // nz + 1, high)
            for n in range(base, base + CHUNK):
                old[n] = best[n]


@kernel
def _renew_across(
    shape: tuple[int, int, int], x: int, reach: int, low: int, high: int, memory: FieldMemory, distance2: ByteArray,
    tile_revision: IntArray, revision: int,
) -> None:  # fmt: skip
    """Update distance2 of the rows [low, high) at x from the planes within reach."""
    nx, ny, nz = shape
    outside, planes, best = memory.outside, memory.planes, memory.scratch[0]
    size = (high - low) * nz
    old = distance2[(x * ny + low) * nz :]
    whole = -(-size // CHUNK) * CHUNK
    _copy(planes[(x * ny + low) * nz :], 0, whole, best)
    for away in range(1, reach):
        before = planes[((x - away) * ny + low) * nz :] if x >= away else outside
        after = planes[((x + away) * ny + low) * nz :] if x + away < nx else outside
        _improve(before, after, whole, np.uint8(away * away), best)
    _copy(old, size, whole, best)
    for base in range(0, whole, CHUNK):
        if _differ(best[base:], old[base:]):
            for n in range(base, base + CHUNK):
                if best[n] != old[n]:
                    old[n] = best[n]
                    tile_revision[x // TILE, (low + n // nz) // TILE] = revision
