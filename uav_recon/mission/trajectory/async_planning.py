"""Planning beside the control loop: a plan and its trajectory, or the reason for none."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from uav_recon.interfaces import Executor, MotionPlannerInterface, Pending, Planner
from uav_recon.mission.trajectory.flight_track import Departure
from uav_recon.mission.trajectory.return_heading import yaw_along_path
from uav_recon.types.frames import FloatArray
from uav_recon.types.reason import Reason
from uav_recon.types.tasks import NothingLeft, PlanMode, PlanRequest, ViewPath, Viewpoint
from uav_recon.types.trajectory import Setpoint, Trajectory


@dataclass(frozen=True)
class PlanResult:
    """A plan and its trajectory.

    motion: the reason if there is no trajectory.
    """

    path: ViewPath | NothingLeft
    motion: Trajectory | Reason


class AsyncPlanner:
    """Runs planner and motion on the executor. Every method starts work and returns at once."""

    def __init__(
        self,
        planner: Planner,
        motion: MotionPlannerInterface,
        retreat: MotionPlannerInterface,
        executor: Executor,
        plan_cost_s: float,
        view_spacing_m: float,
    ) -> None:
        self._planner = planner
        self._motion = motion
        self._retreat = retreat
        self._executor = executor
        self._plan_cost_s = plan_cost_s
        self._view_spacing_m = view_spacing_m
        self._unanswered: list[tuple[float, Pending[PlanResult]]] = []  # waiting since, infinity before the first check

    def waiting_s(self, now_s: float) -> float:
        """Return for how long (s) the oldest request has been running; 0 if none is.

        This includes a result that is no longer needed: later requests wait for it. Call it in each step.
        """
        self._unanswered = [(min(since_s, now_s), each) for since_s, each in self._unanswered if not each.done()]
        return max((now_s - since_s for since_s, _ in self._unanswered), default=0.0)

    def next_views(self, request: PlanRequest, departure: Departure, identifier: int) -> Pending[PlanResult]:
        """Plan the next views, from rest or out of the present motion."""
        return self._submit(lambda: self._onward(self._planner.plan(request), request, departure, identifier))

    def way_home(self, request: PlanRequest, rest: Setpoint, home: Viewpoint, identifier: int) -> Pending[PlanResult]:
        """Plan the shortest clear path to the pad, nose first."""
        return self._submit(lambda: self._homed(self._planner.route(request, home), request, rest, self._motion, identifier))

    def way_back(
        self, request: PlanRequest, rest: Setpoint, crumbs: tuple[FloatArray, ...], home: Viewpoint, identifier: int
    ) -> Pending[PlanResult]:
        """Plan the path back along the breadcrumbs, nose first.

        Positions where the vehicle has been are free, though a map with false obstacles may require more clearance there.
        """
        waypoints = np.array([rest.position_m, *crumbs, home.position_world])
        revision, epoch = request.voxels.revision, request.voxels.map_epoch
        path = ViewPath((home,), (waypoints,), PlanMode.EXPLORE, revision, epoch, (), 0.0, 0.0)
        return self._submit(lambda: self._homed(path, request, rest, self._retreat, identifier))

    def _submit(self, work: Callable[[], PlanResult]) -> Pending[PlanResult]:
        pending = self._executor.submit(work, self._plan_cost_s)
        self._unanswered.append((math.inf, pending))
        return pending

    def _onward(self, path: ViewPath | NothingLeft, request: PlanRequest, departure: Departure, identifier: int) -> PlanResult:
        if departure.flying is None:
            return self._flown(path, request, departure.setpoint, self._view_spacing_m, identifier)
        if isinstance(path, NothingLeft):
            return PlanResult(path, path.reason)
        flying, leave_s = departure.flying, departure.leave_s
        return PlanResult(
            path, self._motion.plan_from_motion(path, request.voxels, flying, leave_s, self._view_spacing_m, identifier)
        )

    def _flown(
        self, path: ViewPath | NothingLeft, request: PlanRequest, rest: Setpoint, spacing_m: float, identifier: int
    ) -> PlanResult:
        """Plan from rest, to the first view alone if a later leg cannot be flown."""
        if isinstance(path, NothingLeft):
            return PlanResult(path, path.reason)
        motion = self._motion.plan_from_rest(path, request.voxels, rest, 0.0, spacing_m, identifier)
        if isinstance(motion, Reason) and len(path.viewpoints) > 1:
            alone = self._motion.plan_from_rest(path.first(), request.voxels, rest, 0.0, spacing_m, identifier)
            if isinstance(alone, Trajectory):
                return PlanResult(path.first(), alone)
        return PlanResult(path, motion)

    def _homed(
        self,
        path: ViewPath | NothingLeft,
        request: PlanRequest,
        rest: Setpoint,
        motion: MotionPlannerInterface,
        identifier: int,
    ) -> PlanResult:
        if isinstance(path, NothingLeft):
            return PlanResult(path, path.reason)
        ahead = yaw_along_path(path, rest.yaw_rad)
        return PlanResult(ahead, motion.plan_from_rest(ahead, request.voxels, rest, 0.0, np.inf, identifier))
