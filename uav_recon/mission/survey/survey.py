"""Survey: chooses views in flight.

A plan is ready before the one before it ends, so that the vehicle does not stop for it.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from uav_recon.interfaces import Pending
from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.setup.mission_channels import MissionChannels
from uav_recon.mission.setup.mission_parameters import MissionParameters
from uav_recon.mission.setup.mission_stages import MissionStages
from uav_recon.mission.trajectory.async_planning import AsyncPlanner, PlanResult
from uav_recon.mission.trajectory.flight_track import Departure
from uav_recon.mission.trajectory.trajectory_execution import TrajectoryExecutor
from uav_recon.types.maps import SurfaceElements, VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import NextView, NothingLeft, PlanRequest
from uav_recon.types.trajectory import Setpoint, Trajectory
from uav_recon.types.vehicle import VehicleState

HOLD_AGAIN_S = 0.2  #: plan: interval of holds where the pilot has gone back to
RETHINK_S = 0.5  #: plan: pause after a plan that could not be flown, and at least between two in motion
MAX_FAILED_PLANS = 5  #: return: after this many plans in a row that could not be flown
SAME_PLACE_M = 0.05  #: plan: a motion that ends nearer to the present one's end is not worth leaving it
AHEAD_S = 1.6  #: plan: a plan leaves its predecessor this long before that one's end, so that it does not brake in between
STOPPED_AGAIN_S = 5.0  #: plan: two stops within this time: the space ahead was not seen lately, so the vehicle looks round
LOOK_AFTER_STOPS = 3  #: plan: stops by space not seen lately within LOOK_WITHIN_S after which the vehicle looks round
LOOK_WITHIN_S = 15.0  #: plan: see LOOK_AFTER_STOPS
TURN_FIRST_RAD = 0.6  #: plan: after such a stop, the nose turns before a motion that begins farther than this beside it ...
TURN_FIRST_M = 0.25  #: plan: ... on its first part, level
#: return: the place became uncertain this many times without a view in between; flights that were completed had up to 2
MOST_UNSURE_STOPS = 4
LEAD_S = 0.25  #: plan: from a plan's start to the instant at which it leaves the present motion, added to its declared cost

# the guard's reasons for which another view is chosen
NOT_SEEN = frozenset({ReasonCode.NOT_SEEN_RECENTLY.value, ReasonCode.SPEED_OUT_OF_VIEW.value})
NOTHING_LEARNED = SurfaceElements(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), 0)


class Survey:
    """One look round, then views while the planner finds any."""

    def __init__(
        self,
        stages: MissionStages,
        channels: MissionChannels,
        parameters: MissionParameters,
        executor: TrajectoryExecutor,
        planner: AsyncPlanner,
        log: MissionLog,
    ) -> None:
        self._stages = stages
        self._channels = channels
        self._parameters = parameters
        self._executor = executor
        self._planner = planner
        self._log = log
        self._lead_s = LEAD_S + parameters.plan_cost_s
        self._pending_plan: Pending[PlanResult] | None = None
        self._departure = Departure(Setpoint.hold(np.zeros(3), 0.0))
        self._looked_round = self._settled = self._look_again = False
        self._next_view = NextView.KEPT
        self._stopped_s = self._held_s = -np.inf
        self._unseen_s: deque[float] = deque([-np.inf] * LOOK_AFTER_STOPS, LOOK_AFTER_STOPS)  # the last stops by unseen space
        self._unsure_stops = self._unsure_with = 0  # the same by an uncertain place
        self._asked_revision = -1
        self._turns_first = False  # the last motion was stopped by space not seen lately
        self.interrupt()

    def interrupt(self) -> None:
        """Drop the pending request, because the phase has changed."""
        self._pending_plan = None
        self._resting_since_s = np.inf
        self._replan_s = -np.inf

    def begin_again(self) -> None:
        """Look round again before choosing views, because the map is new."""
        self.interrupt()
        self._looked_round = False
        self._asked_revision = -1

    def stopped(self, now_s: float, reason: Reason) -> None:
        """Record that the guard has stopped the vehicle, or that the pilot goes back.

        The pilot goes back where the place is uncertain. If it is, or if space was not seen lately, the next plan chooses
        another view. Looking round would not help: it leads past the same bare wall, and a camera that looks ahead does not
        see where a climb leads. Only if it is stopped by space not seen again and again, the vehicle looks round. If the place
        becomes uncertain again and again, the room does not show it, and the survey ends.
        """
        codes, again = set(reason.codes()), False
        if ReasonCode.PLACE_UNSURE in codes:
            self._next_view = NextView.LEFT
            self._unsure_stops = self._unsure_stops + 1 if self._log.views_left == self._unsure_with else 1
            self._unsure_with = self._log.views_left
            if self._unsure_stops >= MOST_UNSURE_STOPS:
                self._log.stop_reason = Reason(ReasonCode.PLACE_UNSURE_OFTEN, (self._unsure_stops,), (reason,))
        elif NOT_SEEN & codes:
            self._next_view = NextView.REFUSED
            self._turns_first = True
            self._unseen_s.append(now_s)
            again = now_s - self._unseen_s[0] < LOOK_WITHIN_S
            if again:
                self._unseen_s.extend([-np.inf] * LOOK_AFTER_STOPS)
        else:
            again = now_s - self._stopped_s < STOPPED_AGAIN_S
            self._stopped_s = -np.inf if again else now_s
        self._look_again = self._look_again or again
        self._pending_plan = None

    def step(self, now_s: float, vehicle: VehicleState, voxels: VoxelMap) -> None:
        """Check the path, plan in time, and fly the result."""
        resting = self._executor.at_rest(now_s)
        if resting:
            self._resting_since_s = min(self._resting_since_s, now_s)
        else:
            self._executor.brake_if_blocked(now_s, voxels)
        if _goes_back(vehicle):
            self._pending_plan = None  # it would begin where the vehicle is no more, as an older hold does
            self._hold_again(now_s, vehicle)
        elif self._pending_plan is not None:
            self._fly_plan(now_s, vehicle)
        elif resting and not self._looked_round:
            self._look_round(now_s, vehicle, self._parameters.survey_views)
        elif self._look_again:
            if resting:
                self._look_round(now_s, vehicle, 0)
        elif now_s >= self._replan_s and (resting or self._should_replan_in_motion(now_s, voxels)):
            self._request_plan(now_s, vehicle, voxels)

    def _hold_again(self, now_s: float, vehicle: VehicleState) -> None:
        if now_s - self._held_s >= HOLD_AGAIN_S:
            self._held_s = now_s
            self._executor.hold(now_s, vehicle)

    def _look_round(self, now_s: float, vehicle: VehicleState, views: int) -> None:
        self._looked_round = True
        self._look_again = False
        self._replan_s = now_s + self._executor.look_round(now_s, vehicle, views)  # when all of it is seen
        self._resting_since_s = np.inf

    def _should_replan_in_motion(self, now_s: float, voxels: VoxelMap) -> bool:
        """Return True if, in motion, the path ends soon or its next view was seen in passing."""
        track = self._executor.track
        if not self._looked_round or track.trajectory is None:
            return False
        if track.remaining_s(now_s) <= self._lead_s:
            return False  # too late for that: the plan is made at rest
        self._settled = False
        if track.remaining_s(now_s) <= AHEAD_S + self._lead_s:
            return True
        if voxels.revision == self._asked_revision:
            return False
        self._asked_revision = voxels.revision
        here = track.trajectory.setpoint_at(now_s)
        self._settled = not self._stages.planner.next_view_has_gain(voxels, here.position_m, here.yaw_rad)
        return self._settled

    def _request_plan(self, now_s: float, vehicle: VehicleState, voxels: VoxelMap) -> None:
        departure = self._executor.track.departure(now_s + self._lead_s, vehicle)
        start, surface = departure.setpoint, self._surface()
        request = PlanRequest(
            voxels, surface, start.position_m, start.yaw_rad, self._log.views_left, start.velocity_mps, self._next_view,
            None if self._stages.localizability is None else self._stages.localizability.cells, tuple(self._log.keyframes),
        )  # fmt: skip
        self._next_view = NextView.KEPT
        self._departure = departure
        self._pending_plan = self._planner.next_views(request, departure, self._executor.track.next_identifier())

    def _surface(self) -> SurfaceElements | None:
        """Return the newest surface; an empty one if the mapper died before it gave one.

        The map still shows which surface no view has seen.
        """
        mapper = self._stages.mapper
        surface = mapper.surface()
        return NOTHING_LEARNED if surface is None and not mapper.alive() else surface

    def _fly_plan(self, now_s: float, vehicle: VehicleState) -> None:
        if self._pending_plan is None or not self._pending_plan.done():
            return
        plan = self._pending_plan.result()
        self._pending_plan = None
        self._stages.voxels.refine(self._stages.planner.fine_places)
        flying, leave_s = self._departure.flying, self._departure.leave_s
        if flying is not None:
            if flying is not self._executor.track.trajectory or now_s > leave_s:
                self._log.discarded_plan(now_s, plan.path)
                return  # braked meanwhile, or too late to leave there: plan again
            if isinstance(plan.motion, Reason) or self._ends_as_before(plan.motion, flying):
                self._replan_s = now_s + self._executor.track.remaining_s(now_s)  # plan again at rest
                self._log.discarded_plan(now_s, plan.path)
                return
            self._replan_s = now_s + RETHINK_S
        rests = not self._departure.setpoint.velocity_mps.any()
        if self._turns_first and rests and isinstance(plan.motion, Trajectory):
            self._turns_first = False
            turn_rad = _turn_before(plan.motion)
            if abs(turn_rad) > TURN_FIRST_RAD:
                self._log.discarded_plan(now_s, plan.path)
                self._replan_s = now_s + self._executor.turn(now_s, vehicle, turn_rad, 0)
                return  # plan again with what it sees then
        self._log.plan(now_s, plan.path, 0.0 if flying is not None else now_s - self._resting_since_s)
        if isinstance(plan.path, NothingLeft):
            return
        self._channels.plan.publish(plan.path)
        self._stages.planner.accept(plan.path)
        if isinstance(plan.motion, Reason):
            self._give_up_plan(plan.motion, now_s)
            return
        self._log.failed_in_a_row = 0
        self._turns_first = False
        self._resting_since_s = np.inf
        if flying is None:
            self._executor.fly(plan.motion, now_s)
        else:
            self._executor.follow(plan.motion, leave_s)

    def _ends_as_before(self, trajectory: Trajectory, flying: Trajectory) -> bool:
        """Return True if a trajectory leads only to where the present one leads.

        Then there is no reason to leave the present one.
        """
        if len(trajectory.views_s) > 1 or self._settled:
            return False
        return float(np.linalg.norm(trajectory.position_m[-1] - flying.position_m[-1])) < SAME_PLACE_M

    def _give_up_plan(self, reason: Reason, now_s: float) -> None:
        self._log.failed_in_a_row += 1
        self._next_view = NextView.REFUSED  # else the next plan would be the same
        self._log.refusal(now_s, Reason(ReasonCode.PLAN_NOT_FLYABLE, details=(reason,)))
        self._replan_s = now_s + RETHINK_S
        if self._log.failed_in_a_row >= MAX_FAILED_PLANS:
            self._log.stop_reason = Reason(ReasonCode.PLANS_FAILED, (MAX_FAILED_PLANS,), (reason,))


def _turn_before(motion: Trajectory) -> float:
    """Return the turn of the nose (rad) to where a motion leads first, 0 for a climb or a turn."""
    step_m = motion.position_m[:, :2] - motion.position_m[0, :2]
    away = np.flatnonzero(np.hypot(step_m[:, 0], step_m[:, 1]) >= TURN_FIRST_M)
    if not len(away):
        return 0.0
    x, y = step_m[away[0]]
    return math.remainder(math.atan2(y, x) - float(motion.yaw_rad[0]), math.tau)


def _goes_back(vehicle: VehicleState) -> bool:
    """Return True while the pilot goes back to where the place is known."""
    return vehicle.slow_reason is not None and ReasonCode.PLACE_UNSURE in vehicle.slow_reason.codes()
