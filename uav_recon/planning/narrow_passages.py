"""Paths with reduced clearance, used only for an opening or home that no other path reaches."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from uav_recon.planning.candidate_view import CandidateView, PlanningContext
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.frontier.cluster_table import OPENING
from uav_recon.planning.frontier.frontier_views import FrontierViews
from uav_recon.planning.frontier.frontiers import fence_box
from uav_recon.planning.paths.path_cache import PathCache
from uav_recon.planning.route_planning import route_to
from uav_recon.planning.task_generation import view_positions
from uav_recon.planning.view_planner import ViewPlanner
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import NothingLeft, PlanMode, PlanRequest, ViewPath, Viewpoint

ON_A_NARROW_WAY = Reason(ReasonCode.IN_NARROW_PASSAGE)


class NarrowPassagePlanner:
    """Plans paths with reduced clearance when the usual planner finds none.

    Implements interfaces.Planner.

    Only the paths are narrow. The views have the usual clearance, so the vehicle comes to rest where the usual planner can
    plan again. A narrow path is planned at rest, for one opening at a time; a gap in front of a wall does not justify it.
    There is no cost before that: the flyable space with reduced clearance is computed for each request.
    """

    def __init__(
        self,
        planner: ViewPlanner,
        clearance_m: float,
        home_clearance_m: float,
        fence_inset_m: float,
        timer: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Store the usual planner and the reduced clearances.

        clearance_m: clearance of a narrow path, less than that of ``planner``.
        home_clearance_m: minimum clearance on the path home. An occupied voxel near the passage that the vehicle flew through
            may since have reduced the clearance there.
        fence_inset_m, timer: as for ViewPlanner.
        """
        self._planner = planner
        self._clearance_m = clearance_m
        self._homeward_m = home_clearance_m
        self._inset_m = fence_inset_m
        self._timer = timer
        self._newest_path: tuple[ViewPath, CandidateView] | None = None
        self._in_passage = False

    def plan(self, request: PlanRequest) -> ViewPath | NothingLeft:
        """Return the usual planner's result, or a narrow path to the nearest opening if it has none.

        If there is none either, views that show little are planned. Both only while the vehicle rests.
        """
        start_s, moving = self._timer(), bool(request.velocity_world_mps.any())
        if moving and self._in_passage:
            return NothingLeft(ON_A_NARROW_WAY, 0.0, 0.0)
        answer = self._planner.plan(request)
        if isinstance(answer, ViewPath) or moving or request.views_left <= 0:
            return answer
        found = self._nearest(request, self._openings, self._clearance_m, start_s) if self._planner.explores else None
        if found is None:
            return self._planner.plan_with_less_demand(request) or answer
        self._newest_path = found
        return found[0]

    def accept(self, path: ViewPath) -> None:
        """See interfaces.Planner."""
        self._in_passage = self._newest_path is not None and self._newest_path[0] is path
        if self._newest_path is not None and self._in_passage:
            self._planner.view_history.set_expected_views(path, (self._newest_path[1],))
        else:
            self._planner.accept(path)

    def next_view_has_gain(self, voxels: VoxelMap, position_world: FloatArray, yaw_rad: float) -> bool:
        """See interfaces.Planner."""
        return self._planner.next_view_has_gain(voxels, position_world, yaw_rad)

    def route(self, request: PlanRequest, goal: Viewpoint) -> ViewPath | NothingLeft:
        """Return the usual planner's path, else a narrow one, else one with ``home_clearance_m``."""
        start_s = self._timer()
        answer = self._planner.route(request, goal)
        if isinstance(answer, ViewPath):
            return answer
        for clearance_m in (self._clearance_m, self._homeward_m):
            found = self._nearest(request, lambda context: [route_to(context, goal)], clearance_m, start_s)
            if found is not None:
                return found[0]
        return answer

    def _nearest(
        self,
        request: PlanRequest,
        wanted: Callable[[PlanningContext], Sequence[CandidateView | None]],
        clearance_m: float,
        start_s: float,
    ) -> tuple[ViewPath, CandidateView] | None:
        """Return the shortest path with a clearance to a wanted view, and that view, or None."""
        space = self._space(request.voxels, clearance_m)
        exit_cells = space.locate_vehicle(request.position_world)
        if exit_cells is None:
            return None
        proposals = [one for one in wanted(PlanningContext(request.voxels, space, exit_cells, request.position_world)) if one]
        tasks_made_s = self._timer()
        if not proposals:
            return None
        path_cache = PathCache(space)
        path_cache.update(exit_cells, request.position_world, view_positions(proposals))
        nearest = int(np.argmin(path_cache.lengths_m[0, 1:]))
        path = ViewPath(
            viewpoints=(proposals[nearest].task.viewpoint,),
            waypoints_world=(path_cache.path_world(0, nearest + 1),),
            mode=PlanMode.EXPLORE,
            map_revision=request.voxels.revision,
            map_epoch=request.voxels.map_epoch,
            tasks=(proposals[nearest].task,),
            task_s=tasks_made_s - start_s,
            step_s=self._timer() - start_s,
            clearance_m=clearance_m,
            frontiers=len(proposals),
        )
        return path, proposals[nearest]

    def _space(self, voxels: VoxelMap, clearance_m: float) -> FlyableSpace:
        """Return the flyable space for a clearance."""
        low_m, high_m = self._planner.fence_m
        box = fence_box(voxels.grid, low_m + self._inset_m, high_m - self._inset_m)
        space = FlyableSpace(voxels.grid, clearance_m, *box)
        space.update(voxels)
        return space

    def _openings(self, context: PlanningContext) -> list[CandidateView]:
        """Return views of the nearest openings from positions behind a narrow passage.

        The positions have the usual clearance.
        """
        usual, frontiers, voxels = self._planner.space, self._planner.frontiers, context.voxels
        beyond = _Beyond(
            mask=usual.mask,
            reachable=usual.mask & context.space.reachable & (1 - usual.reachable),
            clearance_box=usual.clearance_box,
            revision=1,
            reachable_revision=np.ones_like(usual.reachable_revision),
        )
        views = FrontierViews(self._planner.config, self._planner.camera)
        found = views.update(voxels, beyond, frontiers, context.position_world).proposals
        gains = frontiers.unknown_beyond(voxels, [one.expected_voxels for one in found])
        return [one.with_gain(gain) for one, gain in zip(found, gains.tolist(), strict=True) if gain >= OPENING]


@dataclass(frozen=True, slots=True, eq=False)
class _Beyond:
    """Positions with the usual clearance behind a narrow passage; see frontier_views.Flyable."""

    mask: ByteArray
    reachable: ByteArray
    clearance_box: FloatArray
    revision: int
    reachable_revision: IntArray
