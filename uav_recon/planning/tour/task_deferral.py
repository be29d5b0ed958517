"""Deferral of small tasks, so that a tour reaches the large ones early (not in the paper).

The gain of a frontier is the number of unknown voxels beyond it. The gain of surface is the sum of |n.v| sigma over its
elements, about one per voxel of uncertain surface. So both are compared directly. A deferred task is evaluated again by the
next plan, and comes last.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uav_recon.planning.tour.stopping_rule import VIEW_S
from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.tasks import Task

NOW_SHARE = 0.2  # tasks below this share of the best task's gain per second are deferred
LEAVE_SHARE = 0.1  # a room is left when the best task in it has less than this share of the best gain per second elsewhere


def not_deferred(tasks: Sequence[Task], costs_s: FloatArray, rooms: IntArray | None = None) -> BoolArray:
    """Return a mask (N,) of the tasks that are not deferred.

    The best task has the most gain per second of the path to it. For a task beside that path only the detour counts. While the
    room of the vehicle has a task with LEAVE_SHARE of that gain per second, the best one is that of the room: so the room is
    finished before it is left.

    costs_s: (N + 1, N + 1) seconds; node 0 is the vehicle, node n is tasks[n - 1]. rooms: (N + 1,) their
    rooms; None = one room.
    """
    if not tasks:
        return np.zeros(0, dtype=np.bool_)
    gain = np.array([task.gain for task in tasks])
    rate = gain / (costs_s[0, 1:] + VIEW_S)
    best = int(np.argmax(rate))
    if rooms is not None:
        inside = int(np.argmax(np.where(rooms[1:] == rooms[0], rate, -1.0)))
        best = inside if rooms[1 + inside] == rooms[0] and rate[inside] >= LEAVE_SHARE * rate[best] else best
    detour_s = np.maximum(costs_s[0, 1:] + costs_s[1:, best + 1] - costs_s[0, best + 1], 0.0) + VIEW_S
    now: BoolArray = np.maximum(rate, gain / detour_s) >= NOW_SHARE * rate[best]
    return now
