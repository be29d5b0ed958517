"""The way to one given place, home for instance: not to look at anything, only to be there."""

from __future__ import annotations

import numpy as np

from uav_recon.planning.proposal import Proposal, Situation
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

NEAR_ENOUGH_M = 0.4  # a pad whose own column may not be flown is reached beside it


def proposal_for(situation: Situation, goal: Viewpoint) -> Proposal | None:
    """The reachable cell nearest to ``goal`` as a proposal; None if all are farther away than NEAR_ENOUGH_M."""
    space = situation.space
    reachable = np.flatnonzero(situation.space.reachable)
    if not len(reachable):
        return None
    away_m = np.linalg.norm(space.world(space.centre(reachable)) - goal.position_world, axis=1)
    nearest = int(np.argmin(away_m))
    if away_m[nearest] > NEAR_ENOUGH_M:
        return None
    cell = int(reachable[nearest])
    place = space.world(space.centre(np.array([cell])))[0]
    task = Task(TaskKind.EXPLORE, place, Viewpoint(place, goal.yaw_rad, goal.pitch_down_rad), 0.0)
    nothing = np.zeros(0, dtype=np.int64)
    return Proposal(task, cell, nothing, nothing.astype(np.float64))
