"""Iterated local search for open asymmetric tours, with a fixed seed and kick count.

Thus the result is the same on every machine.

Moves: or-3opt, the exchange of two stretches without reversal (Kanellakis and Papadimitriou, 1980), and 2-opt with the true
cost of the reversed stretch; neighbour lists and don't-look bits after Bentley (1992). Kicks: double bridges (Martin, Otto
and Felten, 1991) of short stretches, so that a tour is disturbed in one region only.

A tour in this module is a circle (n+1,): order[0] = order[n] = node 0, and the return to node 0 costs nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import BoolArray, FloatArray, IntArray

NodeArray = NDArray[np.uint32]  # unsigned: avoids the test for a negative index; + 0 converts to int64
NEIGHBOURS = 10
KICK_REACH = 8  # longest stretch that a kick moves
MIN_GAIN = 1e-9


@kernel
def _nearest(costs: FloatArray, count: int) -> NodeArray:
    """Return, for each node, the ``count`` cheapest successors, cheapest first."""
    n = len(costs)
    near = np.empty((n, count), dtype=np.uint32)
    for a in range(n):
        row, found = costs[a], near[a]
        size = 0
        for b in range(n):
            if b == a or (size == count and row[b] >= row[found[count - 1]]):
                continue
            at = size if size < count else count - 1
            while at > 0 and row[b] < row[found[at - 1]]:
                found[at] = found[at - 1]
                at -= 1
            found[at] = b
            size = min(size + 1, count)
    return near


@kernel
def _nearest_first(costs: FloatArray) -> NodeArray:
    """Return the greedy tour (n+1,) from 0 back to 0."""
    n = len(costs)
    order = np.zeros(n + 1, dtype=np.uint32)
    used = np.zeros(n, dtype=np.bool_)
    at = 0
    for m in range(1, n):
        best = -1
        for node in range(1, n):
            if not used[node] and (best < 0 or costs[at, node] < costs[at, best]):
                best = node
        order[m] = best
        used[best] = True
        at = best
    return order


@kernel
def _exchange(order: NodeArray, spare: NodeArray, first: int, middle: int, last: int) -> None:
    """Exchange the stretches [first, middle) and [middle, last)."""
    m = 0
    for k in range(middle, last):
        spare[m] = order[k]
        m += 1
    for k in range(first, middle):
        spare[m] = order[k]
        m += 1
    for k in range(m):
        order[first + k] = spare[k]


@kernel
def _note(costs: FloatArray, order: NodeArray, place: NodeArray, ahead: FloatArray, back: FloatArray, first: int) -> None:
    """Update node positions and cumulative costs from position ``first`` > 0 on.

    place: position of each node in the tour.
    ahead: cost of the tour up to each position.
    back: the same in the reverse direction.
    """
    before = order[first - 1]
    for m in range(first, len(order) - 1):
        node = order[m]
        place[node] = m
        ahead[m] = ahead[m - 1] + costs[before, node]
        back[m] = back[m - 1] + costs[node, before]
        before = node
    ahead[len(order) - 1] = ahead[len(order) - 2]  # the return is free


@kernel
def _better_exchange(
    costs: FloatArray,
    order: NodeArray,
    place: NodeArray,
    ahead: FloatArray,
    near: NodeArray,
    near_before: NodeArray,
    node: int,
) -> tuple[int, int, int]:
    """Find an exchange with a gain: a cut after ``node`` and two more cuts.

    Returns the sorted cuts, or (-1, -1, -1). Each cut's tail is joined to the head of the next cut in the circle.
    """
    n = len(order) - 1
    p = place[node] + 0
    after = order[p + 1]
    leaving = costs[node, after]
    for m in range(near.shape[1]):
        head = near[node, m]
        gain1 = leaving - costs[node, head]
        if gain1 <= MIN_GAIN:
            break
        q = (place[head] - 1) if head > 0 else n - 1
        if q == p:
            continue
        tail = order[q]
        gain2 = gain1 + costs[tail, head] - MIN_GAIN
        for k in range(near_before.shape[1]):
            end = near_before[after, k]
            gain3 = gain2 - costs[end, after]
            if gain3 <= 0.0:
                break
            r = place[end] + 0
            in_order = q < r < p if q < p else (r > q or r < p)
            if in_order and gain3 + (ahead[r + 1] - ahead[r]) > costs[tail, order[r + 1]]:
                a, c = min(p, q, r), max(p, q, r)
                return a, p + q + r - a - c, c
    return -1, -1, -1


@kernel
def _better_turn(
    costs: FloatArray,
    order: NodeArray,
    place: NodeArray,
    ahead: FloatArray,
    back: FloatArray,
    near: NodeArray,
    near_before: NodeArray,
    node: int,
) -> tuple[int, int]:
    """Find a stretch [first, last] beside ``node`` whose reversal has a gain.

    Returns (-1, -1) if there is none. The stretch begins after the node or ends before it.
    """
    p = place[node] + 0
    first = p + 1
    leaving = ahead[first] - ahead[p]
    for m in range(near.shape[1]):
        new_first = near[node, m]
        last = place[new_first] + 0
        if last > first:
            gain = leaving - costs[node, new_first] + ahead[last + 1] - ahead[first] - (back[last] - back[first])
            if gain - costs[order[first], order[last + 1]] > MIN_GAIN:
                return first, last
    last = p - 1
    for m in range(near_before.shape[1] if last > 0 else 0):
        new_last = near_before[node, m]
        first = place[new_last] + 0
        if 0 < first < last:
            gain = ahead[p] - ahead[first - 1] - costs[new_last, node] - (back[last] - back[first])
            if gain - costs[order[first - 1], order[last]] > MIN_GAIN:
                return first, last
    return -1, -1


@kernel
def _enqueue(queue: NodeArray, waiting: BoolArray, size: int, node: int) -> int:
    if not waiting[node]:
        waiting[node] = True
        queue[size] = node
        size += 1
    return size


@kernel
def _settle(
    costs: FloatArray,
    order: NodeArray,
    place: NodeArray,
    ahead: FloatArray,
    back: FloatArray,
    near: NodeArray,
    near_before: NodeArray,
    queue: NodeArray,
    waiting: BoolArray,
    size: int,
    spare: NodeArray,
) -> None:
    """Improve around the queued nodes until none of them has a move with a gain."""
    while size > 0:
        size -= 1
        node = queue[size]
        waiting[node] = False
        a, b, c = _better_exchange(costs, order, place, ahead, near, near_before, node)
        if a >= 0:
            for cut in (a, b, c):
                size = _enqueue(queue, waiting, size, order[cut])
                size = _enqueue(queue, waiting, size, order[cut + 1])
            _exchange(order, spare, a + 1, b + 1, c + 1)
            _note(costs, order, place, ahead, back, a + 1)
            continue
        first, last = _better_turn(costs, order, place, ahead, back, near, near_before, node)
        if first >= 0:
            for cut in (first - 1, last):
                size = _enqueue(queue, waiting, size, order[cut])
                size = _enqueue(queue, waiting, size, order[cut + 1])
            changed = first
            while first < last:
                order[first], order[last] = order[last], order[first]
                first += 1
                last -= 1
            _note(costs, order, place, ahead, back, changed)


@kernel
def search_tour(given: FloatArray, rounds: int, seed: int) -> IntArray:
    """Return a good order of 1..N for N >= 4, better with more rounds.

    The result is the same for the same arguments.
    """
    n = len(given)
    costs = given.copy()
    costs[:, 0] = 0.0  # the tour is open: the return costs nothing
    near, near_before = _nearest(costs, min(NEIGHBOURS, n - 1)), _nearest(costs.T.copy(), min(NEIGHBOURS, n - 1))
    order = _nearest_first(costs)
    place, queue, spare = np.zeros(n, dtype=np.uint32), np.empty(n, dtype=np.uint32), np.empty(n, dtype=np.uint32)
    ahead, back = np.zeros(n + 1), np.zeros(n + 1)
    waiting = np.ones(n, dtype=np.bool_)
    for m in range(n):
        queue[m] = order[n - 1 - m]
    _note(costs, order, place, ahead, back, 1)
    _settle(costs, order, place, ahead, back, near, near_before, queue, waiting, n, spare)
    best = order.copy()
    best_cost = ahead[n]
    state = seed
    reach = min(KICK_REACH, (n - 1) // 3)
    for _ in range(rounds):
        # double bridge of four neighbouring cuts: three short stretches in the opposite order, none of them reversed
        state = state * 6364136223846793005 + 1442695040888963407  # Knuth's MMIX generator; its low bits are the weak ones
        draw = (state >> 20) & 0x7FFFFFFFFFF
        length1, draw = 1 + draw % reach, draw // reach
        length2, draw = 1 + draw % reach, draw // reach
        length3, draw = 1 + draw % reach, draw // reach
        first = 1 + draw % (n - length1 - length2 - length3)
        second, third, end = first + length1, first + length1 + length2, first + length1 + length2 + length3
        size = 0
        for cut in (first, second, third, end):
            size = _enqueue(queue, waiting, size, order[cut - 1])
            size = _enqueue(queue, waiting, size, order[cut])
        _exchange(order, spare, first, third, end)
        _exchange(order, spare, first + length3, first + length3 + length1, end)
        _note(costs, order, place, ahead, back, first)
        _settle(costs, order, place, ahead, back, near, near_before, queue, waiting, size, spare)
        if ahead[n] <= best_cost + MIN_GAIN:
            best_cost = ahead[n]
            for m in range(n):
                best[m] = order[m]
        else:
            for m in range(n):
                order[m] = best[m]
            _note(costs, order, place, ahead, back, 1)
    return best[1:n].astype(np.int64)


def warm_up() -> None:
    """Compile the kernels."""
    search_tour(np.arange(289.0).reshape(17, 17), 3, 1)
