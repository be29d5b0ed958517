"""The planner: frontiers, uncertain surfaces, viewpoints, mode, tour (paper, sections III-A to III-C)."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence

import numpy as np

from uav_recon.config import PlannerConfig, VariantName
from uav_recon.geometry import traversal
from uav_recon.planning import view_history
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.candidate_view import CandidateView, PlanningContext
from uav_recon.planning.free_space import flyable_space as space
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.frontier import frontier_views as views
from uav_recon.planning.frontier import rejection_counts
from uav_recon.planning.frontier.frontier_views import FrontierViews
from uav_recon.planning.frontier.frontiers import Frontiers, fence_box
from uav_recon.planning.frontier.rejection_counts import count_rejected_frontiers
from uav_recon.planning.paths import segments
from uav_recon.planning.paths.path_cache import PathCache
from uav_recon.planning.presets import derived
from uav_recon.planning.reconstruction import gain_field
from uav_recon.planning.reconstruction.gain_field import FieldViews
from uav_recon.planning.reconstruction.surface_views import SurfaceViews
from uav_recon.planning.route_planning import route_to
from uav_recon.planning.task_generation import ClusterTasks, GainField, TaskQuery, TaskSource, places_of
from uav_recon.planning.tour import atsp, travel_time
from uav_recon.planning.tour.stopping_rule import NOT_WORTH
from uav_recon.planning.tour.travel_time import TravelTimeModel, YawWhileFlying, time_costs
from uav_recon.planning.variants import Variant, variant
from uav_recon.planning.view_history import ViewHistory
from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, SurfaceElements, VoxelMap
from uav_recon.types.tasks import NothingLeft, PlanMode, PlanRequest, TaskKind, ViewPath, Viewpoint

TOY_CAMERA = CameraGeometry(1.5, 1.0, np.zeros(3), -1.0, 1.0, 4.5)  # to warm up with
TOY_CONFIG = PlannerConfig(clearance_m=0.3)
SAME_SHARE = 0.5  # of what a task is to settle: if the committed view settles so much of it, it is no task of its own


class ViewPlanner:
    """Chooses views and the way to them; one per flight. It keeps what it found out about the map, and looks at changes alone.

    The same requests and accepted paths in the same order give the same answers. fence_min_m, fence_max_m: (3,) box in world
    that is to be explored; the body keeps ``fence_inset_m`` away from its sides. speed_mps, yaw_rate_radps: what a flight is
    reckoned with. timer: seconds; read only to fill task_s and step_s.

    For who goes on where it has nothing left: config with all that a preset gives, camera as the variant uses its mount, and as
    the last request left them, space, frontiers and what was visited.
    """

    space: FlyableSpace

    def __init__(
        self,
        config: PlannerConfig,
        fence_min_m: FloatArray,
        fence_max_m: FloatArray,
        camera: CameraGeometry,
        price: TravelTimeModel,
        timer: Callable[[], float] = time.perf_counter,
        fence_inset_m: float | None = None,
    ) -> None:
        self.fence_m = np.asarray(fence_min_m, dtype=np.float64), np.asarray(fence_max_m, dtype=np.float64)
        self.config = config = derived(config, *self.fence_m, camera)
        self._inset_m = config.clearance_m if fence_inset_m is None else fence_inset_m
        self._price, self._timer = price, timer
        self._variant = variant(config.variant, config)
        self.camera = self._variant.camera(camera)
        self._source = _source(config, self._variant, self.camera)
        self.frontiers, self.visited = Frontiers(), ViewHistory()
        self._frame: tuple[object, ...] = ()
        self._offered: tuple[ViewPath, tuple[CandidateView, ...]] | None = None

    @property
    def explores(self) -> bool:
        """Whether frontiers are ever looked at."""
        return TaskKind.EXPLORE in self._variant.kinds

    def plan(self, request: PlanRequest) -> ViewPath | NothingLeft:
        """Choose the next views and the way to them. About a millisecond, more with surface; never raises for a map."""
        start_s = self._timer()
        situation = self._look(request)
        if isinstance(situation, str):
            return self._nothing(situation, start_s, start_s)
        harvest = self._source.propose(
            TaskQuery(situation, self.frontiers, self._ways, request.surface, self.visited.surface_looks, request.views_left)
        )
        committed = self._committed(situation, request)
        tasks = _without_what_they_settle(committed, harvest.proposals)
        tasks_made_s = self._timer()
        order, dropped = self._order(situation, request, tasks, len(committed))
        if not order:
            return self._nothing(self._why(situation, dropped), start_s, tasks_made_s)
        nodes = self._within_horizon(order, harvest.widening)
        path = self._path(request, harvest.mode, tasks, nodes, start_s, tasks_made_s)
        self._offered = path, tuple(tasks[node - 1] for node in nodes)
        return path

    def accept(self, path: ViewPath) -> None:
        """Remember what the views of a path made by plan() are to settle."""
        if self._offered is not None and self._offered[0] is path:
            self.visited.promise(*self._offered)

    def still_worth(self, voxels: VoxelMap, position_world: FloatArray, yaw_rad: float) -> bool:
        """Whether the next view of the accepted path still promises anything in a newer map."""
        following = self.visited.next_promised(position_world, yaw_rad)
        return following is None or self.visited.is_worth(voxels, following)

    def route(self, request: PlanRequest, goal: Viewpoint) -> ViewPath | NothingLeft:
        """The shortest way to a place; its last waypoint is the flyable voxel nearest to it. Promises and remembers nothing."""
        start_s = self._timer()
        situation = self._look(dataclasses.replace(request, views_left=1))
        if isinstance(situation, str):
            return self._nothing(situation, start_s, start_s)
        proposal = route_to(situation, goal)
        if proposal is None:
            return self._nothing("no known-free way leads there", start_s, start_s)
        self._ways.update(situation.exit_cells, request.position_world, places_of([proposal]))
        return self._path(request, PlanMode.EXPLORE, [proposal], [1], start_s, start_s)

    def _look(self, request: PlanRequest) -> PlanningContext | str:
        """Bring everything up to date with the map; where one may fly, or why no plan can start from here."""
        voxels = request.voxels
        frame = (voxels.grid.shape, voxels.grid.resolution_m, *voxels.grid.origin_world_m.tolist())
        if frame != self._frame:
            self._frame = frame
            self.space = FlyableSpace(voxels.grid, self.config.clearance_m, *self._box(voxels.grid, self._inset_m))
            self._ways = PathCache(self.space)
        self.frontiers.touch(self.visited.settle(request))
        self.frontiers.update(voxels, *self._box(voxels.grid, 0.0), self.visited.exhausted)
        if request.views_left <= 0:
            return "no view is left in the budget"
        self.space.update(voxels)
        exit_cells = self.space.stand(request.position_world)
        if exit_cells is None:
            return "the vehicle stands in space that is not known free, with no known-free way to where it may fly"
        return PlanningContext(voxels, self.space, exit_cells, request.position_world)

    def _committed(self, situation: PlanningContext, request: PlanRequest) -> list[CandidateView]:
        """In motion the view that is being flown to stays the next one while it is worth it: minds do not change in mid-way."""
        following = self.visited.next_promised(request.position_world, request.yaw_rad)
        if (
            following is None
            or not request.velocity_world_mps.any()
            or not situation.holds(following.place)
            or not self.visited.is_worth(situation.voxels, following)
        ):
            return []
        return [following]

    def _order(
        self, situation: PlanningContext, request: PlanRequest, tasks: list[CandidateView], committed: int
    ) -> tuple[list[int], int]:
        """Nodes to fly to, the ``committed`` (0 or 1) first; and how many surface tasks were not worth their flight."""
        self._ways.update(situation.exit_cells, request.position_world, places_of(tasks))
        costs_s = time_costs(self._ways, tasks, request.yaw_rad, request.velocity_world_mps, self._price)
        # the tour begins at the committed view
        kept = self._variant.choice.order([one.task for one in tasks[committed:]], costs_s[committed:, committed:])
        order = [*range(1, committed + 1), *(int(node) + committed for node in kept.order)]
        return order[: request.views_left], kept.dropped

    def _within_horizon(self, order: list[int], widening: float) -> list[int]:
        """The tour's first nodes while the way stays within L_exec; at least one."""
        lengths_m = self._ways.lengths_m
        travelled_m = np.cumsum([lengths_m[i, j] for i, j in zip([0, *order[:-1]], order, strict=True)])
        return order[: max(1, int(np.searchsorted(travelled_m, self.config.horizon_m * widening, side="right")))]

    def _path(
        self,
        request: PlanRequest,
        mode: PlanMode,
        tasks: Sequence[CandidateView],
        nodes: list[int],
        start_s: float,
        tasks_made_s: float,
    ) -> ViewPath:
        chosen = tuple(tasks[node - 1].task for node in nodes)
        return ViewPath(
            viewpoints=tuple(task.viewpoint for task in chosen),
            waypoints_world=tuple(self._ways.way_world(i, j) for i, j in zip([0, *nodes[:-1]], nodes, strict=True)),
            mode=mode,
            map_revision=request.voxels.revision,
            map_epoch=request.voxels.map_epoch,
            tasks=chosen,
            task_s=tasks_made_s - start_s,
            step_s=self._timer() - start_s,
        )

    def _why(self, situation: PlanningContext, not_worth: int) -> str:
        """'14 frontiers left: 9 too narrow, 5 outside the fence', or that there is none; and surface not worth its flight."""
        counts = {
            **dict(sorted(self._source.reasons(situation, self.frontiers).items())),
            **count_rejected_frontiers(situation.voxels.state, self.frontiers.faces, self.visited.exhausted),
        }
        total = sum(counts.values())
        said = f"{total} frontier{'s' if total > 1 else ''} left: " if total else "no frontiers left"
        said += ", ".join(f"{n} {why}" for why, n in counts.items() if n)
        return said + (f"; {not_worth} surface task{'s' if not_worth > 1 else ''} {NOT_WORTH}" if not_worth else "")

    def _box(self, grid: GridSpec, inset_m: float) -> tuple[IntArray, IntArray]:
        return fence_box(grid, self.fence_m[0] + inset_m, self.fence_m[1] - inset_m)

    def _nothing(self, reason: str, start_s: float, tasks_made_s: float) -> NothingLeft:
        return NothingLeft(reason, task_s=tasks_made_s - start_s, step_s=self._timer() - start_s)


def _source(config: PlannerConfig, made_of: Variant, camera: CameraGeometry) -> TaskSource:
    views = FrontierViews(config, camera)
    if made_of.views == "field":
        return GainField(FieldViews(config, camera), views)
    return ClusterTasks(config, made_of, views, SurfaceViews(config, camera))


def _without_what_they_settle(committed: list[CandidateView], proposals: list[CandidateView]) -> list[CandidateView]:
    """The committed views, then the tasks that these do not settle as well."""
    tasks = list(committed)
    for proposal in proposals:
        if all(_share_in(proposal.promised, one.promised) < SAME_SHARE for one in committed):
            tasks.append(proposal)
    return tasks


def _share_in(promised: IntArray, settled: IntArray) -> float:
    """Share of some voxels (N,) that are among others (M,)."""
    return float(np.isin(promised, settled).mean()) if len(promised) else 0.0


def warm_up_frontiers() -> None:
    """Compile the kernels of frontiers and their views: a third of the planner's."""
    views.warm_up(TOY_CONFIG, TOY_CAMERA)


def warm_up(name: VariantName) -> None:
    """Compile every kernel of the planner: on a toy map that grows, surface included, by every way of choosing.

    The vehicle and its camera are toys too: in a room as small as this the real one might find nothing to do.
    """
    config, camera = TOY_CONFIG, TOY_CAMERA
    for module in (traversal, segments, space, atsp, travel_time, view_history, gain_field, rejection_counts):
        module.warm_up()
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
                planner.still_worth(voxels, np.array(position), 0.0)
        planner.route(
            PlanRequest(voxels, None, np.array([1.0, 1.0, 1.0]), 0.0, 1), Viewpoint(np.array([3.0, 2.0, 1.0]), 0.0, 0.0)
        )
