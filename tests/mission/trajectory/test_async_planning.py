"""A plan of which only the first leg can be flown is flown up to there."""

from __future__ import annotations

import numpy as np
import pytest
from conductor_fixture import OpenSpace, ThreeViews

from uav_recon.clock import InlineExecutor, ManualClock
from uav_recon.config import MotionConfig
from uav_recon.mission.trajectory.async_planning import AsyncPlanner
from uav_recon.mission.trajectory.flight_track import Departure
from uav_recon.motion import MotionPlanner
from uav_recon.motion.speed_limited_planner import SpeedLimitedPlanner
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.maps import VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.recent_views import RecentViews
from uav_recon.types.tasks import PlanRequest, ViewPath
from uav_recon.types.trajectory import Setpoint, Trajectory

START = Setpoint.hold(np.array([0.0, 0.0, 1.1]), 0.0)


class ShortPlanner(MotionPlanner):
    """Finds no motion through more than a number of views."""

    most_views = 9

    def plan_from_rest(
        self, path: ViewPath, voxels: VoxelMap, start: Setpoint, start_s: float, views_at_spacing_m: float, identifier: int,
        views: RecentViews | None = None, cells: SurfaceCells | None = None,
    ) -> Trajectory | Reason:  # fmt: skip
        if len(path.viewpoints) > self.most_views:
            return Reason(ReasonCode.PATH_CLEARANCE, (0.39, 1.5, 0.7, 1.1))
        return super().plan_from_rest(path, voxels, start, start_s, views_at_spacing_m, identifier, views, cells)


@pytest.mark.parametrize(("most_views", "flown_views"), [(9, 2), (1, 1), (0, None)])
def test_from_rest_the_first_leg_is_flown_alone_if_a_later_one_cannot_be(most_views: int, flown_views: int | None) -> None:
    motion, planner = ShortPlanner(MotionConfig(), 0.35), ThreeViews()
    motion.most_views = most_views
    paced = SpeedLimitedPlanner(motion, motion, 1.0)
    work = AsyncPlanner(planner, paced, paced, InlineExecutor(ManualClock(0.0)), 0.0, np.inf)
    request = PlanRequest(OpenSpace().snapshot(), None, START.position_m, 0.0, 9)
    result = work.next_views(request, Departure(START), 3).result()
    assert isinstance(result.path, ViewPath)
    if flown_views is None:
        assert isinstance(result.motion, Reason) and len(result.path.viewpoints) == 2
        return
    assert isinstance(result.motion, Trajectory)
    lengths = {len(part) for part in (result.path.viewpoints, result.path.waypoints_world, result.path.tasks)}
    assert lengths == {flown_views} == {len(result.motion.views_s)}
    np.testing.assert_allclose(result.motion.position_m[-1], planner.left[flown_views - 1], atol=0.15)
