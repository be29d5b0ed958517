"""Opening of 0.90 m between two rooms: too narrow for 0.50 m of clearance; the way home leads through it with 0.45 m."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from box_world import GIMBAL, BoxWorld, Solid, room, visible_from_anywhere
from scipy.spatial import cKDTree

from uav_recon.config import PlannerConfig, VariantName
from uav_recon.planning.fallback_planner import FallbackPlanner
from uav_recon.planning.tour.travel_time import YawWhileFlying
from uav_recon.planning.view_planner import ViewPlanner
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import NothingLeft, PlanRequest, ViewPath, Viewpoint

USUAL_M, NARROW_M, HOMEWARD_M = 0.5, 0.45, 0.35
pytestmark = pytest.mark.slow
SIZE_M = (8.0, 5.0, 2.2)
WALL_M = 3.2  # far side of the wall
START = np.array([1.5, 2.0, 1.2])
HOME = Viewpoint(START, 0.0, 0.0)
MOVING = np.array([0.4, 0.0, 0.0])


def rooms_with_a_passage(width_m: float) -> Solid:
    """Return a small and a large room, joined by a passage at the end of a 0.2 m thick wall."""
    return room(SIZE_M, [(3.0, 0, 0, WALL_M, 0.2, 2.2), (3.0, 0.2 + width_m, 0, WALL_M, 5.0, 2.2)])


def usual_planner(variant: VariantName = "explore") -> ViewPlanner:
    config = PlannerConfig(clearance_m=USUAL_M, variant=variant)
    return ViewPlanner(config, np.zeros(3), np.array(SIZE_M), GIMBAL, YawWhileFlying(0.8, 0.8), timer=lambda: 0.0)


def with_ways_home(variant: VariantName = "explore") -> FallbackPlanner:
    return FallbackPlanner(usual_planner(variant), (NARROW_M, HOMEWARD_M), NARROW_M, timer=lambda: 0.0)


def explore(world: BoxWorld, planner: ViewPlanner | FallbackPlanner) -> tuple[list[ViewPath], Reason]:
    """Fly until no task is left and check the clearance of each path.

    Returns the paths and the reason for the end.
    """
    flown: list[ViewPath] = []
    for _ in range(60):
        request = world.request()
        answer = planner.plan(request)
        if isinstance(answer, NothingLeft):
            return flown, answer.reason
        assert_keeps(answer, request)
        planner.accept(answer)
        flown.append(answer)
        world.fly(answer)
    raise AssertionError("still exploring after 60 plans")


def assert_keeps(path: ViewPath, request: PlanRequest) -> None:
    """Assert that every waypoint is known free and has the clearance that the path states.

    A view must have the usual clearance.
    """
    points = [*path.waypoints_world, np.array([view.position_world for view in path.viewpoints])]
    *ways_m, views_m = np.split(room_m(np.concatenate(points), request.voxels), np.cumsum([len(way) for way in points])[:-1])
    assert min(way_m.min() for way_m in ways_m) >= (path.clearance_m or USUAL_M) - 1e-3
    assert views_m.min() >= USUAL_M - 1e-3


def room_m(points: FloatArray, voxels: VoxelMap) -> FloatArray:
    """Return the clearance (N,) at the centre of each point's voxel, by brute force.

    It is the distance to the near face of the nearest voxel that is not free. A point on the border of voxels counts as in all
    of them, because a path may bend there.
    """
    grid, corners = voxels.grid, np.array(list(itertools.product((-1e-7, 1e-7), repeat=3)))
    not_free = cKDTree(grid.centre(np.argwhere(voxels.state != FREE)), compact_nodes=False, balanced_tree=False)  # soon built
    cells = grid.centre(grid.index(points[:, None] + corners))
    return np.asarray(not_free.query(cells)[0].max(axis=1) - grid.resolution_m / 2)


def looked_round(width_m: float) -> BoxWorld:
    world = BoxWorld(rooms_with_a_passage(width_m), GIMBAL, START)
    world.look_round()
    return world


def explored(world: BoxWorld) -> float:
    seeable = visible_from_anywhere(world.solid, GIMBAL, START)
    return float(np.mean(world.state[seeable] == FREE))


def test_the_path_home_leads_through_the_same_passage() -> None:
    world, planner = looked_round(0.9), with_ways_home()
    explore(world, planner)
    world.position = np.array([6.5, 2.0, 1.2])
    world.look_round()
    request = world.request(views_left=0)
    usual = planner.route(dataclasses.replace(request, position_world=np.array([2.4, 2.0, 1.2])), HOME)
    home = planner.route(request, HOME)
    assert isinstance(usual, ViewPath) and usual.clearance_m is None
    assert isinstance(usual_planner().route(request, HOME), NothingLeft)
    assert isinstance(home, ViewPath) and home.clearance_m == NARROW_M
    assert room_m(home.waypoints_world[0], request.voxels).min() >= NARROW_M - 1e-3
    assert np.linalg.norm(home.waypoints_world[0][-1] - START) < 0.1


def test_a_passage_narrowed_by_specks_still_leads_home() -> None:
    world, planner = looked_round(0.8), with_ways_home()
    explore(world, planner)
    assert max(point[0] for point in world.track) < 3.0
    world.position = np.array([6.5, 2.0, 1.2])
    world.look_round()
    home = planner.route(world.request(views_left=0), HOME)
    assert isinstance(home, ViewPath) and home.clearance_m == HOMEWARD_M
    way = home.waypoints_world[0]
    passage = way[way[:, 0] < 6.0]  # where it begins, what is above and below the vehicle may be unseen
    assert HOMEWARD_M - 1e-3 <= room_m(passage, world.request().voxels).min() < NARROW_M - 1e-3


@pytest.mark.parametrize("width_m", [0.6, 0.1])
def test_an_even_narrower_passage_is_not_passed(width_m: float) -> None:
    world, planner = looked_round(width_m), with_ways_home()
    _, reason = explore(world, planner)
    assert reason.code in (ReasonCode.FRONTIERS_LEFT, ReasonCode.NO_FRONTIERS_LEFT)
    assert max(point[0] for point in world.track) < 3.0
    answer = planner.route(PlanRequest(world.request().voxels, None, np.array([6.5, 2.0, 1.2]), 0.0, 0), HOME)
    assert isinstance(answer, NothingLeft)


def test_where_views_are_left_the_flight_is_the_usual_one() -> None:
    alone, both = looked_round(1.3), looked_round(1.3)
    expected, reason = explore(alone, usual_planner())
    flown, reason_too = explore(both, with_ways_home())
    assert reason == reason_too and len(flown) == len(expected)
    np.testing.assert_array_equal(np.array(alone.track), np.array(both.track))
