"""Which views stay in memory when there are too many: those that show what few others show, spread over the flight.

A view is a set of cells of CELL_M that it measured, each with the octant from which it looked. It is needed by the sum over
its cells of one over the number of views with the same cell, times the gap that it would leave in the sequence of views. So a
hover leaves little, a place seen once stays, and a room seen many times keeps looks from all parts of the flight.
"""

from __future__ import annotations

from itertools import compress

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.neural.keyframes.ray_sampling import RECENT_VIEWS
from uav_recon.types.frames import BoolArray, Float32Array, FloatArray, IntArray

CELL_M = 0.25
SHIFT = 1 << 20  # cells along an axis, more than any box has


class EvictionPolicy:
    """numbers: by which the views that are kept are known, ascending. taken: how many there ever were."""

    def __init__(self) -> None:
        self.taken = 0
        self.numbers: list[int] = []
        self._cells: list[IntArray] = []

    def add(self, number: int, position: FloatArray, points: Float32Array) -> None:
        """Note the next view: from position (3,), end points (N, 3), world."""
        some = points.astype(np.float64)
        x, y, z = np.floor(some / CELL_M).astype(np.int64).T + SHIFT // 2
        octant = (some > position) @ np.array([4, 2, 1])
        self._cells.append(np.unique(((x * SHIFT + y) * SHIFT + z) * 8 + octant))
        self.numbers.append(number)
        self.taken += 1

    def most_useful(self, count: int) -> BoolArray:
        """Which ``count`` of the views (V,) to keep. 30 ms for a quarter of 512."""
        views = len(self.numbers)
        _, cell = np.unique(np.concatenate(self._cells), return_inverse=True)
        first = np.concatenate([[0], np.cumsum([len(cells) for cells in self._cells])])
        kept = np.ones(views, dtype=np.bool_)
        _drop(first, cell, np.bincount(cell), np.array(self.numbers), max(views - RECENT_VIEWS, 0), views - count, kept)
        return kept

    def keep(self, which: BoolArray) -> None:
        """Forget all views but some (V,)."""
        self.numbers, self._cells = list(compress(self.numbers, which)), list(compress(self._cells, which))


@kernel
def _drop(
    first: IntArray, cell: IntArray, showing: IntArray, number: IntArray, droppable: int, count: int, kept: BoolArray
) -> None:
    """Take ``count`` views out of kept (V,), the least needed first. showing: how many views show each cell."""
    for _ in range(count):
        least, worst = np.inf, -1
        before = -1  # the flight's begin
        for view in range(droppable):
            if not kept[view]:
                continue
            after = view + 1
            while after < kept.shape[0] - 1 and not kept[after]:
                after += 1
            need = 0.0
            for n in range(first[view], first[view + 1]):
                need += 1.0 / showing[cell[n]]
            need *= number[min(after, kept.shape[0] - 1)] - before
            before = number[view]
            if need < least:
                least, worst = need, view
        if worst < 0:
            return
        kept[worst] = False
        for n in range(first[worst], first[worst + 1]):
            showing[cell[n]] -= 1
