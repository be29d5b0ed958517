"""A conductor on a table: what a mission stands on, in memory, and a vehicle that is wherever it was sent."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uav_recon.app.flight_channels import memory_channels
from uav_recon.clock import InlineExecutor, ManualClock
from uav_recon.config import MotionConfig
from uav_recon.mapping.recent_view_memory import RecentViewMemory
from uav_recon.mission.conductor import Conductor
from uav_recon.mission.setup.mission_parameters import MissionParameters
from uav_recon.mission.setup.mission_stages import MissionStages
from uav_recon.mission.state_machine import Phase
from uav_recon.motion import MotionPlanner
from uav_recon.motion.speed_limited_planner import SpeedLimitedPlanner
from uav_recon.recording.flight_log import FlightLog
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import FloatArray
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, SurfaceElements, VoxelMap
from uav_recon.types.pose import MapCorrection, Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.recent_views import RecentViews
from uav_recon.types.tasks import NothingLeft, PlanMode, PlanRequest, Task, TaskKind, ViewPath, Viewpoint
from uav_recon.types.trajectory import Goal, Intent, Setpoint, Trajectory
from uav_recon.types.vehicle import FlightPhase, MissionProgress, VehicleState

GRID = GridSpec(np.array([-3.0, -3.0, -1.0]), 0.1, (60, 60, 40))
LENS = Intrinsics(10.0, 10.0, 1.5, 1.5, 4, 4)


TOO_NARROW = Reason(ReasonCode.FRONTIERS_LEFT, (2,), (Reason(ReasonCode.FRONTIERS_TOO_NARROW, (2,)),))


class OpenSpace:
    """Voxels that are free everywhere over a floor, or nowhere once `closed`; `table`: what stands on the floor."""

    closed = False
    shows_motion = False
    table: tuple[slice, slice, slice] | None = None
    revision = epoch = 0

    def __init__(self) -> None:
        self.cones: list[FreeCone] = []
        self.refined: list[FloatArray] = []

    def integrate(self, posed: PosedFrame) -> int:
        assert posed.map_epoch == self.epoch
        self.revision += 1
        return 1

    def integrate_cone(self, cone: FreeCone) -> int:
        assert cone.map_epoch == self.epoch
        self.cones.append(cone)
        self.revision += 1
        return 1

    def refine(self, places_world: Sequence[FloatArray]) -> None:
        self.refined += places_world

    def reset(self, map_epoch: int) -> None:
        self.epoch = map_epoch

    def declare_free(self, centre_world: FloatArray, radius_m: float, z_min_m: float, z_max_m: float) -> None:
        self.declared = (radius_m, z_min_m, z_max_m)

    def snapshot(self) -> VoxelMap:
        state = np.full(GRID.shape, 0 if self.closed else FREE, np.uint8)
        if not self.closed:
            state[:, :, 7:9] = OCCUPIED
        if self.table is not None:
            state[self.table] = OCCUPIED
        return VoxelMap.whole(GRID, state, np.where(state == FREE, 100, 0).astype(np.uint8), self.revision, self.epoch)

    def explored_m3(self) -> float:
        return 0.001 * self.revision


class ThreeViews:
    """A planner that knows three views, the next two at a time, and forgets each once the vehicle was there."""

    def __init__(self) -> None:
        self.left = [np.array([1.5, 0.0, 1.1]), np.array([1.5, 1.5, 1.1]), np.array([0.0, 1.5, 1.1])]
        self.no_way_home = self.settled = self.explored = False
        self.fine_places: tuple[FloatArray, ...] = ()
        self.nothing = TOO_NARROW
        self.accepted: list[ViewPath] = []
        self.asked: list[PlanRequest] = []

    def plan(self, request: PlanRequest) -> ViewPath | NothingLeft:
        self.asked.append(request)
        if not self.left:
            return NothingLeft(self.nothing, 0.01, 0.02)
        return self._to(request, *(Viewpoint(place, 0.5, 0.26) for place in self.left[:2]))

    def route(self, request: PlanRequest, goal: Viewpoint) -> ViewPath | NothingLeft:
        return NothingLeft(Reason(ReasonCode.NO_KNOWN_PATH), 0.0, 0.0) if self.no_way_home else self._to(request, goal)

    def was_at(self, position_world: FloatArray) -> None:
        self.left = [place for place in self.left if np.linalg.norm(place - position_world) > 0.15]

    def accept(self, path: ViewPath) -> None:
        self.accepted.append(path)

    def next_view_has_gain(self, voxels: VoxelMap, position_world: FloatArray, yaw_rad: float) -> bool:
        return not self.settled

    def _to(self, request: PlanRequest, *views: Viewpoint) -> ViewPath:
        places = [request.position_world, *(view.position_world for view in views)]
        ways = tuple(np.array(leg) for leg in itertools.pairwise(places))
        tasks = tuple(Task(TaskKind.EXPLORE, view.position_world, view, 9.0) for view in views)
        of_map = request.voxels.revision, request.voxels.map_epoch
        return ViewPath(views, ways, PlanMode.EXPLORE, *of_map, tasks, 0.01, 0.02, explored=self.explored)


class Sketchbook:
    def __init__(self) -> None:
        self.stamps: list[float] = []
        self.corrections: list[MapCorrection] = []

    def refused(self) -> dict[str, int]:
        return {}

    def repose(self, correction: MapCorrection) -> None:
        self.corrections.append(correction)

    def add(self, keyframe: PosedFrame) -> bool:
        self.stamps.append(keyframe.frame.stamp_s)
        return True

    def surface(self) -> SurfaceElements | None:
        return None

    def alive(self) -> bool:
        return True

    def finish(self, folder: Path) -> None:
        raise AssertionError("the process finishes the mapper, not the conductor")


class NoExtraViews:
    def __init__(self) -> None:
        self.asked_as_explored: set[bool] = set()

    def selects(self, posed: PosedFrame, views_left: int, *, explored: bool) -> bool:
        self.asked_as_explored.add(explored)
        return False

    def keep(self, posed: PosedFrame) -> None:
        pass


def posed_frame(stamp_s: float, map_epoch: int = 0, unsure: bool = False) -> PosedFrame:
    depth = np.full((4, 4), 2.0, np.float32)
    frame = Frame(stamp_s, 1, depth, LENS, np.zeros((4, 4, 3), np.uint8), LENS, Pose.identity())
    return PosedFrame(frame, Pose.identity(), map_epoch, unsure)


def vehicle_state(
    stamp_s: float, x_m: float = 0.0, max_speed_mps: float = math.inf, slow_reason: Reason | None = None
) -> VehicleState:
    return VehicleState(
        stamp_s, Pose.from_yaw(0.0, np.array([x_m, 0.0, 0.0])), np.zeros(3), False, "OFFBOARD", FlightPhase.READY, 0.9, False,
        math.nan, 1, 0, None, max_speed_mps, slow_reason=slow_reason,
    )  # fmt: skip


class Asked(MotionPlanner):
    """Counts the ways that it is asked for."""

    ways = 0

    def plan_from_rest(
        self, path: ViewPath, voxels: VoxelMap, start: Setpoint, start_s: float, views_at_spacing_m: float, identifier: int,
        views: RecentViews | None = None, cells: SurfaceCells | None = None,
    ) -> Trajectory | Reason:  # fmt: skip
        self.ways += 1
        return super().plan_from_rest(path, voxels, start, start_s, views_at_spacing_m, identifier, views, cells)


class Desk:
    """A conductor on a table: the vehicle is wherever its trajectory says, frames come at 10 Hz."""

    def __init__(self, folder: Path, views: int = 50, operator_timeout_s: float = math.inf, takeoff_top_m: float = 0.0) -> None:
        self.clock = ManualClock(100.0)
        self.channels = memory_channels()
        self.voxels = OpenSpace()
        self.planner = ThreeViews()
        self.mapper = Sketchbook()
        self.budget = NoExtraViews()
        motion = MotionPlanner(MotionConfig(), 0.35)
        self.parameters = MissionParameters(
            views, 4, np.inf, 1.1, 0.6, takeoff_top_m, 0.5, 0.2, 0.3, 0.26, 300.0, 0.1, 0.35, operator_timeout_s
        )
        self.retreat = Asked(MotionConfig(), 0.30)
        self.stages = MissionStages(
            self.voxels,
            self.budget,
            self.mapper,
            self.planner,
            self.paced(motion),
            self.paced(self.retreat),
            RecentViewMemory(10.0, np.zeros(3)),
        )
        self.folder = folder
        self.journal = FlightLog(folder)
        self.conductor = Conductor(self.stages, self.channels, self.parameters, InlineExecutor(self.clock), self.journal)
        self.phase = FlightPhase.READY
        self.frames = True
        self.unsure = False
        self.refusals = 0
        self.human = False
        self.note: Reason | None = None
        self.stands = False
        self.battery = 0.9
        self.max_speed_mps = math.inf
        self.slow_reason: Reason | None = None
        self.attended = False
        self._received_s = -math.inf
        self.seen: list[Phase] = []
        self._place_m = np.zeros(3)
        self.epoch = 0

    def run(self, seconds: float, until: Phase | None = None) -> None:
        for _ in range(int(seconds * 30)):
            self.clock.advance_to(self.clock.now_s() + 1 / 30)
            self._vehicle()
            if self.frames and int(self.clock.now_s() * 30) % 3 == 0:
                self._frame()
            self.conductor.step(self.clock.now_s())
            if not self.seen or self.seen[-1] is not self.conductor.phase:
                self.seen.append(self.conductor.phase)
            if self.conductor.phase is until:
                return
        assert until is None, f"never came to {until}, was in {self.seen}"

    @property
    def intent(self) -> Intent:
        intent = self.channels.intent.latest()
        assert intent is not None
        return intent

    @property
    def progress(self) -> MissionProgress:
        progress = self.channels.progress.latest()
        assert progress is not None
        return progress

    def speed_mps(self) -> float:
        trajectory = self.intent.trajectory
        return 0.0 if trajectory is None else float(np.linalg.norm(trajectory.setpoint_at(self.clock.now_s()).velocity_mps))

    def distance_m(self) -> float:
        """Level, from the pad."""
        return math.hypot(*self._place_m[:2])

    @staticmethod
    def paced(usual: MotionPlanner) -> SpeedLimitedPlanner:
        """With a slow one beside it."""
        return SpeedLimitedPlanner(usual, MotionPlanner(MotionConfig(speed_mps=0.2, tight_speed_mps=0.2), 0.35), 1.0)

    def _vehicle(self) -> None:
        intent = self.channels.intent.latest()
        position, yaw = self._place_m, 0.0
        if intent is not None:
            if intent.goal is Goal.FLY and self.phase is FlightPhase.READY:
                self.phase = FlightPhase.FLYING
            elif intent.goal is Goal.LAND:
                self.phase = FlightPhase.LANDED
            if intent.trajectory is not None and not self.stands:
                setpoint = intent.trajectory.setpoint_at(self.clock.now_s())
                position, yaw = setpoint.position_m, setpoint.yaw_rad
        self._place_m = position
        self.planner.was_at(position)
        armed = self.phase is FlightPhase.FLYING
        self._received_s = self.clock.now_s() if self.attended else self._received_s
        self.channels.vehicle.publish(
            VehicleState(self.clock.now_s(), Pose.from_yaw(yaw, position), np.zeros(3), armed, "OFFBOARD", self.phase,
                         self.battery, self.human, float("nan"), 1, self.refusals, self.note, self.max_speed_mps,
                         self._received_s, slow_reason=self.slow_reason)
        )  # fmt: skip

    def _frame(self) -> None:
        self.channels.frames.publish(posed_frame(self.clock.now_s() - 0.1, self.epoch, self.unsure))
