"""When to stop looking: a stretch of surface tasks must gain enough for the flight that it takes (no counterpart in the paper).

The rule is the marginal value theorem's (Charnov, 1976): go on as long as a second of flight gains more than a fixed share of
what a second gained in the best tour of this flight so far. Both sides are in the same unit, whatever that is, so the rule
holds for any scale of the uncertainty and any size of room; and since surface that was looked at counts for less, it ends.
Exploration is not weighed: space that is not known may hold anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.tasks import Task, TaskKind

VIEW_S = 0.5  # at a view: braking, the picture, and off again
SHORTEST_TOUR_S = 10.0  # a shorter one is reckoned as this long: one good view next to the vehicle sets no standard
_NONE = (0, 0)


@dataclass(frozen=True, slots=True, eq=False)
class KeptTour:
    """order: (K,) nodes of the tour that is left, in its order; dropped: how many surface tasks were not worth their flight."""

    order: IntArray
    dropped: int


class StoppingRule:
    """Memory of one flight: the best that a tour has gained per second. keep() is to be called once for each plan.

    share: of that best, which a stretch of surface tasks must gain per second.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self._best_per_s = 0.0

    def keep(self, tasks: Sequence[Task], costs_s: FloatArray, order: IntArray) -> KeptTour:
        """Leave out of a tour the stretches of surface tasks that are not worth the seconds that they add to it.

        costs_s: (N + 1, N + 1) seconds from node to node, node 0 the vehicle, node n the place of tasks[n - 1]. order: (N,)
        nodes 1..N of an open tour.
        """
        nodes = [int(node) for node in order]
        gain = np.array([0.0, *(task.gain for task in tasks)])
        surface = np.array([False, *(task.kind is TaskKind.RECONSTRUCT for task in tasks)])
        self._best_per_s = max(self._best_per_s, _per_second(nodes, gain, surface, costs_s))
        while True:
            first, last = _worst_stretch(nodes, gain, surface, costs_s, self._share * self._best_per_s)
            if (first, last) == _NONE:
                return KeptTour(np.array(nodes, dtype=np.int64), len(order) - len(nodes))
            del nodes[first:last]


def _per_second(nodes: list[int], gain: FloatArray, surface: BoolArray, costs_s: FloatArray) -> float:
    """What the surface tasks of a tour gain in a second of the flight to them."""
    legs_s = sum(costs_s[a, b] + VIEW_S for a, b in zip([0, *nodes], nodes, strict=False) if surface[b])
    return float(sum(gain[node] for node in nodes if surface[node]) / max(legs_s, SHORTEST_TOUR_S))


def _worst_stretch(
    nodes: list[int], gain: FloatArray, surface: BoolArray, costs_s: FloatArray, min_per_s: float
) -> tuple[int, int]:
    """First and one past last index of the consecutive surface tasks whose removal saves most; _NONE if none does."""
    worst, least = _NONE, -1e-9
    for first in range(len(nodes)):
        before = nodes[first - 1] if first else 0
        at, seconds, gained = before, 0.0, 0.0
        for last in range(first, len(nodes)):
            if not surface[nodes[last]]:
                break
            seconds += costs_s[at, nodes[last]] + VIEW_S
            gained += gain[nodes[last]]
            at = nodes[last]
            saved_s = seconds
            if last + 1 < len(nodes):
                saved_s += costs_s[at, nodes[last + 1]] - costs_s[before, nodes[last + 1]]
            if gained - min_per_s * saved_s < least:
                worst, least = (first, last + 1), gained - min_per_s * saved_s
    return worst
