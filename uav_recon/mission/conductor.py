"""React: one step of the mission, top to bottom. The only place where the stages meet."""

from __future__ import annotations

import dataclasses

import numpy as np

from uav_recon.mission.account import Account
from uav_recon.mission.captures import Captures
from uav_recon.mission.course import Course
from uav_recon.mission.decider import Decider, Decision
from uav_recon.mission.events import Facts, observe
from uav_recon.mission.machine import Phase, advance
from uav_recon.mission.orders import MissionWires, Orders, Stages
from uav_recon.protocols import Clock, Executor, Journal, Pending
from uav_recon.types.camera import PosedFrame
from uav_recon.types.maps import VoxelMap
from uav_recon.types.tasks import NothingLeft, PlanRequest, Viewpoint
from uav_recon.types.trajectory import Goal, Intent, Setpoint, Trajectory
from uav_recon.types.vehicle import FlightPhase, VehicleState

FRAME_TIMEOUT_S = 1.0
VIEW_LATE_S = 0.6  # a view that no frame met for so long is given up
RETHINK_S = 0.5  # pause after a plan that could not be flown
MAX_FAILED_PLANS = 5
PROGRESS_PERIOD_S, MAP_PERIOD_S = 0.2, 1.0


class Conductor:
    """Flies one mission. step() is called at 20 Hz or more and never waits for planning or mapping."""

    def __init__(
        self, stages: Stages, wires: MissionWires, orders: Orders, executor: Executor, journal: Journal, clock: Clock
    ) -> None:
        self._stages, self._wires, self._orders, self._clock = stages, wires, orders, clock
        self._decider = Decider(stages.planner, stages.motion, executor, orders.plan_cost_s, orders.view_spacing_m)
        self._course, self._captures = Course(orders.camera_pitch_down_rad), Captures(VIEW_LATE_S)
        self._account = Account(journal, orders.views)
        self.phase = Phase.IDLE
        self.map: VoxelMap | None = None
        self._decision: Pending[Decision] | None = None
        self._frame_sequence, self._frame_s = 0, -np.inf
        self._surface_revision, self._refusals = -1, 0
        self._took_off_s = self._resting_since_s = np.inf
        self._think_again_s = self._reported_s = self._map_published_s = -np.inf
        self._start = self._abort = self._looked_round = self._homing = self._no_way_home = False
        half_m = orders.vehicle_height_m / 2
        stages.voxels.declare_free(np.zeros(3), orders.takeoff_radius_m, -half_m, orders.takeoff_height_m + half_m)

    @property
    def finished(self) -> bool:
        """Nothing more will be done."""
        return self.phase in (Phase.DONE, Phase.YIELDED)

    def request_start(self) -> None:
        """The operator's go, or autostart's."""
        self._start = True

    def request_abort(self, reason: str) -> None:
        """Land now; never taken back."""
        self._abort, self._account.aborted = True, self._account.aborted or reason

    def step(self) -> None:
        """Frame to map, map to events, events to phase, phase to motion, motion to the pilot."""
        now_s = self._clock.now_s()
        vehicle = self._wires.vehicle.latest()
        self._map_newest_frame(now_s)
        if vehicle is not None:
            self._course.follow(vehicle)
            self._hear_guard(now_s, vehicle)
            self._change_phase(advance(self.phase, observe(self._facts(now_s, vehicle))), now_s)
            self._act(now_s, vehicle)
        self._publish(now_s)

    # -- detect -------------------------------------------------------------------------------------------------------

    def _map_newest_frame(self, now_s: float) -> None:
        sequence = self._wires.frames.sequence()
        posed = self._wires.frames.latest() if sequence != self._frame_sequence else None
        if posed is None:
            return
        self._frame_sequence, self._frame_s = sequence, now_s
        self._stages.voxels.integrate(posed)
        self.map = self._stages.voxels.snapshot()
        promised = self._captures.take(posed.frame.stamp_s)
        if self._account.views_left > 0 and (promised or self._worth_a_view(posed)) and self._stages.mapper.add(posed):
            self._stages.budget.keep(posed)
            self._account.view(posed)

    def _worth_a_view(self, posed: PosedFrame) -> bool:
        """Whether a frame on the way shows enough that is new; the look round and the tasks' views are promised anyway."""
        return self.phase is Phase.SURVEY and self._stages.budget.worth(posed, self._account.views_left)

    def _hear_guard(self, now_s: float, vehicle: VehicleState) -> None:
        """A refused trajectory is not flown on: the vehicle hovers where the guard stopped it, and the plan is made anew."""
        if vehicle.refusals > self._refusals and self._course.trajectory is not None:
            self._account.refusal(now_s, vehicle.note)
            here, identifier = self._course.place(vehicle), self._course.next_identifier()
            self._fly(self._stages.motion.line(here, here.position_m, here.yaw_rad, now_s, identifier), now_s)
        self._refusals = vehicle.refusals

    def _facts(self, now_s: float, vehicle: VehicleState) -> Facts:
        return Facts(
            vehicle=vehicle,
            start=self._start and self.map is not None,
            abort=self._abort,
            at_rest=self._at_rest(now_s),
            took_off=self._course.trajectory is not None,
            frame_age_s=now_s - self._frame_s,
            frame_timeout_s=FRAME_TIMEOUT_S,
            nothing_left=bool(self._account.stop_reason),
            views_left=self._account.views_left,
            flight_s=now_s - self._took_off_s,
            max_flight_s=self._orders.max_flight_s,
            homing=self._homing,
            no_way_home=self._no_way_home,
        )

    def _at_rest(self, now_s: float) -> bool:
        return self._course.at_rest(now_s) and not self._captures.waiting(now_s)

    def _change_phase(self, phase: Phase, now_s: float) -> None:
        if phase is self.phase:
            return
        self._account.phase(now_s, phase)
        if phase is Phase.RETURN:
            self._account.stop_reason = self._account.stop_reason or self._why_return(now_s)
        if phase in (Phase.HOLD, Phase.RETURN, Phase.RETREAT):
            self._brake(now_s)
        self.phase, self._decision, self._resting_since_s, self._think_again_s = phase, None, np.inf, -np.inf

    def _why_return(self, now_s: float) -> str:
        left = f"{self._account.frontiers} frontiers left in the last plan"
        if self._account.views_left <= 0:
            return f"view budget of {self._orders.views} spent, {left}"
        if now_s - self._took_off_s > self._orders.max_flight_s:
            return f"flight time of {self._orders.max_flight_s:.0f} s spent, {left}"
        return f"battery low, {left}"

    # -- act ----------------------------------------------------------------------------------------------------------

    def _act(self, now_s: float, vehicle: VehicleState) -> None:
        if self.phase is Phase.TAKEOFF:
            self._take_off(now_s, vehicle)
        elif self.phase is Phase.SURVEY:
            self._survey(now_s, vehicle)
        elif self.phase in (Phase.RETURN, Phase.RETREAT):
            self._go_home(now_s, vehicle)

    def _take_off(self, now_s: float, vehicle: VehicleState) -> None:
        if self._course.trajectory is not None or vehicle.phase is not FlightPhase.FLYING:
            return
        start = self._course.rest(vehicle)
        goal = np.array([*start.position_m[:2], self._orders.takeoff_height_m])
        self._took_off_s = now_s
        self._fly(self._stages.motion.line(start, goal, start.yaw_rad, now_s, self._course.next_identifier()), now_s)

    def _survey(self, now_s: float, vehicle: VehicleState) -> None:
        if not self._course.at_rest(now_s):
            self._brake_if_blocked(now_s)
        elif not self._captures.waiting(now_s):
            self._resting_since_s = min(self._resting_since_s, now_s)
            if self._looked_round:
                self._choose_views(now_s, vehicle)
            else:
                self._look_round(now_s, vehicle)

    def _look_round(self, now_s: float, vehicle: VehicleState) -> None:
        self._looked_round = True
        start, identifier = self._course.rest(vehicle), self._course.next_identifier()
        self._fly(self._stages.motion.turn(start, now_s, 2 * np.pi, self._orders.survey_views, identifier), now_s)

    def _choose_views(self, now_s: float, vehicle: VehicleState) -> None:
        if self._decision is None and self.map is not None and now_s >= self._think_again_s:
            rest = self._course.rest(vehicle)
            self._decision = self._decider.next_views(self._request(rest, self.map), rest, self._course.next_identifier())
        if self._decision is None or not self._decision.done():
            return
        decision, self._decision = self._decision.result(), None
        self._account.plan(now_s, decision.path, now_s - self._resting_since_s)
        if isinstance(decision.path, NothingLeft):
            return
        self._wires.plan.publish(decision.path)
        if isinstance(decision.motion, str):
            self._give_up_plan(decision.motion, now_s)
            return
        self._account.failed_in_a_row = 0
        self._fly(decision.motion, now_s)

    def _give_up_plan(self, reason: str, now_s: float) -> None:
        self._account.failed_in_a_row += 1
        self._account.refusal(now_s, f"plan not flyable: {reason}")
        self._think_again_s = now_s + RETHINK_S
        if self._account.failed_in_a_row >= MAX_FAILED_PLANS:
            self._account.stop_reason = f"{MAX_FAILED_PLANS} plans in a row could not be flown: {reason}"

    def _go_home(self, now_s: float, vehicle: VehicleState) -> None:
        if self._homing or not self._course.at_rest(now_s) or self.map is None:
            return
        rest = self._course.rest(vehicle)
        home = Viewpoint(np.array([0.0, 0.0, self._orders.takeoff_height_m]), rest.yaw_rad, rest.camera_pitch_down_rad)
        request, identifier = self._request(rest, self.map), self._course.next_identifier()
        if self._decision is None and self.phase is Phase.RETURN:
            self._decision = self._decider.way_home(request, rest, home, identifier)
        elif self._decision is None:
            self._decision = self._decider.way_back(request, rest, self._course.way_back(), home, identifier)
        if not self._decision.done():
            return
        decision, self._decision = self._decision.result(), None
        if isinstance(decision.motion, Trajectory):
            self._homing = True
            self._fly(dataclasses.replace(decision.motion, views_s=np.zeros(0)), now_s)  # home is no view
            return
        self._account.refusal(now_s, decision.motion)
        if self.phase is Phase.RETURN:
            self._no_way_home = True
        else:
            self.request_abort(f"no way back: {decision.motion}")

    def _request(self, rest: Setpoint, voxels: VoxelMap) -> PlanRequest:
        return PlanRequest(voxels, self._stages.mapper.surface(), rest.position_m, rest.yaw_rad, self._account.views_left)

    def _fly(self, trajectory: Trajectory, now_s: float) -> None:
        self._course.trajectory = dataclasses.replace(trajectory, start_s=now_s)  # made a moment ago, flown from now
        self._captures.expect(self._course.trajectory)
        self._resting_since_s = np.inf

    def _brake_if_blocked(self, now_s: float) -> None:
        trajectory = self._course.trajectory
        if trajectory and self.map and not self._stages.motion.still_clear(trajectory, now_s, self.map):
            self._account.refusal(now_s, "the map shows an obstacle on the way")
            self._brake(now_s)

    def _brake(self, now_s: float) -> None:
        trajectory = self._course.trajectory
        if trajectory is not None and not self._course.at_rest(now_s):
            self._course.trajectory = self._stages.motion.stop(trajectory, now_s, self._course.next_identifier())
            self._captures.cancel_after(now_s)

    # -- tell ---------------------------------------------------------------------------------------------------------

    def _publish(self, now_s: float) -> None:
        grounded = self.phase in (Phase.IDLE, Phase.READY, Phase.DONE, Phase.YIELDED)
        goal = Goal.STANDBY if grounded else Goal.LAND if self.phase is Phase.LANDING else Goal.FLY
        self._wires.intent.publish(Intent(now_s, goal, self._course.trajectory))
        surface = self._stages.mapper.surface()
        if surface is not None and surface.revision != self._surface_revision:
            self._surface_revision = surface.revision
            self._wires.surface.publish(surface)
        if self.map is not None and (now_s - self._map_published_s >= MAP_PERIOD_S or self.finished):
            self._map_published_s = now_s
            self._wires.voxels.publish(self.map)
        if now_s - self._reported_s >= PROGRESS_PERIOD_S or self.finished:
            self._reported_s = now_s
            explored_m3, course = self._stages.voxels.explored_m3(), self._course
            progress = self._account.progress(
                now_s, self.phase, explored_m3, course.path_length_m, course.position_world, self.finished
            )
            self._wires.progress.publish(progress)

    def close(self) -> str:
        """Write the last line of the journal; returns the outcome."""
        home = self.phase is Phase.DONE and self._homing and not self._abort
        why = self._account.aborted or self._account.note or self.phase.value
        outcome = "completed" if home else f"aborted: {why}"
        self._account.close(self._clock.now_s(), outcome)
        return outcome
