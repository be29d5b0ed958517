from __future__ import annotations

import numpy as np

from uav_recon.bench.planner import builtin_building
from uav_recon.bench.planner.stages import (
    STAGES,
    WHOLE,
    PlannerStages,
    ReplayMap,
    camera_of,
    heading_rad,
    oracle_lens,
    request_of,
)
from uav_recon.measurement.stage_timing import Stopwatch
from uav_recon.types.tasks import ViewPath


def test_the_timed_stages_give_the_same_result_as_plan() -> None:
    recording = builtin_building.fly_through()
    mapped = ReplayMap(recording, recording.grid, (recording.low_m, recording.high_m))
    stages, planner = PlannerStages(mapped), mapped.planner()
    mapped.start(recording.frames[0])
    compared = 0
    for n, posed in enumerate(recording.frames[:60]):
        watch = Stopwatch()
        voxels = mapped.fuse(posed, watch)
        decision = stages.decide(voxels, posed, watch)
        path = planner.plan(request_of(voxels, posed))
        if n == 0 or not len(decision.order):
            continue
        assert isinstance(path, ViewPath)
        following, view = decision.flown[0].task.viewpoint, path.viewpoints[0]
        np.testing.assert_allclose(following.position_world, view.position_world, atol=1e-9)
        np.testing.assert_allclose(
            [following.yaw_rad, following.pitch_down_rad], [view.yaw_rad, view.pitch_down_rad], atol=1e-9
        )
        laps = {lap for parts in STAGES.values() for lap in parts}
        assert set(watch.ms) == laps
        compared += 1
    assert compared > 50


def test_the_total_contains_every_lap_once() -> None:
    for table in (STAGES, WHOLE):
        laps = [lap for name, parts in table.items() if name not in ("decision", "total") for lap in parts]
        assert sorted(laps) == sorted(table["total"])


def test_the_camera_is_that_of_the_recording() -> None:
    recording = builtin_building.fly_through()
    camera = camera_of(recording.lens, recording.max_range_m)
    np.testing.assert_allclose([camera.hfov_rad, camera.vfov_rad], np.radians([87.0, 71.0]))
    lens = oracle_lens(camera, 0.1)
    np.testing.assert_allclose([lens.reach, lens.near], [45.0, 1.0])
    axis = recording.frames[5].world_from_depth.rotation()[:, 2]
    np.testing.assert_allclose(np.tan(heading_rad(recording.frames[5])), axis[1] / axis[0])
