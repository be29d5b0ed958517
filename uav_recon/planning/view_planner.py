"""The planner: frontiers, uncertain surface, viewpoints, mode, tour.

Paper, sections III-A to III-C.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from uav_recon.config import PlannerConfig, VariantName
from uav_recon.geometry import traversal
from uav_recon.planning import view_history
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.candidate_view import CandidateView, PlanningContext
from uav_recon.planning.free_space import flyable_space as space
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.frontier import frontier_views as views
from uav_recon.planning.frontier import rejection_counts
from uav_recon.planning.frontier.frontier_views import LOW, FrontierViews
from uav_recon.planning.frontier.frontiers import Frontiers, fence_box
from uav_recon.planning.frontier.places_left import count_places_left
from uav_recon.planning.frontier.rejection_counts import count_rejected_frontiers
from uav_recon.planning.passages import passages
from uav_recon.planning.passages.passages import Passages
from uav_recon.planning.paths import segments
from uav_recon.planning.paths.path_cache import PathCache
from uav_recon.planning.place_sight import PlaceSight
from uav_recon.planning.presets import derived
from uav_recon.planning.reconstruction import gain_field
from uav_recon.planning.reconstruction.gain_field import FieldViews
from uav_recon.planning.reconstruction.seen_surface import SeenSurface
from uav_recon.planning.reconstruction.surface_elements import ElementsCache
from uav_recon.planning.reconstruction.surface_views import SurfaceViews
from uav_recon.planning.route_planning import route_to
from uav_recon.planning.task_generation import ClusterTasks, GainField, GeneratedTasks, TaskQuery, TaskSource, view_positions
from uav_recon.planning.tour import atsp, travel_time
from uav_recon.planning.tour.rooms import Rooms
from uav_recon.planning.tour.task_ordering import best_by_rate
from uav_recon.planning.tour.travel_time import TravelTimeModel, YawWhileFlying, time_costs
from uav_recon.planning.variants import Variant, variant
from uav_recon.planning.view_headings import suited_to_path
from uav_recon.planning.view_history import ViewHistory
from uav_recon.types.argument_checks import require_box, require_kind, require_number, require_pose
from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, SurfaceElements, VoxelMap
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.rgbd_camera import Camera
from uav_recon.types.tasks import NothingLeft, PlanMode, PlanRequest, TaskKind, ViewPath, Viewpoint

TOY_CAMERA = CameraGeometry(1.5, 1.0, np.zeros(3), -1.0, 1.0, 4.5)  # for warm_up()
TOY_CONFIG = PlannerConfig(clearance_m=0.3)
MIN_UNKNOWN_VOXELS = 25  # voxels beyond the frontier that a last view must promise: a gap in a surface has fewer
MIN_VISIBLE_SHARE = 0.4  # of planner.min_visible: surface elements that a last view must show
SEARCH_LESS_M = 0.045  # clearance below that of a passage at which its fine map is wanted: voxels may show this much less
MOST_NAMED = 4  # openings that are too narrow: the widest of them are named
SAME_SHARE = 0.5  # a task is dropped if the committed view settles this share of its voxels


class ViewPlanner:
    """Chooses views and the path to them; one object per flight.

    Caches map results across plans. Only changed parts of the map are evaluated again. The same requests and accepted
    paths, in the same order, give the same results.

    fence_min_m, fence_max_m: (3,) corners in world of the box to be explored.
    fence_inset_m: distance that the body keeps from the sides of the box, (3,) or the same along each axis.
    travel_time_model: predicts the travel time of a path.
    timer: returns seconds; read only to fill task_s and step_s.
    passage_m: clearance that the body needs in a narrow passage, as measured in fine maps; None = it uses none.

    Public attributes, for FallbackPlanner: config (with all values of the preset), camera (as the variant uses its
    mount), and space, frontiers and visited in the state of the last request.
    """

    space: FlyableSpace

    def __init__(
        self,
        config: PlannerConfig,
        fence_min_m: FloatArray,
        fence_max_m: FloatArray,
        camera: CameraGeometry,
        travel_time_model: TravelTimeModel,
        timer: Callable[[], float] = time.perf_counter,
        fence_inset_m: float | FloatArray | None = None,
        passage_m: float | None = None,
    ) -> None:
        self.fence_m = np.asarray(fence_min_m, dtype=np.float64), np.asarray(fence_max_m, dtype=np.float64)
        self.config = config = derived(config, *self.fence_m, camera)
        self._inset_m = config.clearance_m if fence_inset_m is None else fence_inset_m
        self._passage_m = passage_m
        self._passages: Passages | None = None
        self._travel_time_model = travel_time_model
        self._timer = timer
        self._variant = variant(config.variant, config)
        self.camera = self._variant.camera(camera)
        self._elements = ElementsCache(config.downsample)
        self._seen_surface = SeenSurface(self.camera, self._elements)
        self._source = _source(config, self._variant, self.camera, self._elements)
        self.frontiers = Frontiers()
        self._rooms = Rooms(float(self.fence_m[0][2]))
        self.view_history = ViewHistory()
        self._frame: tuple[object, ...] = ()
        self._low_demand: TaskSource | None = None  # made when first needed
        self._asked: tuple[PlanRequest, PlanningContext] | None = None
        self._newest_path: tuple[ViewPath, tuple[CandidateView, ...]] | None = None

    @classmethod
    def for_box(
        cls,
        box_min_m: ArrayLike,
        box_max_m: ArrayLike,
        camera: Camera,
        *,
        variant: VariantName = "adaptive",
        clearance_m: float = 0.35,
        max_range_m: float = 5.0,
        speed_mps: float = 1.0,
        yaw_rate_radps: float = math.radians(45.0),
    ) -> ViewPlanner:
        """Return a planner for a box and a camera, with the defaults of the configuration.

        box_min_m, box_max_m (3,): the space to explore, in world, metres. variant: see config.VariantName. clearance_m:
        distance from the body's centre to anything not known free. max_range_m: that of the occupancy map. speed_mps,
        yaw_rate_radps: of the vehicle, for the order of the views. Raises ValueError for an invalid argument.
        """
        low, high = require_box(box_min_m, box_max_m)
        require_kind("camera", camera, Camera)
        if variant not in (names := get_args(VariantName)):
            raise ValueError(f"variant: {variant!r}, expected one of {', '.join(names)}")
        require_number("clearance_m", clearance_m, 0.3, 1.0)
        require_number("max_range_m", max_range_m, 0.1, 100.0)
        require_number("speed_mps", speed_mps, 0.05, 3.0)
        require_number("yaw_rate_radps", yaw_rate_radps, 0.01, 10.0)
        config = PlannerConfig(variant=variant, clearance_m=clearance_m)
        return cls(config, low, high, CameraGeometry.of(camera, max_range_m), YawWhileFlying(speed_mps, yaw_rate_radps))

    @property
    def explores(self) -> bool:
        """Return True if the variant generates frontier tasks."""
        return TaskKind.EXPLORE in self._variant.kinds

    def plan(self, request: PlanRequest) -> ViewPath | NothingLeft:
        """Choose the next views and the path to them. Never raises because of the map.

        Takes about a millisecond, more with surface tasks.
        """
        start_s = self._timer()
        context = self._update_maps(request)
        if isinstance(context, Reason):
            return self._nothing(context, start_s, start_s)
        self._asked = request, context
        return self._choose(self._source, request, context, start_s)

    def plan_with_less_demand(self, request: PlanRequest) -> ViewPath | None:
        """Choose views that show less than plan() asks for; None if there are none.

        request: that of the last plan(), which found nothing.
        """
        if self._asked is None or self._asked[0] is not request or self._variant.views != "clusters":
            return None
        if self._low_demand is None:
            self._low_demand = _low_demand_source(self.config, self._variant, self.camera, self._elements)
        found = self._choose(self._low_demand, request, self._asked[1], self._timer())
        return found if isinstance(found, ViewPath) else None

    def _choose(
        self, source: TaskSource, request: PlanRequest, context: PlanningContext, start_s: float
    ) -> ViewPath | NothingLeft:
        """Return the tour over the tasks of a source."""
        generated = source.propose(
            TaskQuery(
                context,
                self.frontiers,
                self._path_cache,
                request.surface,
                self.view_history.surface_cosine_sums,
                request.views_left,
            )
        )
        committed = self._committed(context, request)
        sight = None if request.cells is None else PlaceSight(request.cells, self.camera)
        looks = [] if self._passages is None else self._passages.looks(context)
        shown, blind = self._shown(sight, self._not_refused([*generated.proposals, *looks]))
        tasks = _drop_duplicate_tasks(committed, shown)
        tasks_made_s = self._timer()
        order, dropped = self._order(context, request, tasks, len(committed))
        if not order:
            return self._nothing(self._nothing_reason(context, dropped, blind), start_s, tasks_made_s)
        nodes = self._within_horizon(order, generated.widening)
        views = self._turned_to_path(request, [tasks[node - 1] for node in nodes], nodes, len(committed), sight)
        path = self._path(request, generated, views, nodes, start_s, tasks_made_s)
        self._newest_path = path, tuple(views)
        return path

    def _not_refused(self, proposals: list[CandidateView]) -> list[CandidateView]:
        """Return the views to which no motion was just refused; all if there is no other."""
        return [one for one in proposals if not self.view_history.is_set_aside(one)] or proposals

    @staticmethod
    def _shown(sight: PlaceSight | None, proposals: list[CandidateView]) -> tuple[list[CandidateView], int]:
        """Return the views that show the place, with the gains that count.

        And the number of others.
        """
        shown = proposals if sight is None else sight.weighed(proposals)
        return shown, len(proposals) - len(shown)

    def plan_views(
        self, voxels: VoxelMap, world_from_body: Pose, views: int, surface: SurfaceElements | None = None
    ) -> ViewPath | NothingLeft:
        """Choose at most ``views`` next views from a body at rest, and the path to them.

        It returns NothingLeft with a reason if there is no view. voxels: the newest map. surface: the newest surface of a
        neural mapper; without it only frontiers are planned. Call accept() with a path that is flown. Raises ValueError for
        a value of another type.
        """
        pose = require_pose("world_from_body", world_from_body)
        newest = require_kind("voxels", voxels, VoxelMap, "OccupancyMapper.map")
        return self.plan(PlanRequest(newest, surface, pose.translation_m, pose.yaw_rad(), views))

    @property
    def fine_places(self) -> tuple[FloatArray, ...]:
        """See interfaces.Planner."""
        return () if self._passages is None else self._passages.places

    def accept(self, path: ViewPath) -> None:
        """Store what the views of a path made by plan(), or of its first leg, should settle."""
        if self._newest_path is None:
            return
        newest, views = self._newest_path
        count = len(path.tasks)
        if path is newest or (count and path.tasks == newest.tasks[:count]):
            self.view_history.set_expected_views(path, views[:count])

    def next_view_has_gain(self, voxels: VoxelMap, position_world: FloatArray, yaw_rad: float) -> bool:
        """Return True if the next view of the accepted path still has a gain in a newer map."""
        following = self.view_history.next_expected_view(position_world, yaw_rad)
        return following is None or self.view_history.still_has_gain(voxels, following)

    def route(self, request: PlanRequest, goal: Viewpoint) -> ViewPath | NothingLeft:
        """Return the shortest path to a position. Its last waypoint is the nearest flyable voxel.

        The result is not stored: no view is expected.
        """
        start_s = self._timer()
        context = self._update_maps(dataclasses.replace(request, views_left=1))
        if isinstance(context, Reason):
            return self._nothing(context, start_s, start_s)
        proposal = route_to(context, goal)
        if proposal is None:
            return self._nothing(Reason(ReasonCode.NO_KNOWN_PATH), start_s, start_s)
        self._path_cache.update(context.exit_cells, request.position_world, view_positions([proposal]))
        return self._path(request, GeneratedTasks(PlanMode.EXPLORE, [], 0), [proposal], [1], start_s, start_s)

    def _update_maps(self, request: PlanRequest) -> PlanningContext | Reason:
        """Update all caches with the map.

        Return the context, or the reason why no plan can start here.
        """
        voxels = request.voxels
        frame = (voxels.grid.shape, voxels.grid.resolution_m, *voxels.grid.origin_world_m.tolist())
        if frame != self._frame:
            self._frame = frame
            self.space = FlyableSpace(
                voxels.grid, self.config.clearance_m, *self._box(voxels.grid, self._inset_m), voxels.heights
            )
            self._path_cache = PathCache(self.space)
            self._passages = self._new_passages(voxels)
        self.frontiers.mark_changed(self.view_history.evaluate_flown_views(request))
        self._seen_surface.update(request, self.view_history.surface_cosine_sums)
        self.frontiers.update(voxels, *self._box(voxels.grid, 0.0), self.view_history.exhausted)
        if request.views_left <= 0:
            return Reason(ReasonCode.NO_VIEWS_LEFT)
        self.space.update(voxels)
        exit_cells = self.space.locate_vehicle(request.position_world)
        if exit_cells is None:
            return Reason(ReasonCode.START_NOT_FREE)
        if self._passages is not None and self._passages.update(request):
            self.space.update(voxels)
            exit_cells = self.space.locate_vehicle(request.position_world)
            if exit_cells is None:
                return Reason(ReasonCode.START_NOT_FREE)
        return PlanningContext(voxels, self.space, exit_cells, request.position_world)

    def _new_passages(self, voxels: VoxelMap) -> Passages | None:
        """Return the passages of a new map, None if narrow passages are not used."""
        if self._passage_m is None or not self.explores:
            return None
        clearance_m = self._passage_m - SEARCH_LESS_M
        tight = FlyableSpace(voxels.grid, clearance_m, *self._box(voxels.grid, self._inset_m), voxels.heights)
        return Passages(self.space, tight, self._passage_m, self.camera)

    def _committed(self, context: PlanningContext, request: PlanRequest) -> list[CandidateView]:
        """Return the view being flown to, if it is still worth it, else an empty list.

        Thus the goal does not change in motion.
        """
        following = self.view_history.next_expected_view(request.position_world, request.yaw_rad)
        if (
            following is None
            or not request.velocity_world_mps.any()
            or not context.is_clear(following.position_padded)
            or not self.view_history.still_has_gain(context.voxels, following)
        ):
            return []
        return [following]

    def _order(
        self, context: PlanningContext, request: PlanRequest, tasks: list[CandidateView], committed: int
    ) -> tuple[list[int], int]:
        """Return the nodes to fly to and the number of dropped surface tasks.

        committed: 1 if the first task is committed and stays first, else 0.
        """
        self._path_cache.update(context.exit_cells, request.position_world, view_positions(tasks))
        costs_s = time_costs(self._path_cache, tasks, request.yaw_rad, request.velocity_world_mps, self._travel_time_model)
        if self.space.is_confined(context.position_world) and tasks:
            # one view may open the way to others
            return [1] if committed else [best_by_rate([one.task for one in tasks], costs_s)], 0
        # the tour begins at the committed view
        views = [one.task for one in tasks[committed:]]
        start_world = tasks[committed - 1].task.viewpoint.position_world if committed else context.position_world
        places = np.array([start_world, *(task.viewpoint.position_world for task in views)])
        rooms = self._rooms.of(context.voxels, places)
        kept = self._variant.task_ordering.order(views, costs_s[committed:, committed:], rooms)
        order = [*range(1, committed + 1), *(int(node) + committed for node in kept.order)]
        return order[: request.views_left], kept.dropped

    def _within_horizon(self, order: list[int], widening: float) -> list[int]:
        """Return the first nodes of the tour whose path is within L_exec; at least one."""
        lengths_m = self._path_cache.lengths_m
        travelled_m = np.cumsum([lengths_m[i, j] for i, j in zip([0, *order[:-1]], order, strict=True)])
        return order[: max(1, int(np.searchsorted(travelled_m, self.config.horizon_m * widening, side="right")))]

    def _legs(self, nodes: list[int]) -> tuple[FloatArray, ...]:
        """Return the waypoints (N, 3) of the leg to each node of a tour."""
        legs = (self._path_cache.path_world(i, j) for i, j in zip([0, *nodes[:-1]], nodes, strict=True))
        return tuple(legs if self._passages is None else map(self._passages.along, legs))

    def _turned_to_path(
        self, request: PlanRequest, views: list[CandidateView], nodes: list[int], committed: int, sight: PlaceSight | None
    ) -> list[CandidateView]:
        """Return the views with headings that suit the path.

        A view that is being flown to keeps its heading.
        """
        grid = request.voxels.grid
        lens, yaw_rad = self.camera.lens(grid.resolution_m, self.camera.range_m), request.yaw_rad
        if committed:
            yaw_rad = views[0].task.viewpoint.yaw_rad
        legs = self._legs(nodes)[committed:]
        return views[:committed] + suited_to_path(views[committed:], legs, yaw_rad, lens, grid.shape, sight)

    def _path(
        self,
        request: PlanRequest,
        generated: GeneratedTasks,
        views: Sequence[CandidateView],
        nodes: list[int],
        start_s: float,
        tasks_made_s: float,
    ) -> ViewPath:
        chosen = tuple(view.task for view in views)
        return ViewPath(
            viewpoints=tuple(task.viewpoint for task in chosen),
            waypoints_world=self._legs(nodes),
            mode=generated.mode,
            map_revision=request.voxels.revision,
            map_epoch=request.voxels.map_epoch,
            tasks=chosen,
            task_s=tasks_made_s - start_s,
            step_s=self._timer() - start_s,
            frontiers=generated.frontiers,
            explored=generated.explored,
        )

    def _nothing_reason(self, context: PlanningContext, not_worth: int, blind: int) -> Reason:
        """Return the reason for an empty plan.

        It counts the frontiers by reason, the dropped surface tasks, and the views that do not show where the vehicle is.

        It names the openings that are too narrow. Example: '14 frontiers left: 9 too narrow, 5 outside the fence', or 'no
        frontiers left'. Places that could have been seen come first: '2 place(s) left unseen: 2 viewed without result, 14 ...'.
        """
        counts = {
            **dict(sorted(self._source.reasons(context, self.frontiers).items())),
            **count_rejected_frontiers(context.voxels.state, self.frontiers.faces, self.view_history.exhausted),
        }
        total = sum(counts.values())
        details = [Reason(code, (n,)) for code, n in counts.items() if n]
        details += [Reason(ReasonCode.SURFACE_NOT_WORTH, (not_worth,))] if not_worth else []
        details += [Reason(ReasonCode.VIEWS_BLIND, (blind,))] if blind else []
        details += [] if self._passages is None else self._passages.too_narrow()[:MOST_NAMED]
        if not total:
            frontiers = Reason(ReasonCode.NO_FRONTIERS_LEFT, details=tuple(details))
        else:
            frontiers = Reason(ReasonCode.FRONTIERS_LEFT, (total,), tuple(details))
        return self._with_places_left(context, frontiers)

    def _with_places_left(self, context: PlanningContext, frontiers: Reason) -> Reason:
        """Return the reason for an empty plan, after the places that could have been seen, if any."""
        if not self.explores:
            return frontiers
        views, exhausted = FrontierViews(self.config, self.camera), self.view_history.exhausted
        counts = count_places_left(context.voxels, context.space, self.frontiers, exhausted, views)
        if not counts:
            return frontiers
        details = (*(Reason(code, (n,)) for code, n in counts.items()), frontiers)
        return Reason(ReasonCode.PLACES_LEFT_UNSEEN, (sum(counts.values()),), details)

    def _box(self, grid: GridSpec, inset_m: float | FloatArray) -> tuple[IntArray, IntArray]:
        return fence_box(grid, self.fence_m[0] + inset_m, self.fence_m[1] - inset_m)

    def _nothing(self, reason: Reason, start_s: float, tasks_made_s: float) -> NothingLeft:
        return NothingLeft(reason, task_s=tasks_made_s - start_s, step_s=self._timer() - start_s)


def _source(config: PlannerConfig, planner_variant: Variant, camera: CameraGeometry, elements: ElementsCache) -> TaskSource:
    views = FrontierViews(config, camera)
    if planner_variant.views == "field":
        return GainField(FieldViews(config, camera), views)
    return ClusterTasks(config, planner_variant, views, SurfaceViews(config, camera, elements))


def _low_demand_source(
    config: PlannerConfig, planner_variant: Variant, camera: CameraGeometry, elements: ElementsCache
) -> TaskSource:
    """Return the source of the tasks that are flown before the flight ends with views left."""
    less = config.model_copy(update={"min_visible": max(round(MIN_VISIBLE_SHARE * config.min_visible), 1)})
    views = FrontierViews(config, camera, LOW)
    surfaces = SurfaceViews(less, camera, elements)
    return ClusterTasks(less, planner_variant, views, surfaces, min_unknown=MIN_UNKNOWN_VOXELS)


def _drop_duplicate_tasks(committed: list[CandidateView], proposals: list[CandidateView]) -> list[CandidateView]:
    """Return the committed views, then the tasks that these do not settle as well."""
    tasks = list(committed)
    for proposal in proposals:
        if all(_share_in(proposal.expected_voxels, one.expected_voxels) < SAME_SHARE for one in committed):
            tasks.append(proposal)
    return tasks


def _share_in(expected: IntArray, settled: IntArray) -> float:
    """Return the share of some voxels (N,) that are among others (M,)."""
    return float(np.isin(expected, settled).mean()) if len(expected) else 0.0


def warm_up_frontiers() -> None:
    """Compile the kernels of frontiers and their views: a third of the planner's."""
    views.warm_up(TOY_CONFIG, TOY_CAMERA)


def warm_up_paths() -> None:
    """Compile the kernels of flyable space, paths, tours and gains: another third."""
    for module in (traversal, segments, space, atsp, travel_time, view_history, gain_field, rejection_counts, passages):
        module.warm_up()


def warm_up(name: VariantName) -> None:
    """Compile every kernel of the planner on a small growing map with surface.

    Vehicle and camera are small too: in so small a room the real ones might find no task.
    """
    config, camera = TOY_CONFIG, TOY_CAMERA
    warm_up_paths()
    warm_up_frontiers()
    grid = GridSpec(np.zeros(3), 0.1, (40, 30, 20))
    low_m, high_m = np.zeros(3), np.array([4.0, 3.0, 2.0])
    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(0.2, 2.5, 4000), rng.uniform(0.2, 2.8, 4000), np.full(4000, 0.1)], axis=1)
    surface = SurfaceElements(points, np.tile([0.0, 0.0, 1.0], (4000, 1)), rng.uniform(0.5, 1.0, 4000), 1)
    for chosen in ("merged", name):
        planner = ViewPlanner(config.model_copy(update={"variant": chosen}), low_m, high_m, camera, YawWhileFlying(0.8, 0.8))
        for revision, (position, unknown_from) in enumerate(
            (((1.0, 1.0, 1.0), 24), ((3.9, 0.05, 1.0), 28), ((1.0, 1.0, 1.0), 40))
        ):
            state = np.full(grid.shape, FREE, dtype=np.uint8)
            state[[0, -1]], state[:, [0, -1]], state[:, :, [0, -1]] = OCCUPIED, OCCUPIED, OCCUPIED
            state[20, :22], state[unknown_from:, :20] = OCCUPIED, 0
            voxels = VoxelMap.whole(grid, state, np.where(state == FREE, 25, 0).astype(np.uint8), revision)
            path = planner.plan(PlanRequest(voxels, surface, np.array(position), 0.0, 10, np.full(3, 0.1 * revision)))
            if isinstance(path, ViewPath):
                planner.accept(path)
                planner.next_view_has_gain(voxels, np.array(position), 0.0)
        planner.route(
            PlanRequest(voxels, None, np.array([1.0, 1.0, 1.0]), 0.0, 1), Viewpoint(np.array([3.0, 2.0, 1.0]), 0.0, 0.0)
        )
