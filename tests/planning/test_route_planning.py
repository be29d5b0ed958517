"""The path home ends at the flyable position nearest to the pad, or its absence is reported."""

from __future__ import annotations

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.mapping.occupancy.distance_field import distance2_to_not_free
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.tour.travel_time import YawWhileFlying
from uav_recon.planning.view_planner import ViewPlanner
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import NothingLeft, PlanRequest, ViewPath, Viewpoint

GRID = GridSpec(np.zeros(3), 0.1, (50, 30, 25))
CAMERA = CameraGeometry(1.5, 1.0, np.array([0.1, 0.0, 0.0]), 0.26, 0.26, 4.5)


def planner() -> ViewPlanner:
    return ViewPlanner(PlannerConfig(), np.zeros(3), np.array([5.0, 3.0, 2.5]), CAMERA, YawWhileFlying(0.8, 0.8))


def request(wall: bool) -> PlanRequest:
    state = np.full(GRID.shape, FREE, np.uint8)
    if wall:
        state[24:26] = OCCUPIED
    voxels = VoxelMap.whole(GRID, state, distance2_to_not_free(state, 11), 1)
    return PlanRequest(voxels, None, np.array([4.0, 1.5, 1.0]), 0.3, views_left=0)


def test_the_path_home_ends_at_home_even_without_views_left() -> None:
    home = Viewpoint(np.array([1.02, 1.49, 1.1]), 0.7, 0.26)
    path = planner().route(request(wall=False), home)
    assert isinstance(path, ViewPath)
    assert len(path.viewpoints) == 1
    assert np.linalg.norm(path.viewpoints[0].position_world - home.position_world) < 0.1
    assert path.viewpoints[0].yaw_rad == home.yaw_rad
    np.testing.assert_allclose(path.waypoints_world[0][0], [4.0, 1.5, 1.0])
    np.testing.assert_allclose(path.waypoints_world[0][-1], path.viewpoints[0].position_world)


def test_a_blocked_path_home_is_reported() -> None:
    answer = planner().route(request(wall=True), Viewpoint(np.array([1.0, 1.5, 1.1]), 0.0, 0.26))
    assert isinstance(answer, NothingLeft)
    assert answer.reason == Reason(ReasonCode.NO_KNOWN_PATH)


def test_the_path_home_leaves_the_visited_surface_unchanged() -> None:
    the_planner = planner()
    the_planner.route(request(wall=False), Viewpoint(np.array([1.0, 1.5, 1.1]), 0.0, 0.26))
    assert the_planner.view_history.surface_cosine_sums.sum() == 0.0


def test_a_goal_outside_flyable_space_is_approached_and_a_far_one_refused() -> None:
    low = Viewpoint(np.array([1.0, 1.5, 0.1]), 0.0, 0.26)  # lower than the planner flies
    path = planner().route(request(wall=False), low)
    assert isinstance(path, ViewPath)
    np.testing.assert_allclose(path.viewpoints[0].position_world[2], 0.35)
    assert np.linalg.norm(path.viewpoints[0].position_world - low.position_world) < 0.4
    for outside in ([1.0, 1.5, -0.2], [-3.0, 1.5, 1.0], [60.0, 1.5, 1.0]):
        answer = planner().route(request(wall=False), Viewpoint(np.array(outside), 0.0, 0.26))
        assert isinstance(answer, NothingLeft)
