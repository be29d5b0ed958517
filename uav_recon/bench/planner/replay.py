"""Replays of a recording: timed by stage, timed as a whole, or compared with brute force.

Each kind has a separate replay, so that none affects the caches of another.
"""

from __future__ import annotations

from collections.abc import Iterable

from uav_recon.bench.planner import view_oracle
from uav_recon.bench.planner.recorded_stream import RESOLUTION_M, RecordedStream
from uav_recon.bench.planner.stages import Mount, PlannerStages, ReplayMap, oracle_lens, request_of
from uav_recon.measurement.stage_timing import StageTimings, Stopwatch
from uav_recon.planning.view_planner import ViewPlanner
from uav_recon.types.camera import PosedFrame

JUDGED_EVERY = 5  # frames; brute force is slow
SHELL_M = (0.5, 4.3)  # distances from a frontier at which brute force samples views


def mapped_of(recording: RecordedStream, mount: Mount = "gimbal") -> ReplayMap:
    """Return the empty map of the recording's room."""
    return ReplayMap(recording, recording.grid, (recording.low_m, recording.high_m), mount)


class Timed:
    """Lap times of a replay, as wall-clock and processor time."""

    def __init__(self) -> None:
        self.wall = StageTimings()
        self.cpu = StageTimings()

    def add(self, watch: Stopwatch) -> None:
        """Add the laps of a frame."""
        self.wall.add(watch.ms)
        self.cpu.add(watch.cpu_ms)


def timed_stages(recording: RecordedStream, frames: Iterable[PosedFrame]) -> Timed:
    """Return the lap times of STAGES."""
    mapped, timed = mapped_of(recording), Timed()
    stages = PlannerStages(mapped)
    mapped.start(recording.frames[0])
    for posed in frames:
        watch = Stopwatch()
        stages.decide(mapped.fuse(posed, watch), posed, watch)
        timed.add(watch)
    return timed


def timed_plans(mapped: ReplayMap, planner: ViewPlanner, frames: Iterable[PosedFrame]) -> Timed:
    """Return the lap times of WHOLE. The map may already contain data."""
    timed = Timed()
    for posed in frames:
        watch = Stopwatch()
        request = request_of(mapped.fuse(posed, watch), posed)
        watch.restart()
        planner.plan(request)
        watch.lap("plan")
        timed.add(watch)
    return timed


def judged_views(recording: RecordedStream, frames: Iterable[PosedFrame], mount: Mount) -> list[float]:
    """Return, for each chosen view, the cells it sees over those seen by the best random view.

    The best of 1,000 random views is used. Only every JUDGED_EVERY-th frame is evaluated.
    """
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
