"""React: one step of the mission, top to bottom. The only place where the stages meet."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from uav_recon.mission.captures import Captures
from uav_recon.mission.course import Course
from uav_recon.mission.events import Facts, observe
from uav_recon.mission.machine import Phase, advance
from uav_recon.protocols import Channel, Clock, Executor, Journal, Mapper, Motion, Pending, Planner, Voxels
from uav_recon.types.camera import PosedFrame
from uav_recon.types.maps import SurfaceElements, VoxelMap
from uav_recon.types.tasks import NothingLeft, PlanMode, PlanRequest, ViewPath, Viewpoint
from uav_recon.types.trajectory import Goal, Intent, Trajectory
from uav_recon.types.vehicle import FlightPhase, MissionProgress, VehicleState

FRAME_TIMEOUT_S = 1.0
VIEW_LATE_S = 0.6  # a view that no frame met for so long is given up
RETHINK_S = 0.5  # pause after a plan that could not be flown
MAX_FAILED_PLANS = 5
MAP_PERIOD_S = 1.0


@dataclass(frozen=True)
class Stages:
    """The stages, through their protocols."""

    voxels: Voxels
    mapper: Mapper
    planner: Planner
    motion: Motion


@dataclass(frozen=True)
class MissionWires:
    """The channels of the mission process."""

    frames: Channel[PosedFrame]
    vehicle: Channel[VehicleState]
    intent: Channel[Intent]
    progress: Channel[MissionProgress]
    voxels: Channel[VoxelMap]
    surface: Channel[SurfaceElements]
    plan: Channel[ViewPath]


@dataclass(frozen=True)
class Orders:
    """What this mission is to do, in SI units."""

    views: int
    survey_views: int
    view_spacing_m: float
    takeoff_height_m: float
    takeoff_radius_m: float
    vehicle_height_m: float
    camera_pitch_down_rad: float
    max_flight_s: float
    plan_cost_s: float


@dataclass(frozen=True)
class Decision:
    """A plan and the motion made of it; motion is a reason in words where there is none."""

    path: ViewPath | NothingLeft
    motion: Trajectory | str


@dataclass
class Tally:
    """What the mission counts."""

    views: int = 0
    plans: int = 0
    planning_s: float = 0.0
    frontiers: int = 0
    tasks: int = 0
    failed_plans: int = 0
    hover_wait_s: float = 0.0
    mode: str = ""
    note: str = ""


@dataclass
class Memory:
    """What a step leaves for the next one."""

    phase: Phase = Phase.IDLE
    frame_sequence: int = 0
    frame_s: float = -1.0
    map: VoxelMap | None = None
    surface_revision: int = -1
    decision: Pending[Decision] | None = None
    resting_since_s: float | None = None
    think_again_s: float = 0.0
    looked_round: bool = False
    homing: bool = False
    took_off_s: float | None = None
    stop_reason: str = ""
    no_way_home: bool = False
    tally: Tally = field(default_factory=Tally)


class Conductor:
    """Flies one mission. step() is called at 20 Hz or more and never waits for planning or mapping."""

    def __init__(
        self, stages: Stages, wires: MissionWires, orders: Orders, executor: Executor, journal: Journal, clock: Clock
    ) -> None:
        self._stages, self._wires, self._orders = stages, wires, orders
        self._executor, self._journal, self._clock = executor, journal, clock
        self._course, self._captures = Course(orders.camera_pitch_down_rad), Captures(VIEW_LATE_S)
        self._memory = Memory()
        self._start_requested = self._abort_requested = False
        self._map_published_s = -np.inf
        half = orders.vehicle_height_m / 2
        stages.voxels.declare_free(np.zeros(3), orders.takeoff_radius_m, -half, orders.takeoff_height_m + half)

    @property
    def phase(self) -> Phase:
        """Where the mission stands."""
        return self._memory.phase

    @property
    def finished(self) -> bool:
        """Nothing more will be done."""
        return self.phase in (Phase.DONE, Phase.YIELDED)

    def request_start(self) -> None:
        """The operator's go."""
        self._start_requested = True

    def request_abort(self) -> None:
        """Land now; never taken back."""
        self._abort_requested = True

    def step(self) -> None:
        """Frame to map, map to events, events to phase, phase to motion, motion to the pilot."""
        now_s = self._clock.now_s()
        vehicle = self._wires.vehicle.latest()
        self._map_newest_frame(now_s)
        if vehicle is not None:
            self._course.follow(vehicle)
            self._change_phase(advance(self.phase, observe(self._facts(now_s, vehicle))), now_s)
            self._act(now_s, vehicle)
        self._publish(now_s)

    # -- observe ------------------------------------------------------------------------------------------------------

    def _map_newest_frame(self, now_s: float) -> None:
        memory, sequence = self._memory, self._wires.frames.sequence()
        posed = self._wires.frames.latest() if sequence != memory.frame_sequence else None
        if posed is None:
            return
        memory.frame_sequence, memory.frame_s = sequence, now_s
        self._stages.voxels.integrate(posed)
        memory.map = self._stages.voxels.snapshot()
        stamp_s = posed.frame.stamp_s
        if memory.tally.views < self._orders.views and self._captures.take(stamp_s) and self._stages.mapper.add(posed):
            memory.tally.views += 1
            self._journal.write(
                "view", stamp_s, index=memory.tally.views, position=posed.world_from_depth.translation_m.tolist()
            )

    def _facts(self, now_s: float, vehicle: VehicleState) -> Facts:
        memory = self._memory
        at_rest = self._course.at_rest(now_s) and not self._captures.waiting(now_s)
        return Facts(
            vehicle=vehicle,
            start=self._start_requested and memory.frame_s >= 0.0,
            abort=self._abort_requested,
            at_rest=at_rest,
            took_off=self._course.trajectory is not None,
            frame_age_s=now_s - memory.frame_s,
            frame_timeout_s=FRAME_TIMEOUT_S,
            nothing_left=bool(memory.stop_reason),
            views_left=self._orders.views - memory.tally.views,
            flight_s=0.0 if memory.took_off_s is None else now_s - memory.took_off_s,
            max_flight_s=self._orders.max_flight_s,
            homing=memory.homing,
            no_way_home=memory.no_way_home,
        )

    def _change_phase(self, phase: Phase, now_s: float) -> None:
        if phase is self.phase:
            return
        memory = self._memory
        self._journal.write("phase", now_s, phase=phase.value, before=memory.phase.value, note=memory.tally.note)
        if phase is Phase.RETURN and not memory.stop_reason:
            memory.stop_reason = self._why_return(now_s)
        if phase is not Phase.TAKEOFF:
            memory.decision = None
        memory.phase, memory.resting_since_s, memory.think_again_s = phase, None, 0.0
        if phase in (Phase.HOLD, Phase.RETURN, Phase.RETREAT):
            self._brake(now_s)

    def _why_return(self, now_s: float) -> str:
        memory, orders = self._memory, self._orders
        if memory.tally.views >= orders.views:
            return f"view budget of {orders.views} spent, {memory.tally.frontiers} frontiers left"
        if memory.took_off_s is not None and now_s - memory.took_off_s > orders.max_flight_s:
            return f"flight time of {orders.max_flight_s:.0f} s spent, {memory.tally.frontiers} frontiers left"
        return f"battery low, {memory.tally.frontiers} frontiers left"

    # -- act ----------------------------------------------------------------------------------------------------------

    def _act(self, now_s: float, vehicle: VehicleState) -> None:
        if self.phase is Phase.TAKEOFF:
            self._take_off(now_s, vehicle)
        elif self.phase is Phase.SURVEY:
            self._survey(now_s, vehicle)
        elif self.phase in (Phase.RETURN, Phase.RETREAT):
            self._go_home(now_s, vehicle)

    def _take_off(self, now_s: float, vehicle: VehicleState) -> None:
        if self._course.trajectory is None and vehicle.phase is FlightPhase.FLYING:
            start = self._course.rest(vehicle)
            goal = start.position_m + np.array([0.0, 0.0, self._orders.takeoff_height_m - start.position_m[2]])
            self._memory.took_off_s = now_s
            identifier = self._course.next_identifier()
            self._fly(self._stages.motion.line(start, goal, start.yaw_rad, now_s, identifier), now_s)

    def _survey(self, now_s: float, vehicle: VehicleState) -> None:
        memory = self._memory
        if not self._course.at_rest(now_s):
            self._stop_if_blocked(now_s)
            return
        if self._captures.waiting(now_s) or memory.map is None:
            return
        if not memory.looked_round:
            memory.looked_round = True
            start, identifier = self._course.rest(vehicle), self._course.next_identifier()
            self._fly(self._stages.motion.turn(start, now_s, 2 * np.pi, self._orders.survey_views, identifier), now_s)
            return
        if memory.resting_since_s is None:
            memory.resting_since_s = now_s
        if memory.decision is None and now_s >= memory.think_again_s:
            memory.decision = self._decide(vehicle, None)
        if memory.decision is not None and memory.decision.done():
            self._adopt(memory.decision.result(), now_s)

    def _go_home(self, now_s: float, vehicle: VehicleState) -> None:
        memory = self._memory
        if memory.homing or not self._course.at_rest(now_s) or memory.map is None:
            return
        if memory.decision is None:
            home = np.array([0.0, 0.0, self._orders.takeoff_height_m])
            rest = self._course.rest(vehicle)
            goal = Viewpoint(home, rest.yaw_rad, rest.camera_pitch_down_rad)
            memory.decision = self._decide(vehicle, goal)
        if not memory.decision.done():
            return
        decision = memory.decision.result()
        memory.decision = None
        if isinstance(decision.motion, Trajectory):
            memory.homing = True
            self._fly(decision.motion, now_s)
        elif self.phase is Phase.RETURN:
            memory.tally.note, memory.no_way_home = decision.motion, True
        else:  # breadcrumbs cannot be flown either: land here
            memory.tally.note = decision.motion
            self._abort_requested = True

    def _decide(self, vehicle: VehicleState, home: Viewpoint | None) -> Pending[Decision]:
        stages, orders, memory = self._stages, self._orders, self._memory
        rest, voxels = self._course.rest(vehicle), memory.map
        surface, identifier, now_s = stages.mapper.surface(), self._course.next_identifier(), self._clock.now_s()
        crumbs = self._course.way_back() if self.phase is Phase.RETREAT else ()
        if voxels is None:
            raise RuntimeError("no map to decide on")
        request = PlanRequest(voxels, surface, rest.position_m, rest.yaw_rad, orders.views - memory.tally.views)

        def work() -> Decision:
            if home is None:
                path = stages.planner.plan(request)
            elif crumbs:
                path = ViewPath((home,), (np.array([rest.position_m, *crumbs, home.position_world]),), PlanMode.EXPLORE,
                                request.voxels.revision, request.voxels.map_epoch, (), 0.0, 0.0)  # fmt: skip
            else:
                path = stages.planner.route(request, home)
            if isinstance(path, NothingLeft):
                return Decision(path, path.reason)
            spacing_m = orders.view_spacing_m if home is None else np.inf
            return Decision(path, stages.motion.through(path, request.voxels, rest, now_s, spacing_m, identifier))

        return self._executor.submit(work, orders.plan_cost_s)

    def _adopt(self, decision: Decision, now_s: float) -> None:
        memory, tally, path = self._memory, self._memory.tally, decision.path
        memory.decision = None
        tally.plans += 1
        tally.planning_s += path.step_s
        if isinstance(path, NothingLeft):
            memory.stop_reason = tally.note = path.reason
            self._journal.write("stop", now_s, reason=path.reason, task_s=path.task_s, step_s=path.step_s)
            return
        tally.mode, tally.tasks = path.mode.value, len(path.tasks)
        tally.frontiers = sum(task.kind.value == "explore" for task in path.tasks)
        self._journal.write("plan", now_s, mode=path.mode.value, task_s=path.task_s, step_s=path.step_s, tasks=len(path.tasks),
                            frontiers=tally.frontiers, views=len(path.viewpoints))  # fmt: skip
        self._wires.plan.publish(path)
        if isinstance(decision.motion, str):
            self._note_failed_plan(decision.motion, now_s)
            return
        tally.failed_plans = 0
        if memory.resting_since_s is not None:
            tally.hover_wait_s += now_s - memory.resting_since_s
        memory.resting_since_s = None
        self._fly(decision.motion, now_s)

    def _note_failed_plan(self, reason: str, now_s: float) -> None:
        memory = self._memory
        memory.tally.failed_plans += 1
        memory.tally.note, memory.think_again_s = f"plan not flyable: {reason}", now_s + RETHINK_S
        self._journal.write("refusal", now_s, reason=memory.tally.note)
        if memory.tally.failed_plans >= MAX_FAILED_PLANS:
            memory.stop_reason = f"{MAX_FAILED_PLANS} plans in a row could not be flown: {reason}"

    def _fly(self, trajectory: Trajectory, now_s: float) -> None:
        trajectory = dataclasses.replace(trajectory, start_s=now_s)  # made a moment ago, flown from now
        self._course.trajectory = trajectory
        self._captures.expect(trajectory)

    def _brake(self, now_s: float) -> None:
        trajectory = self._course.trajectory
        if trajectory is not None and not self._course.at_rest(now_s):
            stopping = self._stages.motion.stop(trajectory, now_s, self._course.next_identifier())
            self._captures.cancel_after(now_s)
            self._course.trajectory = stopping

    def _stop_if_blocked(self, now_s: float) -> None:
        trajectory, voxels = self._course.trajectory, self._memory.map
        if trajectory is not None and voxels is not None and not self._stages.motion.still_clear(trajectory, now_s, voxels):
            self._journal.write("refusal", now_s, reason="the map shows an obstacle on the way")
            self._brake(now_s)

    # -- publish ------------------------------------------------------------------------------------------------------

    def _publish(self, now_s: float) -> None:
        memory, tally, wires = self._memory, self._memory.tally, self._wires
        grounded = self.phase in (Phase.IDLE, Phase.READY, Phase.DONE, Phase.YIELDED)
        goal = Goal.STANDBY if grounded else Goal.LAND if self.phase is Phase.LANDING else Goal.FLY
        wires.intent.publish(Intent(now_s, goal, self._course.trajectory))
        surface = self._stages.mapper.surface()
        if surface is not None and surface.revision != memory.surface_revision:
            memory.surface_revision = surface.revision
            wires.surface.publish(surface)
        if now_s - self._map_published_s < MAP_PERIOD_S and not self.finished:
            return
        self._map_published_s = now_s
        if memory.map is not None:
            wires.voxels.publish(memory.map)
        progress = MissionProgress(
            now_s, self.phase.value, tally.mode, tally.views, self._orders.views, self._stages.voxels.explored_m3(),
            self._course.path_length_m, tally.frontiers, tally.tasks, tally.plans, tally.planning_s, tally.note, self.finished,
        )  # fmt: skip
        wires.progress.publish(progress)
        self._journal.write("progress", now_s, phase=self.phase.value, mode=tally.mode, views=tally.views,
                            explored_m3=progress.explored_m3, path_length_m=progress.path_length_m, frontiers=tally.frontiers,
                            plans=tally.plans, planning_s=tally.planning_s, hover_wait_s=tally.hover_wait_s)  # fmt: skip

    def account(self) -> dict[str, object]:
        """The mission's summary for the report."""
        memory = self._memory
        return {
            "outcome": self._outcome(), "stop_reason": memory.stop_reason, "views": memory.tally.views,
            "path_length_m": self._course.path_length_m, "planning_total_s": memory.tally.planning_s,
            "hover_wait_s": memory.tally.hover_wait_s, "explored_m3": self._stages.voxels.explored_m3(),
        }  # fmt: skip

    def _outcome(self) -> str:
        if self.phase is Phase.DONE and self._memory.homing and not self._abort_requested:
            return "completed"
        reason = "the operator asked to land" if self._abort_requested else self._memory.tally.note or self.phase.value
        return f"aborted: {reason}"
