"""Stopping rule: drops tasks that gain too little for their flight time.

It is not in the paper. The rule is the marginal value theorem (Charnov, 1976): continue while a second of flight gains more
than a fixed share of the gain per second of the best tour of this flight. Both sides have the same unit, so the rule holds
for any scale of the uncertainty and any room size. Viewed surface counts less and less, so the reconstruction ends. Openings
are not weighed, because unknown space may contain anything. A gap in front of a wall counts by its unknown voxels, like
surface: a voxel of uncertain surface has about the same gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_recon.planning.frontier.cluster_table import OPENING
from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.tasks import Task, TaskKind

VIEW_S = 0.5  # time at a view: braking, image capture, acceleration
SHORTEST_TOUR_S = 10.0  # min. duration of a tour in the rule: one good view next to the vehicle must not set the standard
_NONE = (0, 0)


@dataclass(frozen=True, slots=True, eq=False)
class KeptTour:
    """A tour after the stopping rule.

    order: (K,) remaining nodes in tour order.
    dropped: number of surface tasks not worth their flight.
    """

    order: IntArray
    dropped: int


class StoppingRule:
    """Drops stretches of surface tasks that are not worth their flight time.

    It holds the state of one flight: the best gain per second of all tours. keep() must be called once per plan.

    share: min. gain per second of a stretch of surface tasks, as a share of that best value.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self._best_per_s = 0.0

    def keep(self, tasks: Sequence[Task], costs_s: FloatArray, order: IntArray) -> KeptTour:
        """Remove the stretches of surface tasks that are not worth the seconds they add to the tour.

        costs_s: (N + 1, N + 1) seconds from node to node; node 0 is the vehicle, node n is tasks[n - 1].
        order: (N,) nodes 1..N of an open tour.
        """
        nodes = [int(node) for node in order]
        gain = np.array([0.0, *(task.gain for task in tasks)])
        surface = np.array([False, *(task.kind is TaskKind.RECONSTRUCT or task.gain < OPENING for task in tasks)])
        self._best_per_s = max(self._best_per_s, _per_second(nodes, gain, surface, costs_s))
        while True:
            first, last = _worst_stretch(nodes, gain, surface, costs_s, self._share * self._best_per_s)
            if (first, last) == _NONE:
                return KeptTour(np.array(nodes, dtype=np.int64), len(order) - len(nodes))
            del nodes[first:last]


def _per_second(nodes: list[int], gain: FloatArray, surface: BoolArray, costs_s: FloatArray) -> float:
    """Return the gain of the surface tasks of a tour per second of the flight to them."""
    legs_s = sum(costs_s[a, b] + VIEW_S for a, b in zip([0, *nodes], nodes, strict=False) if surface[b])
    return float(sum(gain[node] for node in nodes if surface[node]) / max(legs_s, SHORTEST_TOUR_S))


def _worst_stretch(
    nodes: list[int], gain: FloatArray, surface: BoolArray, costs_s: FloatArray, min_per_s: float
) -> tuple[int, int]:
    """Return the stretch of consecutive surface tasks whose removal saves most, or _NONE.

    A stretch is its first index and one past its last index.
    """
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
