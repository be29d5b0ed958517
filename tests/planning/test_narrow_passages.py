"""Passage of 0.90 m between two rooms, planned with 0.50 m and 0.45 m clearance.

It is too narrow for 0.50 m. The planner passes it with 0.45 m once no task is left on this side.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
import pytest
from box_world import GIMBAL, BoxWorld, Solid, room, visible_from_anywhere, voxel_map
from scipy.spatial import cKDTree

from uav_recon.config import PlannerConfig, VariantName
from uav_recon.planning.narrow_passages import ON_A_NARROW_WAY, NarrowPassagePlanner
from uav_recon.planning.tour.travel_time import YawWhileFlying
from uav_recon.planning.view_planner import ViewPlanner
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, VoxelMap
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


def through_narrows(variant: VariantName = "explore") -> NarrowPassagePlanner:
    return NarrowPassagePlanner(usual_planner(variant), NARROW_M, HOMEWARD_M, NARROW_M, timer=lambda: 0.0)


def explore(world: BoxWorld, planner: ViewPlanner | NarrowPassagePlanner) -> tuple[list[ViewPath], Reason]:
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


def test_a_narrow_passage_is_passed_with_less_clearance_and_not_with_the_usual() -> None:
    alone, both = looked_round(0.9), looked_round(0.9)
    _, reason = explore(alone, usual_planner())
    flown, _ = explore(both, through_narrows())
    assert {ReasonCode.FRONTIERS_NOT_REACHABLE, ReasonCode.FRONTIERS_TOO_NARROW} & set(reason.codes())
    assert max(point[0] for point in alone.track) < 3.0 and explored(alone) < 0.9
    assert explored(both) >= 0.97
    assert max(point[0] for point in both.track) > WALL_M
    narrow = [path for path in flown if path.clearance_m is not None]
    assert narrow and all(path.clearance_m == NARROW_M and len(path.viewpoints) == 1 for path in narrow)
    assert len(narrow) <= 3


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly), 2, pytest.param(3, marks=pytest.mark.nightly)])
def test_in_random_rooms_every_path_keeps_its_stated_clearance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wall_m, gap_m = rng.integers(26, 34) * 0.1, rng.integers(0, 36) * 0.1
    boxes: list[tuple[float, ...]] = [
        (wall_m, 0, 0, wall_m + 0.2, gap_m, 2.2),
        (wall_m, gap_m + 0.9, 0, wall_m + 0.2, 5.0, 2.2),
    ]
    for _ in range(4):
        low = rng.uniform([wall_m + 0.8, 0, 0], [7.0, 4.0, 1.5])
        boxes.append((*low.tolist(), *np.minimum(low + rng.uniform(0.2, 1.2, 3), SIZE_M).tolist()))
    world = BoxWorld(room(SIZE_M, boxes), GIMBAL, START)
    world.look_round()
    flown, _ = explore(world, through_narrows())
    assert any(path.clearance_m == NARROW_M for path in flown)


def test_the_path_home_leads_through_the_same_passage() -> None:
    world, planner = looked_round(0.9), through_narrows()
    explore(world, planner)
    world.position = np.array([6.5, 2.0, 1.2])
    request = world.request(views_left=0)
    usual = planner.route(dataclasses.replace(request, position_world=np.array([2.4, 2.0, 1.2])), HOME)
    home = planner.route(request, HOME)
    assert isinstance(usual, ViewPath) and usual.clearance_m is None
    assert isinstance(usual_planner().route(request, HOME), NothingLeft)
    assert isinstance(home, ViewPath) and home.clearance_m == NARROW_M
    assert room_m(home.waypoints_world[0], request.voxels).min() >= NARROW_M - 1e-3
    assert np.linalg.norm(home.waypoints_world[0][-1] - START) < 0.1


def test_a_passage_narrowed_by_specks_still_leads_home() -> None:
    """The passage is used for the path home only.

    A view that is seen through it from here is not a goal.
    """
    world, planner = looked_round(0.8), through_narrows()
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
    world, planner = looked_round(width_m), through_narrows()
    _, reason = explore(world, planner)
    assert reason.code in (ReasonCode.FRONTIERS_LEFT, ReasonCode.NO_FRONTIERS_LEFT)
    assert max(point[0] for point in world.track) < 3.0
    answer = planner.route(PlanRequest(world.request().voxels, None, np.array([6.5, 2.0, 1.2]), 0.0, 0), HOME)
    assert isinstance(answer, NothingLeft)


def test_without_a_narrow_passage_the_flight_is_the_usual_one() -> None:
    alone, both = looked_round(1.3), looked_round(1.3)
    expected, reason = explore(alone, usual_planner())
    flown, reason_too = explore(both, through_narrows())
    assert reason == reason_too and len(flown) == len(expected)
    np.testing.assert_array_equal(np.array(alone.track), np.array(both.track))


def stuck(planner: NarrowPassagePlanner) -> tuple[BoxWorld, PlanRequest, ViewPath]:
    """Fly until no usual task is left; return world, request, and the narrow path found."""
    world = looked_round(0.9)
    for _ in range(60):
        request = world.request()
        answer = planner.plan(request)
        assert isinstance(answer, ViewPath), answer
        if answer.clearance_m is not None:
            return world, request, answer
        planner.accept(answer)
        world.fly(answer)
    raise AssertionError("no narrow way was proposed")


REFUSED: dict[str, Callable[[PlanRequest], PlanRequest]] = {
    "in motion": lambda request: dataclasses.replace(request, velocity_world_mps=MOVING),
    "without a view left": lambda request: dataclasses.replace(request, views_left=0),
    "outside of the map": lambda request: dataclasses.replace(request, position_world=np.full(3, 50.0)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_no_narrow_path_is_proposed(name: str) -> None:
    planner = through_narrows()
    _, request, _ = stuck(planner)
    assert isinstance(planner.plan(REFUSED[name](request)), NothingLeft)


def test_a_variant_that_never_explores_proposes_no_narrow_path() -> None:
    _, request, _ = stuck(through_narrows())
    assert isinstance(through_narrows("reconstruct").plan(request), NothingLeft)


def test_no_other_plan_is_made_until_a_narrow_path_is_flown() -> None:
    planner = through_narrows()
    world, request, path = stuck(planner)
    planner.accept(path)
    assert planner.next_view_has_gain(request.voxels, request.position_world, request.yaw_rad)
    midway = dataclasses.replace(request, position_world=np.array([3.1, 0.65, 1.2]), velocity_world_mps=MOVING)
    answer = planner.plan(midway)
    assert isinstance(answer, NothingLeft) and answer.reason == ON_A_NARROW_WAY
    world.fly(path)
    following = planner.plan(world.request())
    assert isinstance(following, ViewPath) and following.clearance_m is None  # the other room is flown with the usual clearance
    planner.accept(following)
    assert isinstance(planner.plan(dataclasses.replace(world.request(), velocity_world_mps=MOVING)), ViewPath)


@pytest.mark.parametrize(("edge", "squeezes"), [(5, False), (9, True)], ids=["a gap", "an opening"])
def test_a_narrow_path_is_proposed_only_for_an_opening(edge: int, squeezes: bool) -> None:
    """The whole map is known except a cube of edge³ voxels in the other room."""
    state = np.where(rooms_with_a_passage(0.9), OCCUPIED, FREE).astype(np.uint8)
    state[60 : 60 + edge, 20 : 20 + edge, 8 : 8 + edge] = UNKNOWN
    request = PlanRequest(voxel_map(state), None, START, 0.0, 50)
    alone, both = usual_planner().plan(request), through_narrows().plan(request)
    assert isinstance(alone, NothingLeft)
    assert Reason(ReasonCode.FRONTIERS_NOT_REACHABLE, (2,)) in alone.reason.details
    assert isinstance(both, ViewPath) == squeezes


def test_a_view_beyond_a_narrow_path_without_new_space_is_remembered() -> None:
    usual = usual_planner()
    planner = NarrowPassagePlanner(usual, NARROW_M, HOMEWARD_M, NARROW_M, timer=lambda: 0.0)
    _, request, path = stuck(planner)
    planner.accept(path)
    view, voxels = path.viewpoints[0], request.voxels
    before = int(usual.view_history.failed_views.sum())
    arrived = dataclasses.replace(request, position_world=view.position_world, yaw_rad=view.yaw_rad)
    for revision in (1, 2):  # the camera sees nothing new
        newer = dataclasses.replace(voxels, revision=voxels.revision + revision)
        planner.plan(dataclasses.replace(arrived, voxels=newer))
    assert usual.view_history.failed_views.sum() > before


def test_the_same_requests_give_the_same_narrow_path() -> None:
    (_, _, first), (_, _, second) = stuck(through_narrows()), stuck(through_narrows())
    np.testing.assert_array_equal(first.waypoints_world[0], second.waypoints_world[0])
    assert first.viewpoints[0].yaw_rad == second.viewpoints[0].yaw_rad
