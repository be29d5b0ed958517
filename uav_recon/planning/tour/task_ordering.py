"""Ordering and selection of the tasks to fly: the paper's tour, and those of its baselines.

An ordering holds the state of one flight (see StoppingRule): make a new one for each planner.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from uav_recon.planning.tour.atsp import best_tour
from uav_recon.planning.tour.stopping_rule import VIEW_S, KeptTour, StoppingRule
from uav_recon.planning.tour.task_deferral import not_deferred
from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.tasks import Task, TaskKind

DETOUR_SHARE = 0.5  # share of the time to the next frontier that may be spent on surface beside the path ...
DETOUR_S = 3.0  # ... or this time, if it is longer
ROOM_CHANGE_S = 20.0  # price of a change of the room in a tour


class TaskOrdering(Protocol):
    """Orders the tasks of one plan. Call it once per plan. Never blocks."""

    def order(self, tasks: Sequence[Task], costs_s: FloatArray, rooms: IntArray | None = None) -> KeptTour:
        """Return the nodes to fly to, in order.

        costs_s: (N + 1, N + 1) seconds; node 0 is the vehicle, node n is tasks[n - 1]. rooms: (N + 1,) labels of their
        rooms, see planning.tour.rooms; None = one room.
        """
        ...


class Tour:
    """The paper's ordering: the shortest open tour.

    Beyond the paper, it leaves out deferred tasks and tasks that are not worth their flight, and a change of the room has a
    price, so that a room is left once, finished.
    """

    def __init__(self, stopping_rule: StoppingRule) -> None:
        self._stopping_rule = stopping_rule

    def order(self, tasks: Sequence[Task], costs_s: FloatArray, rooms: IntArray | None = None) -> KeptTour:
        """See TaskOrdering."""
        rooms = np.zeros(len(tasks) + 1, dtype=np.int64) if rooms is None else rooms
        now = not_deferred(tasks, costs_s, rooms)
        kept = self._of(now, tasks, costs_s, rooms)
        return kept if len(kept.order) or now.all() else self._of(~now, tasks, costs_s, rooms)

    def _of(self, which: BoolArray, tasks: Sequence[Task], costs_s: FloatArray, rooms: IntArray) -> KeptTour:
        """Return the tour of the tasks selected by a mask (N,)."""
        nodes = np.flatnonzero(np.concatenate(([True], which)))
        costs_s, rooms = np.ascontiguousarray(costs_s[nodes][:, nodes]), rooms[nodes]
        tour = best_tour(costs_s + ROOM_CHANGE_S * (rooms[:, None] != rooms[None, :]))
        kept = self._stopping_rule.keep([tasks[node - 1] for node in nodes[1:]], costs_s, tour)
        return KeptTour(nodes[kept.order], kept.dropped)


class Greedy:
    """EVPP's ordering: only the view with the most gain per second of flight; then plan again."""

    def __init__(self, stopping_rule: StoppingRule) -> None:
        self._stopping_rule = stopping_rule

    def order(self, tasks: Sequence[Task], costs_s: FloatArray, rooms: IntArray | None = None) -> KeptTour:
        """See TaskOrdering. It does not regard rooms."""
        best = [best_by_rate(tasks, costs_s)] if len(tasks) else []
        return self._stopping_rule.keep(tasks, costs_s, np.array(best, dtype=np.int64))


def best_by_rate(tasks: Sequence[Task], costs_s: FloatArray) -> int:
    """Return the node of the task with the most gain per second of the flight to it."""
    gain = np.array([task.gain for task in tasks])
    return int(np.argmax(gain / (costs_s[0, 1:] + VIEW_S))) + 1


class FrontierWithDetours:
    """VPP's ordering: the nearest frontier, with views of uncertain surface on the path to it.

    Without a frontier, surface is viewed nearest first.
    """

    def __init__(self, stopping_rule: StoppingRule) -> None:
        self._stopping_rule = stopping_rule

    def order(self, tasks: Sequence[Task], costs_s: FloatArray, rooms: IntArray | None = None) -> KeptTour:
        """See TaskOrdering. It does not regard rooms."""
        frontiers = [n for n, task in enumerate(tasks, 1) if task.kind is TaskKind.EXPLORE]
        surface = [n for n, task in enumerate(tasks, 1) if task.kind is TaskKind.RECONSTRUCT]
        if not frontiers:
            return self._stopping_rule.keep(tasks, costs_s, np.array(_nearest_first(surface, costs_s), dtype=np.int64))
        goal = min(frontiers, key=lambda n: (costs_s[0, n], n))
        return self._stopping_rule.keep(tasks, costs_s, np.array(_with_detours(goal, surface, tasks, costs_s), dtype=np.int64))


def _nearest_first(nodes: list[int], costs_s: FloatArray) -> list[int]:
    left, order, at = list(nodes), [], 0
    while left:
        at = min(left, key=lambda n, at=at: (costs_s[at, n], n))  # type: ignore[misc]
        left.remove(at)
        order.append(at)
    return order


def _with_detours(goal: int, surface: list[int], tasks: Sequence[Task], costs_s: FloatArray) -> list[int]:
    """Return the nodes up to ``goal``, with surface tasks inserted where they cost least.

    Tasks with the most gain per second are inserted first, until the detour allowance is used.
    """
    allowance_s = max(DETOUR_SHARE * costs_s[0, goal], DETOUR_S)
    way, left = [goal], list(surface)
    while left:
        # (gain per second, task, insertion index, seconds) of the cheapest insertion of each task that still fits
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
