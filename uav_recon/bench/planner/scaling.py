"""Time per frame for a building that is ten and a hundred times as large.

Copies of the recording's building are placed wall to wall. All copies but one are first filled with the whole recording,
frame by frame as in a flight, so that the map has their walls, rooms and remaining frontiers. Then the recording is
replayed in the remaining copy, in the middle of the map, and each frame is fused and planned.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from uav_recon.bench.planner.recorded_stream import RESOLUTION_M, RecordedStream
from uav_recon.bench.planner.replay import timed_plans
from uav_recon.bench.planner.stages import WHOLE, ReplayMap, request_of
from uav_recon.measurement.host_info import resident_mb
from uav_recon.measurement.stage_timing import Stopwatch, TimingSummary
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import GridSpec
from uav_recon.types.pose import Pose

COPIES = (1, 10, 100)
WALL_M = 0.2  # map beyond the room on each side, for its walls
FILLING_STEP = 2  # every second frame of the recording fills the other copies: each surface is still seen often enough


@dataclass(frozen=True, slots=True)
class Size:
    """Results for one map size.

    stages: processor times, which are not lengthened by other load.
    memory_mb: memory of map and planner after the last frame.
    """

    copies: int
    area_m2: float
    voxels: tuple[int, int, int]
    stages: dict[str, TimingSummary]
    memory_mb: float


def layout(copies: int) -> tuple[int, int]:
    """Return columns and rows of the copies, as square as the number divides."""
    rows = next(n for n in range(math.isqrt(copies), 0, -1) if copies % n == 0)
    return copies // rows, rows


def measure(recording: RecordedStream, copies: int, tick: Callable[[int], None]) -> Size:
    """Replay the recording in a map of ``copies`` copies.

    Calls ``tick`` for each frame (see ticks).
    """
    columns, rows = layout(copies)
    wall_m = np.array([WALL_M, WALL_M, 0.0])
    pitch_m = recording.high_m - recording.low_m + 2 * wall_m
    upper_m = recording.low_m - wall_m + pitch_m * [columns, rows, 1]
    grid = GridSpec.covering(recording.low_m - wall_m, upper_m, RESOLUTION_M)
    gc.collect()
    before_mb = resident_mb()
    mapped = ReplayMap(recording, grid, (recording.low_m - wall_m, upper_m))
    planner = mapped.planner()
    live = (columns // 2, rows // 2)
    for place in np.ndindex(columns, rows):
        if place != live:
            for posed in recording.frames[::FILLING_STEP]:
                mapped.voxels.integrate(_moved(posed, pitch_m * [*place, 0]))
                tick(1)
    frames = [_moved(posed, pitch_m * [*live, 0]) for posed in recording.frames]
    mapped.start(frames[0])
    # the planner processes the filled map once, unmeasured: in a flight it would have seen the map grow
    planner.plan(request_of(mapped.fuse(frames[0], Stopwatch()), frames[0]))
    laps = timed_plans(mapped, planner, _counted(frames, tick)).cpu
    gc.collect()
    return Size(
        copies=copies,
        area_m2=float(pitch_m[0] * pitch_m[1] * copies),
        voxels=grid.shape,
        stages={stage: laps.spread(*parts) for stage, parts in WHOLE.items()},
        memory_mb=resident_mb() - before_mb,
    )


def _counted(frames: list[PosedFrame], tick: Callable[[int], None]) -> Iterator[PosedFrame]:
    for posed in frames:
        yield posed
        tick(1)


def ticks(recording: RecordedStream, copies: int) -> int:
    """Return the number of frames that measure() processes."""
    return len(recording.frames) + (copies - 1) * len(recording.frames[::FILLING_STEP])


def _moved(posed: PosedFrame, by_m: FloatArray) -> PosedFrame:
    pose = posed.world_from_depth
    return replace(posed, world_from_depth=Pose(pose.quat_wxyz, pose.translation_m + by_m))
