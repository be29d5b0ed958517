"""Which tasks can wait: a tour that takes every near trifle first reaches the next room late (no counterpart in the paper).

A frontier gains the unknown voxels beyond it, surface the sum of |n.v| sigma over its elements: about one for each voxel of
uncertain surface, so both are weighed alike. What waits is asked again by the next plan, and comes last.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uav_recon.planning.tour.stopping_rule import VIEW_S
from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.tasks import Task

NOW_SHARE = 0.2  # of the best task's gain per second: less can wait


def not_deferred(tasks: Sequence[Task], costs_s: FloatArray) -> BoolArray:
    """Tell which tasks (N,) are not to wait. costs_s: (N + 1, N + 1) seconds, node 0 the vehicle, node n tasks[n - 1]'s place.

    The best task gains most per second of the way to it; of a task beside that way only the detour counts.
    """
    if not tasks:
        return np.zeros(0, dtype=np.bool_)
    gain = np.array([task.gain for task in tasks])
    rate = gain / (costs_s[0, 1:] + VIEW_S)
    best = int(np.argmax(rate))
    detour_s = np.maximum(costs_s[0, 1:] + costs_s[1:, best + 1] - costs_s[0, best + 1], 0.0) + VIEW_S
    now: BoolArray = np.maximum(rate, gain / detour_s) >= NOW_SHARE * rate[best]
    return now
