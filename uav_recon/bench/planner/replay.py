"""Replays of a recording: every frame fused and planned; timed stage by stage, timed as a whole, and judged by brute force.

Each has a replay of its own, so that none warms or washes out another one's caches.
"""

from __future__ import annotations

from collections.abc import Iterable

from uav_recon.bench.planner import view_oracle
from uav_recon.bench.planner.recorded_stream import RESOLUTION_M, Recording
from uav_recon.bench.planner.stage_timing import StageTimings, Stopwatch
from uav_recon.bench.planner.stages import Mapped, Mount, PlannerStages, oracle_lens, request_of
from uav_recon.planning.view_planner import ViewPlanner
from uav_recon.types.camera import PosedFrame

JUDGED_EVERY = 5  # frames: brute force takes a while
SHELL_M = (0.5, 4.3)  # how far from a frontier the brute force looks for views


def mapped_of(recording: Recording, mount: Mount = "gimbal") -> Mapped:
    """The map of the recording's room before its first frame."""
    return Mapped(recording, recording.grid, (recording.low_m, recording.high_m), mount)


class Timed:
    """Laps of a replay, by the wall's clock and of the processor."""

    def __init__(self) -> None:
        self.wall, self.cpu = StageTimings(), StageTimings()

    def add(self, watch: Stopwatch) -> None:
        """Keep a frame."""
        self.wall.add(watch.ms)
        self.cpu.add(watch.cpu_ms)


def timed_stages(recording: Recording, frames: Iterable[PosedFrame]) -> Timed:
    """The laps of STAGES."""
    mapped, timed = mapped_of(recording), Timed()
    stages = PlannerStages(mapped)
    mapped.start(recording.frames[0])
    for posed in frames:
        watch = Stopwatch()
        stages.decide(mapped.fuse(posed, watch), posed, watch)
        timed.add(watch)
    return timed


def timed_plans(mapped: Mapped, planner: ViewPlanner, frames: Iterable[PosedFrame]) -> Timed:
    """The laps of WHOLE, in a map that may hold something already."""
    timed = Timed()
    for posed in frames:
        watch = Stopwatch()
        request = request_of(mapped.fuse(posed, watch), posed)
        watch.restart()
        planner.plan(request)
        watch.lap("plan")
        timed.add(watch)
    return timed


def judged_views(recording: Recording, frames: Iterable[PosedFrame], mount: Mount) -> list[float]:
    """What each chosen view sees of its frontier, over what the best of 1,000 random views sees of it; every few frames."""
    mapped = mapped_of(recording, mount)
    stages, lens = PlannerStages(mapped), oracle_lens(mapped.camera, RESOLUTION_M)
    shell = (SHELL_M[0] / RESOLUTION_M, SHELL_M[1] / RESOLUTION_M)
    mapped.start(recording.frames[0])
    ratios = []
    for n, posed in enumerate(frames):
        decision = stages.decide(mapped.fuse(posed, Stopwatch()), posed, Stopwatch())
        if n % JUDGED_EVERY:
            continue
        state, reachable = decision.voxels.state, stages.reachable()
        for chosen in stages.chosen(decision):
            best = view_oracle.best_seen(state, lens, reachable, chosen.frontier, shell, n)
            seen = view_oracle.cells_seen(state, lens, chosen.view, chosen.frontier)
            ratios.append(seen / best if best else 1.0)
    return ratios
