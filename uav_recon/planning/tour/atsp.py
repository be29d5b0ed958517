"""Open asymmetric travelling salesman problem: the order of the tasks.

Paper, section III-C. A tour starts at node 0 (the vehicle), visits nodes 1..N once each and ends anywhere. The solution is
exact for N <= EXACT_LIMIT (Held and Karp, 1962). Beyond that it is a local search limited by a count and not by a clock, so
the same costs give the same tour.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.planning.tour import local_search
from uav_recon.planning.tour.local_search import search_tour
from uav_recon.types.frames import FloatArray, IntArray

EXACT_LIMIT = 11
SEED = 20240410


def best_tour(costs: FloatArray) -> IntArray:
    """Return the order (N,) int64 of the nodes 1..N for costs (N+1, N+1).

    costs[i, j] is the cost from i to j; column 0 is not read.
    """
    costs = np.ascontiguousarray(costs, dtype=np.float64)
    count = len(costs) - 1
    if count <= EXACT_LIMIT:
        return exact_tour(costs)
    return search_tour(costs, rounds_for(count), SEED)


def rounds_for(count: int) -> int:
    """Return the number of kicks for ``count`` tasks: 48 for 20 tasks, 239 for 50.

    With it a tour is, on average, within 0.2 % of the best one.
    """
    return 12 + count * count // 11


@kernel
def tour_cost(costs: FloatArray, order: IntArray) -> float:
    """Return the sum of the costs from node 0 along ``order``."""
    total = 0.0
    at = 0
    for n in range(len(order)):
        total += costs[at, order[n]]
        at = order[n]
    return total


@kernel
def exact_tour(costs: FloatArray) -> IntArray:
    """Return the cheapest order. Time and memory double with each node."""
    count = costs.shape[0] - 1
    order = np.zeros(count, dtype=np.int64)
    if count == 0:
        return order
    size = 1 << count
    best = np.full((size, count), np.inf)  # best[visited, last]; infinite if last is not in visited
    into = costs[1:, 1:].T.copy()  # into[b, a]: from a to b
    for last in range(count):
        best[1 << last, last] = costs[0, last + 1]
    for visited in range(1, size - 1):
        here = best[visited]
        for following in range(count):
            if visited & (1 << following):
                continue
            from_each = into[following]
            least = np.inf
            for last in range(count):
                cost = here[last] + from_each[last]
                least = cost if cost < least else least
            best[visited | (1 << following), following] = least
    visited = size - 1
    last = int(np.argmin(best[visited]))
    for n in range(count - 1, 0, -1):
        order[n] = last + 1
        reached = best[visited, last]
        visited ^= 1 << last
        for before in range(count):
            if best[visited, before] + into[last, before] == reached:
                last = before
                break
    order[0] = last + 1
    return order


def warm_up() -> None:
    """Compile both searches."""
    costs = np.arange(16.0).reshape(4, 4)
    exact_tour(costs)
    tour_cost(costs, np.arange(1, 4))
    local_search.warm_up()
