"""The planner: frontiers, uncertain surfaces, viewpoints, mode, tour (paper, sections III-A to III-C)."""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from collections.abc import Callable

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.geometry import traversal
from uav_recon.planning import search, tour, visited
from uav_recon.planning.camera import CameraGeometry
from uav_recon.planning.flyable import FlyableSpace, way_out
from uav_recon.planning.frontiers import FrontierCensus, count_outside, fence_box, find_frontiers, unknown_faces
from uav_recon.planning.homing import proposal_for
from uav_recon.planning.modes import AlwaysMerged, ModeRule, mode_rule
from uav_recon.planning.proposal import Proposal, Situation
from uav_recon.planning.routes import Routes, time_costs
from uav_recon.planning.surfaces import SurfaceViews
from uav_recon.planning.viewpoints import FrontierProposals, FrontierViews
from uav_recon.planning.visited import Visited
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, SurfaceElements, VoxelMap
from uav_recon.types.tasks import NothingLeft, PlanMode, PlanRequest, ViewPath, Viewpoint

MAX_TOUR_TASKS = 24  # the nearest ones: the horizon executes only the first few


class AdaptivePlanner:
    """Chooses views and the way to them. plan() depends on the request and on what earlier plans promised (``visited``), alone.

    fence_min_m, fence_max_m: (3,) box in world that is to be explored; the body keeps ``fence_inset_m`` away from its sides.
    speed_mps, yaw_rate_radps: what a flight is reckoned with. timer: seconds; read only to fill task_s and step_s.
    """

    def __init__(
        self,
        config: PlannerConfig,
        fence_min_m: FloatArray,
        fence_max_m: FloatArray,
        camera: CameraGeometry,
        speed_mps: float,
        yaw_rate_radps: float,
        timer: Callable[[], float] = time.perf_counter,
        mode: ModeRule | None = None,
        fence_inset_m: float | None = None,
    ) -> None:
        self._config = config
        self._fence_min_m = np.asarray(fence_min_m, dtype=np.float64)
        self._fence_max_m = np.asarray(fence_max_m, dtype=np.float64)
        self._inset_m = config.clearance_m if fence_inset_m is None else fence_inset_m
        self._speed_mps, self._yaw_rate_radps = speed_mps, yaw_rate_radps
        self._timer = timer
        self._mode = mode_rule(config.variant, config) if mode is None else mode
        self._frontier_views = FrontierViews(config, camera)
        self._surface_views = SurfaceViews(config, camera)
        self.visited = Visited()
        self._offered: tuple[ViewPath, tuple[Proposal, ...]] | None = None

    def plan(self, request: PlanRequest) -> ViewPath | NothingLeft:
        """Choose the next views and the way to them. Never blocks; tens of milliseconds for a room; never raises for a map."""
        start_s = self._timer()
        faces = unknown_faces(request.voxels.state, *self._box(request.voxels.grid, 0.0))
        self.visited.settle(request)
        situation = self._situation(request)
        if isinstance(situation, str):
            return self._nothing(situation, start_s, start_s)
        census = find_frontiers(faces, self.visited.exhausted > 0, request.voxels.grid.resolution_m)
        explore = self._frontier_views.propose(situation, census.frontiers)
        mode = self._mode.choose(_distances_m(situation, explore))
        widening = 1.0 if explore.proposals else self._config.end_factor
        tasks = self._frontier_views.without_redundant(situation, explore.proposals, faces)
        tasks += self._reconstruct(mode, situation, request.surface, widening)
        tasks_made_s = self._timer()
        if not tasks:
            return self._nothing(_why(census, explore.without_view, request.voxels.state, faces), start_s, tasks_made_s)
        tasks = nearest(situation, tasks, MAX_TOUR_TASKS)
        routes = Routes(situation, request.position_world, tasks)
        order = self._order(request, routes, tasks)
        horizon_m = self._config.horizon_m * widening
        path = self._path(
            request, mode, routes, tasks, within_horizon(order, routes.lengths_m, horizon_m), start_s, tasks_made_s
        )
        self._offered = path, tuple(tasks[node - 1] for node in order[: len(path.viewpoints)])
        return path

    def accept(self, path: ViewPath) -> None:
        """Remember what the views of a path made by plan() are to settle."""
        if self._offered is not None and self._offered[0] is path:
            self.visited.promise(*self._offered)

    def still_worth(self, voxels: VoxelMap, position_world: FloatArray, yaw_rad: float) -> bool:
        """Whether the next view of the accepted path still promises anything in a newer map."""
        return self.visited.still_worth(voxels, position_world, yaw_rad)

    def route(self, request: PlanRequest, goal: Viewpoint) -> ViewPath | NothingLeft:
        """The shortest way to a place; its last waypoint is the flyable voxel nearest to it. Promises and remembers nothing."""
        start_s = self._timer()
        situation = self._situation(dataclasses.replace(request, views_left=1))
        if isinstance(situation, str):
            return self._nothing(situation, start_s, start_s)
        proposal = proposal_for(situation, goal)
        if proposal is None:
            return self._nothing("no known-free way leads there", start_s, start_s)
        routes = Routes(situation, request.position_world, [proposal])
        return self._path(request, PlanMode.EXPLORE, routes, [proposal], [1], start_s, start_s)

    def _box(self, grid: GridSpec, inset_m: float) -> tuple[IntArray, IntArray]:
        return fence_box(grid, self._fence_min_m + inset_m, self._fence_max_m - inset_m)

    def _situation(self, request: PlanRequest) -> Situation | str:
        """Where one may fly and how far everything is; or why no plan can start from here."""
        if request.views_left <= 0:
            return "no view is left in the budget"
        voxels = request.voxels
        space = FlyableSpace.of(voxels, self._config.clearance_m, *self._box(voxels.grid, self._inset_m))
        exit_cells = way_out(space, request.position_world)
        if exit_cells is None:
            return "the vehicle stands in space that is not known free, with no known-free way to where it may fly"
        reach, previous = search.distances_from(space.mask, int(exit_cells[-1]), np.zeros(0, dtype=np.int64), np.inf)
        reachable = np.where(np.isfinite(reach), space.mask.ravel(), np.uint8(0)).reshape(space.mask.shape)
        return Situation(voxels, space, exit_cells, request.position_world, reachable, reach, previous)

    def _reconstruct(
        self, mode: PlanMode, situation: Situation, surface: SurfaceElements | None, widening: float
    ) -> list[Proposal]:
        if mode is PlanMode.EXPLORE:
            return []
        return self._surface_views.propose(situation, surface, self.visited.surface_looks, widening)

    def _order(self, request: PlanRequest, routes: Routes, tasks: list[Proposal]) -> list[int]:
        costs = time_costs(routes, tasks, request.yaw_rad, request.velocity_world_mps, self._speed_mps, self._yaw_rate_radps)
        return [int(node) for node in tour.best_tour(costs)][: request.views_left]

    def _path(
        self,
        request: PlanRequest,
        mode: PlanMode,
        routes: Routes,
        tasks: list[Proposal],
        nodes: list[int],
        start_s: float,
        tasks_made_s: float,
    ) -> ViewPath:
        chosen = tuple(tasks[node - 1].task for node in nodes)
        return ViewPath(
            viewpoints=tuple(task.viewpoint for task in chosen),
            waypoints_world=tuple(routes.way_world(i, j) for i, j in zip([0, *nodes[:-1]], nodes, strict=True)),
            mode=mode,
            map_revision=request.voxels.revision,
            map_epoch=request.voxels.map_epoch,
            tasks=chosen,
            task_s=tasks_made_s - start_s,
            step_s=self._timer() - start_s,
        )

    def _nothing(self, reason: str, start_s: float, tasks_made_s: float) -> NothingLeft:
        return NothingLeft(reason, task_s=tasks_made_s - start_s, step_s=self._timer() - start_s)


def _distances_m(situation: Situation, explore: FrontierProposals) -> FloatArray:
    """Path length to each frontier's view, infinite for those left for later, (N,)."""
    cells = np.array([proposal.cell for proposal in explore.proposals], dtype=np.int64)
    near_m = situation.reach[cells] * situation.voxels.grid.resolution_m
    return np.concatenate((near_m, np.full(explore.later, np.inf)))


def nearest(situation: Situation, proposals: list[Proposal], count: int) -> list[Proposal]:
    """The ``count`` proposals with the shortest way, in their old order."""
    if len(proposals) <= count:
        return proposals
    by_distance = np.argsort([situation.reach[proposal.cell] for proposal in proposals], kind="stable")
    return [proposals[n] for n in np.sort(by_distance[:count])]


def within_horizon(order: list[int], lengths_m: FloatArray, horizon_m: float) -> list[int]:
    """The tour's first nodes while the way stays within L_exec; at least one."""
    travelled_m = np.cumsum([lengths_m[i, j] for i, j in zip([0, *order[:-1]], order, strict=True)])
    return order[: max(1, int(np.searchsorted(travelled_m, horizon_m, side="right")))]


def _why(census: FrontierCensus, without_view: Counter[str], state: ByteArray, faces: ByteArray) -> str:
    """'14 frontiers left: 9 too narrow, 5 outside the fence', or that there is none."""
    counts = {
        **dict(sorted(without_view.items())),
        "too small": census.too_small,
        "looked at in vain": census.exhausted,
        "outside the fence": count_outside(state, faces),
    }
    total = sum(counts.values())
    if not total:
        return "no frontiers left"
    return f"{total} frontier{'s' if total > 1 else ''} left: " + ", ".join(f"{n} {why}" for why, n in counts.items() if n)


def warm_up() -> None:
    """Compile every kernel of the planner on a toy map, surface included."""
    traversal.warm_up()
    search.warm_up()
    tour.warm_up()
    visited.warm_up()
    grid = GridSpec(np.zeros(3), 0.1, (40, 30, 20))
    state = np.full(grid.shape, FREE, dtype=np.uint8)
    state[[0, -1]], state[:, [0, -1]], state[:, :, [0, -1]] = OCCUPIED, OCCUPIED, OCCUPIED
    state[28:, :20] = 0
    distance2 = np.where(state == FREE, 25, 0).astype(np.uint8)
    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(0.2, 2.5, 4000), rng.uniform(0.2, 2.8, 4000), np.full(4000, 0.1)], axis=1)
    up = np.tile([0.0, 0.0, 1.0], (4000, 1))
    surface = SurfaceElements(points, up, rng.uniform(0.5, 1.0, 4000), 1)
    camera = CameraGeometry(1.5, 1.0, np.array([0.1, 0.0, 0.0]), -1.0, 1.0, 4.5)
    planner = AdaptivePlanner(PlannerConfig(), np.zeros(3), np.array([4.0, 3.0, 2.0]), camera, 0.8, 0.8, mode=AlwaysMerged())
    for position in ((1.0, 1.0, 1.0), (3.9, 0.05, 1.0)):
        planner.plan(PlanRequest(VoxelMap.whole(grid, state, distance2, 1), surface, np.array(position), 0.0, 10))
