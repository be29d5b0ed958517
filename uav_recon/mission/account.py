"""What the mission counts, writes down and tells the world."""

from __future__ import annotations

from dataclasses import dataclass

from uav_recon.mission.machine import Phase
from uav_recon.protocols import Journal
from uav_recon.types.camera import PosedFrame
from uav_recon.types.tasks import NothingLeft, TaskKind, ViewPath
from uav_recon.types.vehicle import MissionProgress


@dataclass
class Account:
    """Counts of one flight; every note also goes into the journal."""

    journal: Journal
    views_budget: int
    views: int = 0
    plans: int = 0
    planning_s: float = 0.0
    frontiers: int = 0
    tasks: int = 0
    failed_in_a_row: int = 0
    hover_wait_s: float = 0.0
    mode: str = ""
    note: str = ""
    stop_reason: str = ""
    aborted: str = ""

    @property
    def views_left(self) -> int:
        """How many keyframes the mapper may still get."""
        return self.views_budget - self.views

    def phase(self, stamp_s: float, before: Phase, phase: Phase) -> None:
        """Note a change of phase."""
        self.journal.write("phase", stamp_s, phase=phase.value, before=before.value, note=self.note)

    def view(self, posed: PosedFrame) -> None:
        """Note a keyframe."""
        self.views += 1
        pose = posed.world_from_depth
        self.journal.write("view", posed.frame.stamp_s, index=self.views, position=pose.translation_m.tolist(),
                           quat_wxyz=pose.quat_wxyz.tolist())  # fmt: skip

    def plan(self, stamp_s: float, path: ViewPath | NothingLeft) -> None:
        """Note a plan and what it cost."""
        self.plans += 1
        self.planning_s += path.step_s
        if isinstance(path, NothingLeft):
            self.stop_reason = self.note = path.reason
            self.journal.write("stop", stamp_s, reason=path.reason, task_s=path.task_s, step_s=path.step_s)
            return
        self.mode, self.tasks = path.mode.value, len(path.tasks)
        self.frontiers = sum(task.kind is TaskKind.EXPLORE for task in path.tasks)
        self.journal.write("plan", stamp_s, mode=self.mode, task_s=path.task_s, step_s=path.step_s, tasks=self.tasks,
                           frontiers=self.frontiers, views=len(path.viewpoints))  # fmt: skip

    def refusal(self, stamp_s: float, reason: str) -> None:
        """Note a plan or a motion that is not flown."""
        self.note = reason
        self.journal.write("refusal", stamp_s, reason=reason)

    def progress(
        self, stamp_s: float, phase: Phase, explored_m3: float, path_length_m: float, finished: bool
    ) -> MissionProgress:
        """One line of the mission's life, also written down."""
        self.journal.write("progress", stamp_s, phase=phase.value, mode=self.mode, views=self.views, explored_m3=explored_m3,
                           path_length_m=path_length_m, frontiers=self.frontiers, plans=self.plans,
                           planning_s=self.planning_s, hover_wait_s=self.hover_wait_s)  # fmt: skip
        return MissionProgress(
            stamp_s, phase.value, self.mode, self.views, self.views_budget, explored_m3, path_length_m, self.frontiers,
            self.tasks, self.plans, self.planning_s, self.note, finished,
        )  # fmt: skip

    def close(self, stamp_s: float, outcome: str, explored_m3: float, path_length_m: float) -> None:
        """The last line: what came of it."""
        self.journal.write("outcome", stamp_s, outcome=outcome, stop_reason=self.stop_reason, views=self.views,
                           path_length_m=path_length_m, explored_m3=explored_m3, planning_s=self.planning_s,
                           hover_wait_s=self.hover_wait_s)  # fmt: skip
