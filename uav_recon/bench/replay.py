"""A whole replay of a recording: every frame fused and planned, and some of the views judged by brute force."""

from __future__ import annotations

from uav_recon.bench import view_oracle
from uav_recon.bench.laps import LapTable, Stopwatch
from uav_recon.bench.recording import RESOLUTION_M, Recording
from uav_recon.bench.stages import Decision, Mapped, Stages, oracle_lens, request_of
from uav_recon.planning.camera import CameraGeometry
from uav_recon.types.camera import PosedFrame

JUDGED_EVERY = 5  # frames: brute force takes a while
SHELL_M = (0.5, 4.3)  # how far from a frontier the brute force looks for views


class Replay:
    """One flight along the recording, every frame fused and planned; views judged every few frames."""

    def __init__(self, recording: Recording) -> None:
        self.mapped = Mapped(recording, recording.grid, (recording.low_m, recording.high_m))
        self.mapped.start(recording.frames[0])
        self._stages, self._planner = Stages(self.mapped), self.mapped.planner()
        self.wall, self.cpu = LapTable(), LapTable()
        self.ratios: list[float] = []

    def frame(self, posed: PosedFrame) -> None:
        """Fuse, plan stage by stage, and plan as a whole."""
        watch = Stopwatch()
        voxels = self.mapped.fuse(posed, watch)
        decision = self._stages.decide(voxels, posed, watch)
        watch.restart()
        self._planner.plan(request_of(voxels, posed))
        watch.lap("plan")
        if len(self.wall) % JUDGED_EVERY == 0:
            self.ratios += _view_ratios(self.mapped.camera, decision, len(self.wall))
        self.wall.add(watch.ms)
        self.cpu.add(watch.cpu_ms)


def _view_ratios(camera: CameraGeometry, decision: Decision, seed: int) -> list[float]:
    """What each chosen view sees of its frontier, over what the best of 1,000 random views sees of it."""
    if decision.reachable is None:
        return []
    lens = oracle_lens(camera, RESOLUTION_M)
    shell = (SHELL_M[0] / RESOLUTION_M, SHELL_M[1] / RESOLUTION_M)
    ratios = []
    for chosen in decision.chosen:
        best = view_oracle.best_seen(decision.voxels.state, lens, decision.reachable, chosen.frontier, shell, seed)
        seen = view_oracle.cells_seen(decision.voxels.state, lens, chosen.view, chosen.frontier)
        ratios.append(seen / best if best else 1.0)
    return ratios
