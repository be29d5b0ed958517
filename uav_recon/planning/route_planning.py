"""The route to a given position, for example home, without a view to take."""

from __future__ import annotations

import numpy as np

from uav_recon.planning.candidate_view import CandidateView, PlanningContext
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

NEAR_ENOUGH_M = 0.4  # if the column above the pad is not flyable, a cell beside it is used


def route_to(context: PlanningContext, goal: Viewpoint) -> CandidateView | None:
    """Return the reachable cell nearest to ``goal`` as a candidate view.

    Returns None if all reachable cells are farther away than NEAR_ENOUGH_M.
    """
    space = context.space
    at = space.padded_from_world(goal.position_world)
    reach = NEAR_ENOUGH_M / space.grid.resolution_m
    low = np.clip(np.floor(at - reach), 0, space.reachable.shape).astype(np.int64)
    high = np.clip(np.floor(at + reach) + 1, 0, space.reachable.shape).astype(np.int64)
    around = space.reachable[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
    cells = np.argwhere(around) + low
    if not len(cells):
        return None
    away = np.linalg.norm(cells + 0.5 - at, axis=1)
    nearest = int(np.argmin(away))
    if away[nearest] > reach:
        return None
    place = cells[nearest] + 0.5
    place_world = space.world_from_padded(place)
    task = Task(TaskKind.EXPLORE, place_world, Viewpoint(place_world, goal.yaw_rad, goal.pitch_down_rad), 0.0)
    nothing = np.zeros(0, dtype=np.int64)
    return CandidateView(task, place, nothing, nothing.astype(np.float64))
