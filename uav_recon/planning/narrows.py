"""Through narrow ways: with less room than usual, and only to an opening, or home, that no other way leads to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.planning.frontier.cluster_table import OPENING
from uav_recon.planning.frontier.frontiers import fence_box
from uav_recon.planning.frontier.views import FrontierViews
from uav_recon.planning.homing import proposal_for
from uav_recon.planning.planner import ViewPlanner
from uav_recon.planning.proposal import Proposal, Situation
from uav_recon.planning.sources import places_of
from uav_recon.planning.space.space import FlyableSpace
from uav_recon.planning.space.ways import Ways
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import VoxelMap
from uav_recon.types.tasks import NothingLeft, PlanMode, PlanRequest, ViewPath, Viewpoint

ON_A_NARROW_WAY = "on a narrow way nothing else is begun"


class ThroughNarrows:
    """A planner that asks again with less room once another has nothing left; see protocols.Planner.

    Only its ways are narrow: views have the usual room, so the vehicle rests where the other planner goes on. It is asked at
    rest, proposes one opening at a time (a gap in front of a wall is not worth the squeeze), and costs nothing before: what it
    needs of the map is looked up for each question.
    """

    def __init__(self, planner: ViewPlanner, clearance_m: float, fence_inset_m: float) -> None:
        """clearance_m: of a narrow way, less than ``planner``'s; fence_inset_m: as there."""
        self._planner, self._clearance_m, self._inset_m = planner, clearance_m, fence_inset_m
        self._offered: tuple[ViewPath, Proposal] | None = None
        self._squeezing = False

    def plan(self, request: PlanRequest) -> ViewPath | NothingLeft:
        """The other planner's answer, or where it has nothing and the vehicle rests, a narrow way to the nearest opening."""
        moving = bool(request.velocity_world_mps.any())
        if moving and self._squeezing:
            return NothingLeft(ON_A_NARROW_WAY, 0.0, 0.0)
        answer = self._planner.plan(request)
        if isinstance(answer, ViewPath) or moving or request.views_left <= 0 or not self._planner.explores:
            return answer
        space = self._space(request.voxels)
        exit_cells = space.stand(request.position_world)
        openings = [] if exit_cells is None else self._openings(request, space)
        if exit_cells is None or not openings:
            return answer
        ways = Ways(space)
        ways.update(exit_cells, request.position_world, places_of(openings))
        nearest = int(np.argmin(ways.lengths_m[0, 1:]))
        path = self._path(request, openings[nearest], ways.way_world(0, nearest + 1), answer)
        self._offered = path, openings[nearest]
        return path

    def accept(self, path: ViewPath) -> None:
        """See protocols.Planner."""
        self._squeezing = self._offered is not None and self._offered[0] is path
        if self._offered is not None and self._squeezing:
            self._planner.visited.promise(path, (self._offered[1],))
        else:
            self._planner.accept(path)

    def still_worth(self, voxels: VoxelMap, position_world: FloatArray, yaw_rad: float) -> bool:
        """See protocols.Planner."""
        return self._planner.still_worth(voxels, position_world, yaw_rad)

    def route(self, request: PlanRequest, goal: Viewpoint) -> ViewPath | NothingLeft:
        """The other planner's way, or where it knows none, a narrow one."""
        answer = self._planner.route(request, goal)
        if isinstance(answer, ViewPath):
            return answer
        space = self._space(request.voxels)
        exit_cells = space.stand(request.position_world)
        if exit_cells is None:
            return answer
        proposal = proposal_for(Situation(request.voxels, space, exit_cells, request.position_world), goal)
        if proposal is None:
            return answer
        ways = Ways(space)
        ways.update(exit_cells, request.position_world, places_of([proposal]))
        return self._path(request, proposal, ways.way_world(0, 1), answer)

    def _space(self, voxels: VoxelMap) -> FlyableSpace:
        """Where there is room enough for a narrow way."""
        low_m, high_m = self._planner.fence_m
        box = fence_box(voxels.grid, low_m + self._inset_m, high_m - self._inset_m)
        space = FlyableSpace(voxels.grid, self._clearance_m, *box)
        space.update(voxels)
        return space

    def _openings(self, request: PlanRequest, narrow: FlyableSpace) -> list[Proposal]:
        """The nearest openings that can be viewed with the usual room from beyond a narrow way."""
        usual, frontiers = self._planner.space, self._planner.frontiers
        beyond = _Beyond(
            mask=usual.mask,
            reachable=usual.mask & narrow.reachable & (1 - usual.reachable),
            berth=usual.berth,
            revision=1,
            reachable_revision=np.ones_like(usual.reachable_revision),
        )
        views = FrontierViews(self._planner.config, self._planner.camera)
        found = views.update(request.voxels, beyond, frontiers, request.position_world).proposals
        gains = frontiers.beyond(request.voxels, [one.promised for one in found])
        return [one.gaining(gain) for one, gain in zip(found, gains.tolist(), strict=True) if gain >= OPENING]

    def _path(self, request: PlanRequest, proposal: Proposal, way: FloatArray, before: NothingLeft) -> ViewPath:
        return ViewPath(
            viewpoints=(proposal.task.viewpoint,),
            waypoints_world=(way,),
            mode=PlanMode.EXPLORE,
            map_revision=request.voxels.revision,
            map_epoch=request.voxels.map_epoch,
            tasks=(proposal.task,),
            task_s=before.task_s,
            step_s=before.step_s,
            clearance_m=self._clearance_m,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Beyond:
    """Places with the usual room that a narrow way leads to; see views.Flyable."""

    mask: ByteArray
    reachable: ByteArray
    berth: FloatArray
    revision: int
    reachable_revision: IntArray
