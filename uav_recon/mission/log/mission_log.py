"""Mission log: counts and notes of a flight, written to the journal and published."""

from __future__ import annotations

from dataclasses import dataclass, field

from uav_recon.interfaces import Journal
from uav_recon.mission.state_machine import Phase
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import NothingLeft, TaskKind, ViewPath
from uav_recon.types.vehicle import FlightPhase, MissionProgress, VehicleState


@dataclass
class MissionLog:
    """Counts of one flight; every note is also written to the journal."""

    journal: Journal
    views_budget: int
    views: int = 0
    plans: int = 0
    planning_s: float = 0.0
    frontiers: int = 0
    tasks: int = 0
    failed_in_a_row: int = 0
    mode: str = ""
    explored: bool = False
    note: Reason | None = None
    stop_reason: Reason | None = None
    aborted: Reason | None = None
    keyframes: list[Pose] = field(default_factory=list)  # world_from_depth of those of the newest map epoch, oldest first
    _map_epoch: int = 0

    @property
    def views_left(self) -> int:
        """Number of keyframes that the mapper may still get."""
        return self.views_budget - self.views

    def phase(self, stamp_s: float, phase: Phase) -> None:
        """Log a change of phase."""
        self.journal.phase(stamp_s, phase.value, self.note)

    def view(self, posed: PosedFrame) -> None:
        """Log a keyframe."""
        self.views += 1
        if posed.map_epoch != self._map_epoch:
            self._map_epoch = posed.map_epoch
            self.keyframes.clear()
        self.keyframes.append(posed.world_from_depth)
        self.journal.view(posed.frame.stamp_s, self.views, posed.world_from_depth)

    def plan(self, stamp_s: float, path: ViewPath | NothingLeft, waited_s: float) -> None:
        """Log a plan, its computation time, and the seconds at rest before it."""
        self.plans += 1
        self.planning_s += path.step_s
        if isinstance(path, NothingLeft):
            self.stop_reason = self.note = path.reason
            self.journal.plan(stamp_s, "", path.task_s, path.step_s, 0, 0, 0, waited_s)
            return
        self.mode = path.mode.value
        self.explored = path.explored
        self.tasks = len(path.tasks)
        self.frontiers = path.frontiers
        explore, views = sum(task.kind is TaskKind.EXPLORE for task in path.tasks), len(path.viewpoints)
        self.journal.plan(stamp_s, self.mode, path.task_s, path.step_s, explore, self.tasks, views, waited_s)

    def discarded_plan(self, stamp_s: float, path: ViewPath | NothingLeft) -> None:
        """Log the computation time of a plan made in motion that is not flown."""
        self.plans += 1
        self.planning_s += path.step_s
        mode = "" if isinstance(path, NothingLeft) else path.mode.value
        self.journal.plan(stamp_s, mode, path.task_s, path.step_s, 0, 0, 0, 0.0)

    def refusal(self, stamp_s: float, reason: Reason) -> None:
        """Log a plan or a motion that is not flown."""
        self.note = reason
        self.journal.refusal(stamp_s, reason)

    def stop(self, reason: Reason) -> None:
        """Note why the survey ends, with the frontiers of the last plan."""
        self.note = reason
        self.stop_reason = reason.with_detail(Reason(ReasonCode.FRONTIERS_IN_LAST_PLAN, (self.frontiers,)))

    def update(self, phase: Phase, vehicle: VehicleState, waits: Reason | None = None) -> None:
        """Update the note from the pilot's.

        On the ground it is the reason why nothing happens or arming was given up, or else what a start waits for. If the pilot
        lands by itself, it is the reason for that.
        """
        grounded = phase in (Phase.IDLE, Phase.READY) or (phase is Phase.TAKEOFF and vehicle.phase is FlightPhase.READY)
        if grounded or (vehicle.phase is FlightPhase.LANDING and phase is not Phase.LANDING and vehicle.note):
            self.note = vehicle.note or (waits if phase in (Phase.IDLE, Phase.READY) else None)

    def progress(
        self,
        stamp_s: float,
        phase: Phase,
        explored_m3: float,
        path_length_m: float,
        position_world: FloatArray,
        finished: bool,
        predicted_sigma_m: float | None = None,
        measured_sigma_m: float | None = None,
    ) -> MissionProgress:
        """Log and return a sample of the mission's progress.

        predicted_sigma_m, measured_sigma_m: as in MissionProgress.
        """
        now = MissionProgress(
            stamp_s, phase.value, self.mode, self.views, self.views_budget, explored_m3, path_length_m, self.frontiers,
            self.tasks, self.plans, self.planning_s, self.note, finished, position_world,
            predicted_sigma_m, measured_sigma_m,
        )  # fmt: skip
        self.journal.progress(now)
        return now

    def close(self, stamp_s: float, aborted: Reason | None) -> None:
        """Write the last line: the outcome. aborted: None for a completed flight."""
        self.journal.outcome(stamp_s, aborted, self.stop_reason)
