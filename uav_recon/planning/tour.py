"""Open asymmetric travelling salesman: in which order to visit the tasks (paper, section III-C).

A tour starts at node 0 (the vehicle), visits nodes 1..N once each and ends anywhere. Exact for N <= 10 (Held and Karp, 1962),
beyond that iterated local search with a fixed number of rounds and a fixed seed: the same costs give the same tour.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import FloatArray, IntArray

EXACT_LIMIT = 10
ROUNDS = 150
SEED = 20240410
_MIN_GAIN = 1e-9


def best_tour(costs: FloatArray) -> IntArray:
    """Order of the nodes 1..N (N,) int64 for costs (N+1, N+1), costs[i, j] = from i to j; column 0 is not read."""
    costs = np.ascontiguousarray(costs, dtype=np.float64)
    count = len(costs) - 1
    if count <= EXACT_LIMIT:
        return _exact(costs)
    return _local_search(costs, ROUNDS, SEED)


@kernel
def tour_cost(costs: FloatArray, order: IntArray) -> float:
    """Sum of the costs from node 0 along ``order``."""
    total = 0.0
    at = 0
    for n in range(len(order)):
        total += costs[at, order[n]]
        at = order[n]
    return total


@kernel
def _exact(costs: FloatArray) -> IntArray:
    count = costs.shape[0] - 1
    order = np.zeros(count, dtype=np.int64)
    if count == 0:
        return order
    size = 1 << count
    best = np.full((size, count), np.inf)
    came_from = np.full((size, count), -1, dtype=np.int64)
    for last in range(count):
        best[1 << last, last] = costs[0, last + 1]
    for visited in range(1, size):
        for last in range(count):
            here = best[visited, last]
            if here == np.inf:
                continue
            for following in range(count):
                if visited & (1 << following):
                    continue
                reached = visited | (1 << following)
                cost = here + costs[last + 1, following + 1]
                if cost < best[reached, following]:
                    best[reached, following] = cost
                    came_from[reached, following] = last
    visited = size - 1
    last = int(np.argmin(best[visited]))
    for n in range(count - 1, -1, -1):
        order[n] = last + 1
        before = came_from[visited, last]
        visited ^= 1 << last
        last = before
    return order


@kernel
def _nearest_first(costs: FloatArray) -> IntArray:
    count = costs.shape[0] - 1
    order = np.zeros(count, dtype=np.int64)
    used = np.zeros(count + 1, dtype=np.bool_)
    at = 0
    for n in range(count):
        best = -1
        for node in range(1, count + 1):
            if not used[node] and (best < 0 or costs[at, node] < costs[at, best]):
                best = node
        order[n] = best
        used[best] = True
        at = best
    return order


@kernel
def _moved(order: IntArray, first: int, length: int, to: int, reverse: bool) -> IntArray:
    """Copy of ``order`` with the segment [first, first+length) cut out and put back before position ``to`` of the rest."""
    rest = np.concatenate((order[:first], order[first + length :]))
    segment = order[first : first + length].copy()
    if reverse:
        segment = segment[::-1].copy()
    return np.concatenate((rest[:to], segment, rest[to:]))


@kernel
def _improve(costs: FloatArray, order: IntArray) -> IntArray:
    """Or-opt (segments of 1 to 3, either way round) and 2-opt, with the true asymmetric cost of a reversed stretch."""
    count = len(order)
    better = True
    while better:
        better = False
        for length in range(1, 4):
            for first in range(count - length + 1):
                head, tail = order[first], order[first + length - 1]
                before = order[first - 1] if first > 0 else 0
                after = order[first + length] if first + length < count else -1
                inner, backward = 0.0, 0.0
                for m in range(first, first + length - 1):
                    inner += costs[order[m], order[m + 1]]
                    backward += costs[order[m + 1], order[m]]
                removed = costs[before, head] + inner
                if after >= 0:
                    removed += costs[tail, after] - costs[before, after]
                best_gain, best_to, best_reverse = _MIN_GAIN, -1, False
                for to in range(count - length + 1):
                    # neighbours in the order without the segment
                    left = 0 if to == 0 else (order[to - 1] if to - 1 < first else order[to - 1 + length])
                    right = -1 if to == count - length else (order[to] if to < first else order[to + length])
                    closing = costs[left, right] if right >= 0 else 0.0
                    forward_cost = costs[left, head] + inner + (costs[tail, right] if right >= 0 else 0.0) - closing
                    reverse_cost = costs[left, tail] + backward + (costs[head, right] if right >= 0 else 0.0) - closing
                    if removed - forward_cost > best_gain and to != first:
                        best_gain, best_to, best_reverse = removed - forward_cost, to, False
                    if removed - reverse_cost > best_gain:
                        best_gain, best_to, best_reverse = removed - reverse_cost, to, True
                if best_to >= 0:
                    order = _moved(order, first, length, best_to, best_reverse)
                    better = True
        for first in range(count - 1):
            before = order[first - 1] if first > 0 else 0
            change = 0.0
            for last in range(first + 1, count):
                change += costs[order[last], order[last - 1]] - costs[order[last - 1], order[last]]
                delta = change + costs[before, order[last]] - costs[before, order[first]]
                if last + 1 < count:
                    delta += costs[order[first], order[last + 1]] - costs[order[last], order[last + 1]]
                if delta < -_MIN_GAIN:
                    order[first : last + 1] = order[first : last + 1][::-1].copy()
                    better = True
                    break
    return order


@kernel
def _kicked(order: IntArray) -> IntArray:
    """Double bridge: two neighbouring stretches change places, nothing is turned round."""
    count = len(order)
    a = np.random.randint(0, count - 1)  # noqa: NPY002
    b = np.random.randint(a + 1, count)  # noqa: NPY002
    c = np.random.randint(b, min(b + 10, count)) + 1  # noqa: NPY002
    out = order.copy()
    n = a
    for m in range(b, c):
        out[n] = order[m]
        n += 1
    for m in range(a, b):
        out[n] = order[m]
        n += 1
    return out


@kernel
def _local_search(costs: FloatArray, rounds: int, seed: int) -> IntArray:
    np.random.seed(seed)  # noqa: NPY002 - numba's own generator, private to compiled code
    best = _improve(costs, _nearest_first(costs))
    best_cost = tour_cost(costs, best)
    for _ in range(rounds):
        order = _improve(costs, _kicked(best))
        cost = tour_cost(costs, order)
        if cost < best_cost - _MIN_GAIN:
            best, best_cost = order, cost
    return best


def warm_up() -> None:
    """Compile both searches."""
    costs = np.arange(169.0).reshape(13, 13)
    best_tour(costs[:4, :4].copy())
    best_tour(costs)
    tour_cost(costs, np.arange(1, 13))
