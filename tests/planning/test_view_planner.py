from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from box_world import FIXED, GIMBAL, MEETING_ROOM, TWO_ROOMS, BoxWorld, room, voxel_map
from scipy import ndimage

from uav_recon.config import PlannerConfig, VariantName
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.candidate_view import CandidateView
from uav_recon.planning.frontier.frontier_views import FrontierViews
from uav_recon.planning.frontier.places_left import count_places_left
from uav_recon.planning.task_generation import GeneratedTasks, TaskQuery
from uav_recon.planning.tour.travel_time import YawWhileFlying
from uav_recon.planning.view_history import ARRIVED_M
from uav_recon.planning.view_planner import ViewPlanner
from uav_recon.types.frames import ByteArray, FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, SurfaceElements, VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import NextView, NothingLeft, PlanMode, PlanRequest, Task, TaskKind, ViewPath


def planner_for(state: ByteArray, camera: CameraGeometry = FIXED, variant: VariantName = "adaptive") -> ViewPlanner:
    size_m = (np.array(state.shape) - 2) * 0.1
    return ViewPlanner(PlannerConfig(variant=variant), np.zeros(3), size_m, camera, YawWhileFlying(0.8, 0.8), timer=lambda: 0.0)


def looked_round(solid: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], camera: CameraGeometry = FIXED) -> BoxWorld:
    world = BoxWorld(solid, camera, np.array([3.0, 1.0, 1.2]))
    world.look_round()
    return world


def with_an_accepted_path() -> tuple[BoxWorld, ViewPlanner, ViewPath]:
    world = looked_round(MEETING_ROOM)
    planner = planner_for(world.state)
    path = planner.plan(world.request())
    assert isinstance(path, ViewPath)
    planner.accept(path)
    return world, planner, path


def next_view(world: BoxWorld, planner: ViewPlanner, path: ViewPath) -> CandidateView:
    following = planner.view_history.next_expected_view(path.waypoints_world[0][0], world.yaw_rad)
    assert following is not None
    return following


def surface_of(solid: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], per_face: int = 6) -> SurfaceElements:
    """Return elements on every face between air and solid.

    Normals point into the air; uncertainty grows with x.
    """
    rng = np.random.default_rng(0)
    positions, normals = [], []
    for axis, sign in itertools.product(range(3), (-1, 1)):
        air_beside = np.roll(~solid, -sign, axis=axis) & solid
        air_beside[[0, -1] if axis == 0 else slice(None)] &= axis != 0 or sign * np.array([1, -1])[:, None, None] > 0
        cells = np.argwhere(air_beside)
        normal = np.eye(3)[axis] * sign
        points = np.repeat(cells, per_face, axis=0) + rng.random((len(cells) * per_face, 3))
        points[:, axis] = np.repeat(cells[:, axis], per_face) + (1.0 if sign > 0 else 0.0)
        positions.append((points - 1.0) * 0.1)
        normals.append(np.tile(normal, (len(points), 1)))
    position = np.concatenate(positions)
    order = rng.permutation(len(position))
    return SurfaceElements(position[order], np.concatenate(normals)[order], 0.2 + position[order, 0], 1)


def harvest_of(
    planner: ViewPlanner, request: PlanRequest, surface: SurfaceElements, views_left: int
) -> dict[TaskKind, list[Task]]:
    """Return all tasks of one plan, including those that its tour leaves out."""
    tasks = [proposal.task for proposal in generated(planner, request, surface, views_left).proposals]
    return {kind: [task for task in tasks if task.kind is kind] for kind in TaskKind}


def generated(planner: ViewPlanner, request: PlanRequest, surface: SurfaceElements, views_left: int) -> GeneratedTasks:
    """Return what the source of tasks gives for one plan."""
    propose, found = planner._source.propose, []

    def remember(query: TaskQuery) -> GeneratedTasks:
        found.append(propose(query))
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planner._source, "propose", remember)
        planner.plan(dataclasses.replace(request, surface=surface, views_left=views_left))
    return found[0]


def assert_flyable(path: ViewPath, request: PlanRequest, start_is_flyable: bool = True) -> None:
    """Assert that densely sampled positions of a path keep the clearance and that segments join."""
    grid = request.voxels.grid
    assert len(path.viewpoints) == len(path.waypoints_world) == len(path.tasks) >= 1
    at = request.position_world
    for n, (view, way) in enumerate(zip(path.viewpoints, path.waypoints_world, strict=True)):
        assert way.shape[1] == 3
        np.testing.assert_allclose(way[0], at, atol=1e-9)
        np.testing.assert_allclose(way[-1], view.position_world, atol=1e-9)
        assert (np.linalg.norm(np.diff(way, axis=0), axis=1) > 0).all()
        for p in way if start_is_flyable or n else way[-1:]:
            assert request.voxels.distance_m(grid.index(p)) >= 0.4 - 1e-3
        if start_is_flyable or n:
            for a, b in itertools.pairwise(way):
                samples = a + np.linspace(0.01, 0.99, 200)[:, None] * (b - a)
                index = grid.index(samples)
                # a line between two flyable points may cut a corner by less than a quarter of a voxel
                assert (request.voxels.distance_m(index) >= 0.3 - 1e-3).all()
        at = way[-1]


def random_case(seed: int) -> tuple[VoxelMap, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """Return a random map and start: clutter, half-seen rooms, closed doors or no free space.

    The start may be anywhere, even outside the grid.
    """
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(4, [50, 40, 28]))
    state = np.full(shape, FREE, dtype=np.uint8)
    for value in (OCCUPIED, 0):
        for _ in range(rng.integers(0, 6)):
            low = rng.integers(0, shape)
            high = low + rng.integers(1, 14, 3)
            state[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = value
    kind = seed % 8
    if kind == 0:
        state[:] = rng.choice([0, OCCUPIED])
    if kind == 1:
        state[shape[0] // 2] = OCCUPIED  # closed door
    if kind == 2:
        state[rng.random(shape) < 0.02] = 0
    position = rng.uniform(-0.2 if kind == 3 else 0.0, np.array(shape) * 0.1 - 0.1)
    return voxel_map(state), position


@pytest.mark.parametrize("block", range(4))
def test_every_map_gives_a_flyable_path_or_a_reason(block: int) -> None:
    outcomes = {ViewPath: 0, NothingLeft: 0}
    for seed in range(block * 50, block * 50 + 50):
        voxels, position = random_case(seed)
        planner = planner_for(voxels.state, GIMBAL if seed % 2 else FIXED, "merged")
        surface = surface_of(np.asarray(voxels.state == OCCUPIED), 1) if seed % 3 == 0 else None
        request = PlanRequest(voxels, surface, position, seed * 0.7, 1 + seed % 7)
        answer = planner.plan(request)
        outcomes[type(answer)] += 1
        if isinstance(answer, NothingLeft):
            assert answer.reason
            continue
        index = voxels.grid.index(position)
        inside = bool(voxels.grid.contains(index))
        flyable = inside and voxels.distance_m(index) >= 0.4 - 1e-3
        assert_flyable(answer, request, start_is_flyable=bool(flyable) and _in_fence(voxels, position))
        assert len(answer.viewpoints) <= request.views_left
    assert min(outcomes.values()) >= 5


def _in_fence(voxels: VoxelMap, position: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> bool:
    size_m = (np.array(voxels.grid.shape) - 2) * 0.1
    centre = voxels.grid.centre(voxels.grid.index(position))
    return bool((centre >= 0.35).all() and (centre <= size_m - 0.35).all())


def test_the_same_request_gives_the_same_plan() -> None:
    world = looked_round(MEETING_ROOM)
    request = world.request()
    first, second = (planner_for(world.state, GIMBAL).plan(request) for _ in range(2))
    assert isinstance(first, ViewPath)
    assert isinstance(second, ViewPath)
    for a, b in zip(first.waypoints_world, second.waypoints_world, strict=True):
        np.testing.assert_array_equal(a, b)
    assert [v.yaw_rad for v in first.viewpoints] == [v.yaw_rad for v in second.viewpoints]


def test_a_view_of_a_frontier_reveals_unknown_space() -> None:
    world = looked_round(MEETING_ROOM)
    path = planner_for(world.state).plan(world.request())
    assert isinstance(path, ViewPath)
    for task, view in zip(path.tasks, path.viewpoints, strict=True):
        assert task.kind is TaskKind.EXPLORE
        before = int(np.count_nonzero(world.state))
        world.position, world.yaw_rad = view.position_world, view.yaw_rad
        world.look(view.pitch_down_rad)
        assert int(np.count_nonzero(world.state)) > before
        assert view.pitch_down_rad == FIXED.pitch_min_rad


def test_a_start_in_forbidden_space_leaves_through_free_cells() -> None:
    world = looked_round(MEETING_ROOM)
    request = world.request()
    corner = np.array([3.0, 0.15, 1.2])  # 0.15 m from a wall
    start = PlanRequest(request.voxels, None, corner, 0.0, 10)
    path = planner_for(world.state).plan(start)
    assert isinstance(path, ViewPath)
    assert_flyable(path, start, start_is_flyable=False)
    index = request.voxels.grid.index(path.waypoints_world[0])
    assert (request.voxels.state[index[:, 0], index[:, 1], index[:, 2]] == FREE).all()


def test_the_reasons_for_an_empty_plan_are_reported() -> None:
    known = np.where(MEETING_ROOM, OCCUPIED, FREE).astype(np.uint8)
    planner = planner_for(known)
    position = np.array([3.0, 1.0, 1.2])
    done = planner.plan(PlanRequest(voxel_map(known), None, position, 0.0, 10))
    assert isinstance(done, NothingLeft)
    assert done.reason == Reason(ReasonCode.NO_FRONTIERS_LEFT)
    hidden = known.copy()
    hidden[24:36, 21:29, 1:5] = 0  # the far end of a slot under the table, too low for the vehicle
    hidden[24:36, 29, 1:5] = OCCUPIED
    boxed = planner_for(known).plan(PlanRequest(voxel_map(hidden), None, position, 0.0, 0))
    assert isinstance(boxed, NothingLeft)
    assert boxed.reason == Reason(ReasonCode.NO_VIEWS_LEFT)
    closed = np.zeros_like(known)
    closed[5, 5, 5] = FREE
    stuck = planner.plan(PlanRequest(voxel_map(closed, 1), None, np.array([0.45, 0.45, 0.45]), 0.0, 5))
    assert isinstance(stuck, NothingLeft)
    assert stuck.reason == Reason(ReasonCode.START_NOT_FREE)


@pytest.mark.parametrize(("deep", "views"), [(6, True), (2, False)], ids=["an open cupboard", "a gap in its front"])
def test_before_home_a_small_opening_with_space_behind_it_is_viewed(deep: int, views: bool) -> None:
    """Twelve frontier cells are too few for plan(), and a gap in a surface promises no space."""
    state = np.where(MEETING_ROOM, OCCUPIED, FREE).astype(np.uint8)
    state[4:8, 45 : 45 + deep, 8:11] = UNKNOWN
    planner, request = planner_for(state, GIMBAL), PlanRequest(voxel_map(state), None, np.array([3.0, 1.0, 1.2]), 0.0, 10)
    assert planner.plan_with_less_demand(request) is None, "plan() comes first"
    usual = planner.plan(request)
    assert isinstance(usual, NothingLeft)
    assert Reason(ReasonCode.FRONTIERS_TOO_SMALL, (1,)) in usual.reason.details
    last = planner.plan_with_less_demand(request)
    assert isinstance(last, ViewPath) == views
    if last is not None:
        assert_flyable(last, request)
        np.testing.assert_allclose(last.tasks[0].centroid_world, [0.5, 4.35, 0.85], atol=0.11)


def test_a_frontier_behind_a_closed_door_is_not_reachable_and_not_near() -> None:
    solid = room((6.0, 4.0, 2.5), [(3.0, 0, 0, 3.1, 4.0, 2.5)])
    state = np.where(solid, OCCUPIED, FREE).astype(np.uint8)
    state[45:-1, 1:-1, 1:-1] = 0
    answer = planner_for(state).plan(PlanRequest(voxel_map(state), None, np.array([1.5, 2.0, 1.2]), 0.0, 10))
    assert isinstance(answer, NothingLeft)
    assert ReasonCode.FRONTIERS_NOT_REACHABLE in answer.reason.codes()


def test_surface_tasks_look_at_uncertain_surface_that_is_in_sight() -> None:
    known = np.where(MEETING_ROOM, OCCUPIED, FREE).astype(np.uint8)
    request = PlanRequest(voxel_map(known), surface_of(MEETING_ROOM), np.array([3.0, 1.0, 1.2]), 0.0, 50)
    path = planner_for(known).plan(request)
    assert isinstance(path, ViewPath)
    assert path.mode is PlanMode.MERGED
    assert all(task.kind is TaskKind.RECONSTRUCT for task in path.tasks)
    assert path.explored
    assert_flyable(path, request)
    explore_only = planner_for(known, variant="explore").plan(request)
    assert isinstance(explore_only, NothingLeft)


def test_a_room_with_an_open_door_is_not_explored() -> None:
    world = looked_round(TWO_ROOMS)
    path = planner_for(world.state).plan(dataclasses.replace(world.request(), surface=surface_of(TWO_ROOMS)))
    assert isinstance(path, ViewPath)
    assert not path.explored


@pytest.mark.parametrize(("over", "left_to_surface"), [(-1, 0), (0, 0), (2, 2), (400, 10)])
def test_surface_gets_the_views_that_frontiers_do_not_need(over: int, left_to_surface: int) -> None:
    world = looked_round(TWO_ROOMS)
    surface = surface_of(TWO_ROOMS)
    planner = planner_for(world.state, variant="merged")
    frontiers = len(harvest_of(planner, world.request(), surface, 400)[TaskKind.EXPLORE])
    assert frontiers > 1
    found = harvest_of(planner_for(world.state, variant="merged"), world.request(), surface, frontiers + over)
    assert len(found[TaskKind.EXPLORE]) == frontiers
    assert len(found[TaskKind.RECONSTRUCT]) == left_to_surface


def test_without_exploration_surface_is_sought_near_the_vehicle_first() -> None:
    world = looked_round(TWO_ROOMS)
    everywhere = surface_of(TWO_ROOMS)
    far = np.linalg.norm(everywhere.position_world - world.position, axis=1) > 3.0
    planner = planner_for(world.state, variant="reconstruct")
    assert generated(planner, world.request(), everywhere, 50).widening == 1.0
    elsewhere = dataclasses.replace(everywhere, uncertainty=np.where(far, 1.0, 0.0))
    found = generated(planner, world.request(), elsewhere, 50)
    assert found.proposals
    assert found.widening == planner.config.end_factor


def test_a_path_counts_the_frontiers_beyond_its_end() -> None:
    world = looked_round(TWO_ROOMS)
    planner = planner_for(world.state, variant="explore")
    path = planner.plan(world.request())
    assert isinstance(path, ViewPath)
    assert path.frontiers >= len(harvest_of(planner, world.request(), surface_of(TWO_ROOMS), 400)[TaskKind.EXPLORE])
    assert path.frontiers > len(path.tasks)


def test_surface_tasks_run_out() -> None:
    world = looked_round(MEETING_ROOM, GIMBAL)
    world.state[:] = np.where(MEETING_ROOM, OCCUPIED, FREE)
    surface = surface_of(MEETING_ROOM, 2)
    planner = planner_for(world.state, GIMBAL)
    for _ in range(60):
        asked = world.request()
        answer = planner.plan(PlanRequest(asked.voxels, surface, asked.position_world, asked.yaw_rad, 500))
        if isinstance(answer, NothingLeft):
            break
        planner.accept(answer)
        world.views += len(answer.viewpoints)
        world.position, world.yaw_rad = answer.viewpoints[-1].position_world, answer.viewpoints[-1].yaw_rad
        world.revision += 1
    assert isinstance(answer, NothingLeft)
    assert 10 < world.views < 150


def test_a_frontier_that_no_view_can_resolve_is_given_up_after_two_views() -> None:
    known = np.where(MEETING_ROOM, OCCUPIED, FREE).astype(np.uint8)
    known[28:42, 6:18, -2:] = 0  # a hole in the plane of the ceiling that stays unknown from every view
    planner = planner_for(known)
    position, yaw = np.array([1.0, 1.0, 1.2]), 0.0
    views = 0
    for revision in range(20):
        answer = planner.plan(PlanRequest(voxel_map(known, revision), None, position, yaw, 20))
        if isinstance(answer, NothingLeft):
            break
        planner.accept(answer)
        views += len(answer.viewpoints)
        position, yaw = answer.viewpoints[-1].position_world, answer.viewpoints[-1].yaw_rad
    assert isinstance(answer, NothingLeft)
    assert ReasonCode.FRONTIERS_VIEWED_WITHOUT_RESULT in answer.reason.codes()
    assert 1 < views <= 12


def test_after_a_refused_motion_another_view_comes_first_and_each_place_is_tried_twice() -> None:
    known = np.where(MEETING_ROOM, OCCUPIED, FREE).astype(np.uint8)
    known[-12:-1, 30:, 1:-1] = 0
    known[1:8, 1:8, 1:8] = 0
    planner, position = planner_for(known), np.array([3.0, 2.0, 1.2])
    places: list[FloatArray] = []
    for revision in range(40):
        after = NextView.REFUSED if revision > 0 else NextView.KEPT
        request = PlanRequest(voxel_map(known, revision), None, position, 0.0, 20, next_view=after)
        answer = planner.plan(request)
        if isinstance(answer, NothingLeft):
            break
        planner.accept(answer)
        places.append(answer.viewpoints[0].position_world)
    assert isinstance(answer, NothingLeft)
    near = np.linalg.norm(np.array(places)[:, None] - np.array(places), axis=-1) < ARRIVED_M
    assert near.sum(axis=1).max() <= 2
    assert not near[0, 1]


def test_the_first_leg_of_a_path_may_be_accepted_alone() -> None:
    world = looked_round(TWO_ROOMS)
    planner = planner_for(world.state)
    path = planner.plan(world.request())
    assert isinstance(path, ViewPath) and len(path.viewpoints) > 1
    planner.accept(path.first())
    first = planner.view_history.next_expected_view(world.position, world.yaw_rad)
    assert first is not None and first.task is path.tasks[0]
    view = path.viewpoints[0]
    assert planner.view_history.next_expected_view(view.position_world, view.yaw_rad) is None


@pytest.mark.parametrize(("low", "confined"), [(10, True), (4, False)])
def test_where_the_vehicle_can_hardly_move_each_plan_has_one_view(low: int, confined: bool) -> None:
    known = np.zeros(MEETING_ROOM.shape, dtype=np.uint8)
    known[6:58, 2:19, low:16] = FREE  # seen all round from one position; from 10 on it is too flat to fly in
    known[25:35, 5:15, 1:24] = FREE  # declared free over the pad
    path = planner_for(known).plan(PlanRequest(voxel_map(known), None, np.array([2.9, 0.9, 1.2]), 0.0, 20))
    assert isinstance(path, ViewPath)
    assert (len(path.viewpoints) == 1) == confined


def test_a_vehicle_that_does_not_fly_does_not_get_the_same_view_for_ever() -> None:
    known = np.where(MEETING_ROOM, OCCUPIED, FREE).astype(np.uint8)
    known[-12:-1, 30:, 1:-1] = 0
    planner = planner_for(known)
    position = np.array([1.0, 1.0, 1.2])
    answers: list[ViewPath | NothingLeft] = []
    for revision in range(80):
        answers.append(planner.plan(PlanRequest(voxel_map(known, revision), None, position, 0.0, 20)))
        if isinstance(answers[-1], ViewPath):
            planner.accept(answers[-1])
    assert isinstance(answers[0], ViewPath)
    assert isinstance(answers[-1], NothingLeft)


def test_a_new_epoch_forgets_the_views_of_the_old_one() -> None:
    known = np.where(MEETING_ROOM, OCCUPIED, FREE).astype(np.uint8)
    known[28:42, 6:18, -2:] = 0
    planner = planner_for(known)
    position, yaw = np.array([1.0, 1.0, 1.2]), 0.0
    for revision in range(20):
        answer = planner.plan(PlanRequest(voxel_map(known, revision), None, position, yaw, 20))
        if isinstance(answer, NothingLeft):
            break
        planner.accept(answer)
        position, yaw = answer.viewpoints[-1].position_world, answer.viewpoints[-1].yaw_rad
    assert isinstance(answer, NothingLeft)
    assert isinstance(planner.plan(PlanRequest(voxel_map(known, 21), None, position, yaw, 9)), NothingLeft)
    assert isinstance(planner.plan(PlanRequest(voxel_map(known, 9, epoch=1), None, position, yaw, 9)), ViewPath)


def test_in_motion_the_current_goal_stays_the_next_view() -> None:
    """Otherwise a vehicle between two tasks would turn around at every plan and reach neither."""
    world, planner, path = with_an_accepted_path()
    goal, way = path.viewpoints[0], path.waypoints_world[0]
    back = path.viewpoints[0].position_world - way[0]
    asked = world.request()
    on_the_way = way[0] + 0.02 * (way[1] - way[0])
    for velocity in (0.5 * back, -0.5 * back):
        request = PlanRequest(asked.voxels, None, on_the_way, world.yaw_rad + 2.0, 50, velocity)
        onward = planner.plan(request)
        assert isinstance(onward, ViewPath)
        np.testing.assert_array_equal(onward.viewpoints[0].position_world, goal.position_world)
        assert onward.viewpoints[0].yaw_rad == goal.yaw_rad
    resting = planner.plan(PlanRequest(asked.voxels, None, on_the_way, world.yaw_rad + 2.0, 50))
    assert isinstance(resting, ViewPath)


@pytest.mark.parametrize("beside", [False, True])
def test_a_view_off_its_voxel_centre_is_kept_while_its_own_position_is_clear(
    beside: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, planner, path = with_an_accepted_path()
    following = next_view(world, planner, path)
    centre = np.floor(following.position_padded) + 0.5
    moved = dataclasses.replace(following, position_padded=centre + np.array([0.0, 0.0, 0.45]))
    monkeypatch.setattr(planner.view_history, "next_expected_view", lambda *_: moved)
    state = world.state.copy()
    if beside:  # an obstacle so near above that the voxel's centre is still flyable
        state[tuple((np.floor(following.position_padded) - 1.0 + np.array([0.0, 0.0, 4.0])).astype(int))] = OCCUPIED
    request = PlanRequest(voxel_map(state, 99), None, path.waypoints_world[0][0], world.yaw_rad, 50, np.array([0.3, 0.0, 0.0]))
    onward = planner.plan(request)
    assert isinstance(onward, ViewPath)
    assert (onward.tasks[0] is following.task) is not beside


def test_a_view_without_remaining_gain_is_not_kept() -> None:
    world, planner, path = with_an_accepted_path()
    at, yaw = path.waypoints_world[0][0], world.yaw_rad + 2.0
    assert planner.next_view_has_gain(voxel_map(world.state.copy(), 50), at, yaw)
    seen = np.where(MEETING_ROOM, OCCUPIED, FREE).astype(np.uint8)
    seen[world.state == 0] = np.where(np.arange(seen.size).reshape(seen.shape) % 997 == 0, 0, seen)[world.state == 0]
    assert not planner.next_view_has_gain(voxel_map(seen, 51), at, yaw)
    onward = planner.plan(PlanRequest(voxel_map(seen, 51), None, at, yaw, 50, np.array([0.3, 0.0, 0.0])))
    if isinstance(onward, ViewPath):
        assert any(onward.viewpoints[0].position_world != path.viewpoints[0].position_world)


def test_what_a_view_that_was_given_up_should_settle_is_not_planned_again() -> None:
    world, planner, path = with_an_accepted_path()
    following = next_view(world, planner, path)
    again = planner.plan(dataclasses.replace(world.request(), next_view=NextView.LEFT))
    assert planner.view_history.exhausted.reshape(-1)[following.expected_voxels].mean() > 0.9
    assert isinstance(again, ViewPath)
    assert all(task is not following.task for task in again.tasks)


def test_flyable_components_of_the_test_rooms_are_one() -> None:
    distance = ndimage.distance_transform_edt(~MEETING_ROOM) * 0.1
    assert ndimage.label(distance >= 0.4, structure=np.ones((3, 3, 3)))[1] == 1


def half_known() -> ByteArray:
    """Return a room whose far half is unknown."""
    state = np.where(room((6.0, 4.0, 2.5), []), OCCUPIED, FREE).astype(np.uint8)
    state[35:-1, 1:-1, 1:-1] = UNKNOWN
    return state


def test_openings_that_were_given_up_are_places_left_unseen() -> None:
    """Views of them led to no result, so the planner has no task; the flight did not see everything."""
    state, position = half_known(), np.array([1.5, 2.0, 1.2])
    planner = planner_for(state)
    assert isinstance(planner.plan(PlanRequest(voxel_map(state), None, position, 0.0, 10)), ViewPath)
    planner.view_history.exhausted[:] = 1
    planner.frontiers.mark_changed(np.arange(state.size))
    answer = planner.plan(PlanRequest(voxel_map(state, 1), None, position, 0.0, 10))
    assert isinstance(answer, NothingLeft)
    assert (answer.reason.code, answer.reason.values) == (ReasonCode.PLACES_LEFT_UNSEEN, (1,))
    assert answer.reason.details[0] == Reason(ReasonCode.FRONTIERS_VIEWED_WITHOUT_RESULT, (1,))
    assert answer.reason.details[-1].code is ReasonCode.FRONTIERS_LEFT
    assert answer.reason.text().startswith("1 place(s) left unseen: 1 viewed without result, 1 frontiers left: ")


def test_views_that_are_refused_again_and_again_leave_places_unseen() -> None:
    state, position = half_known(), np.array([1.5, 2.0, 1.2])
    planner = planner_for(state)
    for _ in range(60):
        request = PlanRequest(voxel_map(state), None, position, 0.0, 10, next_view=NextView.LEFT)
        answer = planner.plan(request)
        if isinstance(answer, NothingLeft):
            break
        planner.accept(answer)
    assert isinstance(answer, NothingLeft)
    assert answer.reason.code is ReasonCode.PLACES_LEFT_UNSEEN


def below_unknown() -> ByteArray:
    """Return a room of which the part below the ceiling is unknown."""
    state = np.where(room((6.0, 4.0, 2.5), []), OCCUPIED, FREE).astype(np.uint8)
    state[1:-1, 1:-1, 20:-1] = UNKNOWN
    return state


@pytest.mark.parametrize(
    ("reason", "counted"),
    [
        (None, ReasonCode.FRONTIERS_NOT_FLOWN_TO),
        (ReasonCode.FRONTIERS_TOO_FEW_CELLS, ReasonCode.FRONTIERS_TOO_FEW_CELLS),
        (ReasonCode.FRONTIERS_OUT_OF_VIEW, None),
        (ReasonCode.FRONTIERS_TOO_NARROW, None),
        (ReasonCode.FRONTIERS_NOT_REACHABLE, None),
    ],
)
def test_openings_side_by_side_are_one_place_unless_nothing_could_show_them(
    reason: ReasonCode | None, counted: ReasonCode | None
) -> None:
    state = half_known()
    planner, request = planner_for(state), PlanRequest(voxel_map(state), None, np.array([1.5, 2.0, 1.2]), 0.0, 10)
    planner.plan(request)
    openings = planner.frontiers.openings
    assert openings > 1
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FrontierViews, "reasons_of_clusters", lambda self, voxels, space, frontiers, rows: [reason] * len(rows))
        views = FrontierViews(planner.config, planner.camera)
        exhausted = planner.view_history.exhausted
        found = count_places_left(request.voxels, planner.space, planner.frontiers, exhausted, views)
    assert found == ({} if counted is None else {counted: 1})


@pytest.mark.parametrize("where", ["behind a closed door", "below the ceiling", "outside the fence"])
def test_what_the_vehicle_could_not_have_seen_is_no_place_left(where: str) -> None:
    state = np.where(room((6.0, 4.0, 2.5), [(3.0, 0, 0, 3.1, 4.0, 2.5)]), OCCUPIED, FREE).astype(np.uint8)
    size_m = (np.array(state.shape) - 2) * 0.1
    if where == "behind a closed door":
        state[45:-1, 1:-1, 1:-1] = UNKNOWN
    elif where == "outside the fence":
        state[2:30, 30:-1, 1:-1] = UNKNOWN
        size_m[1] = 2.85
    else:
        state = below_unknown()
    planner = ViewPlanner(PlannerConfig(), np.zeros(3), size_m, FIXED, YawWhileFlying(0.8, 0.8), timer=lambda: 0.0)
    answer = planner.plan(PlanRequest(voxel_map(state), None, np.array([1.5, 1.0, 1.2]), 0.0, 10))
    assert isinstance(answer, NothingLeft), where
    assert answer.reason.code is ReasonCode.FRONTIERS_LEFT, answer.reason.text()


def test_a_gap_that_was_viewed_without_result_is_no_place_left() -> None:
    state = np.where(room((6.0, 4.0, 2.5), []), OCCUPIED, FREE).astype(np.uint8)
    state[57:61, 10:13, 10:13] = UNKNOWN  # no more than 36 voxels
    planner, position = planner_for(state), np.array([1.5, 2.0, 1.2])
    planner.plan(PlanRequest(voxel_map(state), None, position, 0.0, 10))
    planner.view_history.exhausted[:] = 1
    planner.frontiers.mark_changed(np.arange(state.size))
    answer = planner.plan(PlanRequest(voxel_map(state, 1), None, position, 0.0, 10))
    assert isinstance(answer, NothingLeft)
    assert answer.reason.code is ReasonCode.FRONTIERS_LEFT
    assert ReasonCode.FRONTIERS_VIEWED_WITHOUT_RESULT in answer.reason.codes()


def test_a_passage_that_is_too_narrow_is_named_at_the_end() -> None:
    state = np.where(MEETING_ROOM, OCCUPIED, FREE).astype(np.uint8)
    planner = planner_for(state)
    named = Reason(ReasonCode.PASSAGE_TOO_NARROW, (0.53, 0.57, 4.1, 1.2))

    class Closed:
        places = ()

        def update(self, request: PlanRequest) -> bool:
            return False

        def looks(self, context: object) -> list[CandidateView]:
            return []

        def too_narrow(self) -> list[Reason]:
            return [named] * 20

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planner, "_new_passages", lambda voxels: Closed())
        answer = planner.plan(PlanRequest(voxel_map(state), None, np.array([3.0, 1.0, 1.2]), 0.0, 10))
    assert isinstance(answer, NothingLeft)
    assert answer.reason == Reason(ReasonCode.NO_FRONTIERS_LEFT, details=(named,) * 4)
    assert "an opening at (4.1, 1.2) is too narrow: the map shows 0.53 m, 0.57 m are needed" in answer.reason.text()
