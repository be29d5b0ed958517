"""Minimum pooling of a depth image: the nearest return in a square window in four look-ups."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, Float32Array

CELL = 2  # pixels per cell of the pooled depth
LEVELS = 7  # sliding minima over 1, 2, 4 ... 64 cells
STRIP = 8  # width in cells of a vertical image strip; the farthest return of each strip is stored
LARGEST_WINDOW = (1 << LEVELS) - 1  # cells across; four windows of the last level cover it


class PooledDepth(NamedTuple):
    """Sliding minima of an image of (h, w) cells, and counts of its pixels with a return.

    lowest_m: (LEVELS, h, w) over cells; each window extends right and down from its cell and is clipped at the border; infinite
    where there is no return. farthest_m: (ceil(w / STRIP),), 0 where there is no return. valid: (h + 1, w + 1), the integral
    image of the counts.
    """

    lowest_m: Float32Array
    farthest_m: Float32Array
    valid: NDArray[np.int32]


@kernel
def min_pool(depth_m: AnyArray, near_m: float, pooled: PooledDepth) -> None:
    """Compute sliding minima and counts of the pixels with a return (finite, at least near_m)."""
    lowest_m, farthest_m, valid = pooled
    width = depth_m.shape[1]
    nearest_m = np.full(2 * lowest_m.shape[2], np.inf, dtype=np.float32)
    returns = np.zeros(2 * lowest_m.shape[2], dtype=np.int32)
    max_m = np.zeros(width, dtype=np.float32)
    for i in range(lowest_m.shape[1]):
        _fold(depth_m, np.float32(near_m), i, nearest_m[:width], max_m, returns[:width])
        target, count, above = lowest_m[0, i], valid[i + 1], valid[i]
        for j in range(target.size):
            a, b = nearest_m[2 * j], nearest_m[2 * j + 1]
            target[j] = a if a < b else b
        running = np.int32(0)
        for j in range(target.size):
            running += returns[2 * j] + returns[2 * j + 1]
            count[j + 1] = above[j + 1] + running
    farthest_m[:] = 0.0
    for u in range(width):
        strip = u // (CELL * STRIP)
        farthest_m[strip] = max(farthest_m[strip], max_m[u])
    for level in range(1, lowest_m.shape[0]):
        _widen(lowest_m[level - 1], 1 << (level - 1), lowest_m[level])


@kernel
def _fold(
    depth_m: AnyArray, near_m: np.float32, cell_row: int, nearest_m: AnyArray, max_m: AnyArray, returns: AnyArray
) -> None:
    """Reduce two pixel rows to one: nearest return and number of returns per column.

    Raises max_m (W,) to the farthest return of each column.
    """
    infinite, zero = np.float32(np.inf), np.float32(0.0)
    upper = depth_m[CELL * cell_row]
    if CELL * cell_row + 1 == depth_m.shape[0]:
        for u in range(nearest_m.size):
            a = upper[u]
            has_a = (a >= near_m) & (a < infinite)
            nearest_m[u] = a if has_a else infinite
            max_m[u] = max(max_m[u], a if has_a else zero)
            returns[u] = np.int32(has_a)
        return
    lower = depth_m[CELL * cell_row + 1]
    for u in range(nearest_m.size):
        a, b = upper[u], lower[u]
        has_a, has_b = (a >= near_m) & (a < infinite), (b >= near_m) & (b < infinite)
        c, d, e = a if has_a else zero, b if has_b else zero, max_m[u]
        c = c if c > d else d
        max_m[u] = c if c > e else e
        a, b = a if has_a else infinite, b if has_b else infinite
        nearest_m[u] = a if a < b else b
        returns[u] = np.int32(has_a) + np.int32(has_b)


@kernel
def _widen(narrow: AnyArray, half: int, wide: AnyArray) -> None:
    """Compute minima over windows twice as wide as those of ``narrow`` (``half`` cells wide)."""
    rows, columns = narrow.shape
    whole = max(columns - half, 0)
    for i in range(rows):
        first, second, target = narrow[i], narrow[min(i + half, rows - 1)], wide[i]
        third, fourth = first[columns - whole :], second[columns - whole :]  # local slices keep the loop vectorised
        for j in range(whole):
            a, b, c, d = first[j], second[j], third[j], fourth[j]
            a = a if a < b else b
            c = c if c < d else d
            target[j] = a if a < c else c
        for j in range(whole, columns):
            a, b = first[j], second[j]
            target[j] = a if a < b else b
