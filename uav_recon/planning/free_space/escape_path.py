"""Path to the nearest flyable cell for a vehicle whose own cell is not flyable."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import ByteArray, FloatArray, IntArray

STEPS = np.array(
    [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) != (0, 0, 0)], dtype=np.int64
)
STEP_LENGTHS = np.sqrt((STEPS**2).sum(axis=1).astype(np.float64))
ESCAPE_LIMIT_M = 2.0  # max. length of such a path


class EscapePath:
    """Finds the nearest flyable cell through known-free cells, within ESCAPE_LIMIT_M.

    The search window and its work arrays are allocated once.
    """

    def __init__(self, resolution_m: float) -> None:
        self._limit = ESCAPE_LIMIT_M / resolution_m
        edge = 2 * (int(self._limit) + 1) + 1
        self._distance = np.empty(edge**3)
        self._previous = np.empty(edge**3, dtype=np.int64)
        self._stamp = np.zeros(edge**3, dtype=np.int64)
        self._buckets = np.empty((3, edge**3), dtype=np.int64)
        self._now = 0

    def find(self, mask: ByteArray, known_free: ByteArray, cell: IntArray) -> IntArray | None:
        """Return the flat cells (N,) from ``cell`` to the nearest flyable cell, or None.

        Both ends are included. Indices refer to the padded arrays. None if there is no path within the limit.

        cell: (3,) padded index.
        """
        self._now += 1
        cells = _nearest_flyable(
            mask,
            known_free,
            cell,
            STEPS,
            STEP_LENGTHS,
            self._limit,
            self._distance,
            self._previous,
            self._stamp,
            self._now,
            self._buckets,
        )
        return cells if len(cells) else None


@kernel
def _nearest_flyable(  # noqa: C901
    mask: ByteArray,
    known_free: ByteArray,
    cell: IntArray,
    steps: IntArray,
    lengths: FloatArray,
    limit: float,
    distance: FloatArray,
    previous: IntArray,
    stamp: IntArray,
    now: int,
    buckets: IntArray,
) -> IntArray:
    # Dijkstra with buckets one voxel wide (Dinitz): no edge is shorter than a bucket, so the order within a bucket is free
    reach = int(limit) + 1
    edge = 2 * reach + 1
    start = (reach * edge + reach) * edge + reach
    stamp[start], distance[start], previous[start] = now, 0.0, -1
    buckets[0, 0] = start
    sizes = np.array([1, 0, 0])
    best, best_distance = -1, np.inf
    level = 0
    while sizes.sum() > 0 and level <= min(limit, best_distance):
        slot = level % 3
        for m in range(sizes[slot]):
            at = buckets[slot, m]
            here = distance[at]
            if here < level:
                continue  # already settled in an earlier bucket
            a, b, c = at // (edge * edge), at // edge % edge, at % edge
            i, j, k = cell[0] + a - reach, cell[1] + b - reach, cell[2] + c - reach
            if mask[i, j, k]:
                if here < best_distance or (here == best_distance and at < best):
                    best, best_distance = at, here
                continue
            for e in range(26):
                if not known_free[i + steps[e, 0], j + steps[e, 1], k + steps[e, 2]]:
                    continue
                reached = here + lengths[e]
                if reached > limit:
                    continue
                beside = at + (steps[e, 0] * edge + steps[e, 1]) * edge + steps[e, 2]
                if stamp[beside] != now or reached < distance[beside]:
                    stamp[beside], distance[beside], previous[beside] = now, reached, at
                    into = int(reached) % 3
                    buckets[into, sizes[into]] = beside
                    sizes[into] += 1
        sizes[slot] = 0
        level += 1
    count, at = 0, best
    while at >= 0:
        count += 1
        at = previous[at]
    cells = np.empty(count, dtype=np.int64)
    at = best
    for n in range(count - 1, -1, -1):
        a, b, c = at // (edge * edge), at // edge % edge, at % edge
        i, j, k = cell[0] + a - reach, cell[1] + b - reach, cell[2] + c - reach
        cells[n] = (i * mask.shape[1] + j) * mask.shape[2] + k
        at = previous[at]
    return cells
