"""Fallbacks of the planner: views that show less, ways home with less clearance."""

from __future__ import annotations

import time
from collections.abc import Callable

from uav_recon.planning.candidate_view import PlanningContext
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.frontier.frontiers import fence_box
from uav_recon.planning.paths.path_cache import PathCache
from uav_recon.planning.route_planning import route_to
from uav_recon.planning.task_generation import view_positions
from uav_recon.planning.view_planner import ViewPlanner
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import VoxelMap
from uav_recon.types.tasks import NothingLeft, PlanMode, PlanRequest, ViewPath, Viewpoint


class FallbackPlanner:
    """The usual planner, and what is left when it finds nothing.

    Implements interfaces.Planner. The vehicle flew through every way home, even if the map has since come nearer to it.
    """

    def __init__(
        self,
        planner: ViewPlanner,
        home_clearances_m: tuple[float, ...],
        fence_inset_m: float,
        timer: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Store the usual planner.

        home_clearances_m: clearances with which a way home is searched, one after the other.
        fence_inset_m, timer: as for ViewPlanner.
        """
        self._planner = planner
        self._home_clearances_m = home_clearances_m
        self._inset_m = fence_inset_m
        self._timer = timer

    def plan(self, request: PlanRequest) -> ViewPath | NothingLeft:
        """Return the usual planner's result, or views that show little if it has none.

        Those are planned only while the vehicle rests.
        """
        answer = self._planner.plan(request)
        if isinstance(answer, ViewPath) or request.velocity_world_mps.any() or request.views_left <= 0:
            return answer
        return self._planner.plan_with_less_demand(request) or answer

    @property
    def fine_places(self) -> tuple[FloatArray, ...]:
        """See interfaces.Planner."""
        return self._planner.fine_places

    def accept(self, path: ViewPath) -> None:
        """See interfaces.Planner."""
        self._planner.accept(path)

    def next_view_has_gain(self, voxels: VoxelMap, position_world: FloatArray, yaw_rad: float) -> bool:
        """See interfaces.Planner."""
        return self._planner.next_view_has_gain(voxels, position_world, yaw_rad)

    def route(self, request: PlanRequest, goal: Viewpoint) -> ViewPath | NothingLeft:
        """Return the usual planner's path, else one with less clearance."""
        start_s = self._timer()
        answer = self._planner.route(request, goal)
        if isinstance(answer, ViewPath):
            return answer
        for clearance_m in self._home_clearances_m:
            found = self._route(request, goal, clearance_m, start_s)
            if found is not None:
                return found
        return answer

    def _route(self, request: PlanRequest, goal: Viewpoint, clearance_m: float, start_s: float) -> ViewPath | None:
        """Return the shortest path with a clearance to a position, or None."""
        space = self._space(request.voxels, clearance_m)
        exit_cells = space.locate_vehicle(request.position_world)
        if exit_cells is None:
            return None
        view = route_to(PlanningContext(request.voxels, space, exit_cells, request.position_world), goal)
        if view is None:
            return None
        path_cache = PathCache(space)
        path_cache.update(exit_cells, request.position_world, view_positions([view]))
        elapsed_s = self._timer() - start_s
        return ViewPath(
            viewpoints=(view.task.viewpoint,),
            waypoints_world=(path_cache.path_world(0, 1),),
            mode=PlanMode.EXPLORE,
            map_revision=request.voxels.revision,
            map_epoch=request.voxels.map_epoch,
            tasks=(view.task,),
            task_s=elapsed_s,
            step_s=elapsed_s,
            clearance_m=clearance_m,
        )

    def _space(self, voxels: VoxelMap, clearance_m: float) -> FlyableSpace:
        """Return the flyable space for a clearance."""
        low_m, high_m = self._planner.fence_m
        box = fence_box(voxels.grid, low_m + self._inset_m, high_m - self._inset_m)
        space = FlyableSpace(voxels.grid, clearance_m, *box, voxels.heights)
        space.update(voxels)
        return space
