"""Complete explorations of a box world: they end, see all that is visible, and are short."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from box_world import FIXED, GIMBAL, MEETING_ROOM, TWO_ROOMS, BoxWorld, Solid, visible_from_anywhere

from uav_recon.config import PlannerConfig
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.tour.travel_time import YawWhileFlying
from uav_recon.planning.view_planner import ViewPlanner
from uav_recon.types.maps import FREE
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import NothingLeft

CASES = {
    "meeting room, fixed": (MEETING_ROOM, FIXED, (4.8, 3.4, 1.2), 45.0),
    "two rooms, fixed": (TWO_ROOMS, FIXED, (1.5, 2.0, 1.2), 55.0),
    "two rooms, gimbal": (TWO_ROOMS, GIMBAL, (1.5, 2.0, 1.2), 50.0),
}


@pytest.mark.parametrize("name", CASES)
def test_explores_what_can_be_seen_and_stops(name: str) -> None:
    solid, camera, start, longest_m = CASES[name]
    world, reason, visits = explore(solid, camera, np.array(start))
    seeable = visible_from_anywhere(solid, camera, np.array(start))
    assert np.mean(world.state[seeable] == FREE) >= 0.97
    assert not np.any(solid[world.state == FREE])
    assert world.length_m < longest_m
    assert max(visits.values()) <= 3
    assert reason.code in (ReasonCode.FRONTIERS_LEFT, ReasonCode.NO_FRONTIERS_LEFT)


def explore(
    solid: Solid, camera: CameraGeometry, start: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
) -> tuple[BoxWorld, Reason, Counter[tuple[int, ...]]]:
    world = BoxWorld(solid, camera, start)
    world.look_round()
    planner = ViewPlanner(PlannerConfig(), np.zeros(3), (np.array(solid.shape) - 2) * 0.1, camera, YawWhileFlying(0.8, 0.8))
    visits: Counter[tuple[int, ...]] = Counter()
    for _ in range(60):
        answer = planner.plan(world.request())
        if isinstance(answer, NothingLeft):
            return world, answer.reason, visits
        visits.update(tuple(np.floor(task.centroid_world / 0.2).astype(int)) for task in answer.tasks)
        planner.accept(answer)
        world.fly(answer)
    raise AssertionError(f"still exploring after 60 plans and {world.length_m:.1f} m")
