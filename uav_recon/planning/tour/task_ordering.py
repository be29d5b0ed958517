"""Which tasks are flown to, and in which order: the paper's tour, and what its baselines do instead.

A choice has the memory of one flight (see Worth): make a new one for each planner.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from uav_recon.planning.tour.atsp import best_tour
from uav_recon.planning.tour.stopping_rule import VIEW_S, KeptTour, StoppingRule
from uav_recon.planning.tour.task_deferral import not_deferred
from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.tasks import Task, TaskKind

DETOUR_SHARE = 0.5  # of the seconds to the next frontier that may be spent on surface beside the way ...
DETOUR_S = 3.0  # ... or so many, if that is more


class TaskOrdering(Protocol):
    """Orders the tasks of one plan; to be asked once a plan. Never blocks."""

    def order(self, tasks: Sequence[Task], costs_s: FloatArray) -> KeptTour:
        """Nodes to fly to, in order. costs_s: (N + 1, N + 1) seconds, node 0 the vehicle, node n the place of tasks[n - 1]."""
        ...


class Tour:
    """The paper's: the shortest open tour through all tasks, less what can wait and what is not worth its flight."""

    def __init__(self, worth: StoppingRule) -> None:
        self._worth = worth

    def order(self, tasks: Sequence[Task], costs_s: FloatArray) -> KeptTour:
        """See Choice."""
        now = not_deferred(tasks, costs_s)
        kept = self._of(now, tasks, costs_s)
        return kept if len(kept.order) or now.all() else self._of(~now, tasks, costs_s)

    def _of(self, which: BoolArray, tasks: Sequence[Task], costs_s: FloatArray) -> KeptTour:
        """The tour of some tasks (N,)."""
        if which.all():
            return self._worth.keep(tasks, costs_s, best_tour(costs_s))
        nodes = np.flatnonzero(np.concatenate(([True], which)))
        costs_s = np.ascontiguousarray(costs_s[nodes][:, nodes])
        kept = self._worth.keep([tasks[node - 1] for node in nodes[1:]], costs_s, best_tour(costs_s))
        return KeptTour(nodes[kept.order], kept.dropped)


class Greedy:
    """EVPP's: the one view that gains most per second of flight; then plan anew."""

    def __init__(self, worth: StoppingRule) -> None:
        self._worth = worth

    def order(self, tasks: Sequence[Task], costs_s: FloatArray) -> KeptTour:
        """See Choice."""
        gain = np.array([task.gain for task in tasks])
        best = np.argmax(gain / (costs_s[0, 1:] + VIEW_S)) + 1 if len(tasks) else np.zeros(0)
        return self._worth.keep(tasks, costs_s, np.atleast_1d(best).astype(np.int64))


class ByTheWay:
    """VPP's: the nearest frontier is next, and uncertain surface is looked at on the way to it.

    Without a frontier, surface is looked at nearest first.
    """

    def __init__(self, worth: StoppingRule) -> None:
        self._worth = worth

    def order(self, tasks: Sequence[Task], costs_s: FloatArray) -> KeptTour:
        """See Choice."""
        frontiers = [n for n, task in enumerate(tasks, 1) if task.kind is TaskKind.EXPLORE]
        surface = [n for n, task in enumerate(tasks, 1) if task.kind is TaskKind.RECONSTRUCT]
        if not frontiers:
            return self._worth.keep(tasks, costs_s, np.array(_nearest_first(surface, costs_s), dtype=np.int64))
        goal = min(frontiers, key=lambda n: (costs_s[0, n], n))
        return self._worth.keep(tasks, costs_s, np.array(_with_detours(goal, surface, tasks, costs_s), dtype=np.int64))


def _nearest_first(nodes: list[int], costs_s: FloatArray) -> list[int]:
    left, order, at = list(nodes), [], 0
    while left:
        at = min(left, key=lambda n, at=at: (costs_s[at, n], n))  # type: ignore[misc]
        left.remove(at)
        order.append(at)
    return order


def _with_detours(goal: int, surface: list[int], tasks: Sequence[Task], costs_s: FloatArray) -> list[int]:
    """The way to ``goal`` with views put in where they cost least: what gains most per second first, within the allowance."""
    allowance_s = max(DETOUR_SHARE * costs_s[0, goal], DETOUR_S)
    way, left = [goal], list(surface)
    while left:
        # (gain per second, which, where, seconds) of the cheapest place in the way for each task that still fits
        fits = []
        for node in left:
            befores = [0, *way[:-1]]
            extra_s = [
                float(costs_s[a, node] + costs_s[node, b] - costs_s[a, b]) + VIEW_S for a, b in zip(befores, way, strict=True)
            ]
            where = int(np.argmin(extra_s))
            if extra_s[where] <= allowance_s:
                fits.append((tasks[node - 1].gain / max(extra_s[where], VIEW_S), -node, where, extra_s[where]))
        if not fits:
            break
        _, negative, where, seconds = max(fits)
        way.insert(where, -negative)
        left.remove(-negative)
        allowance_s -= seconds
    return way
