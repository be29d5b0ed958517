import numpy as np

from uav_recon.bench.planner import builtin_building
from uav_recon.bench.planner.stages import ReplayMap
from uav_recon.types.maps import FREE, OCCUPIED


def test_each_return_lies_on_a_wall_or_a_box_and_none_is_beyond_the_range() -> None:
    recording = builtin_building.fly_through()
    assert len(recording.frames) > 100
    boxes = builtin_building._BOXES
    for posed in recording.frames[::25]:
        depth_m = posed.frame.depth_m.astype(np.float64)
        points = posed.world_from_depth.apply((recording.lens.bearings() * depth_m[..., None])[::7, ::7].reshape(-1, 3))
        away_m = np.linalg.norm(points - posed.world_from_depth.translation_m, axis=1)
        hit = away_m <= recording.max_range_m
        assert hit.mean() > 0.5
        assert (away_m[~hit] > 2 * recording.max_range_m).all()
        room_m = np.abs(np.concatenate([points - builtin_building.LOW_M, points - builtin_building.HIGH_M], axis=1)).min(axis=1)
        outside_m = np.maximum(boxes[None, :, :3] - points[:, None], points[:, None] - boxes[None, :, 3:])
        box_m = np.abs(outside_m.max(axis=2)).min(axis=1)
        assert np.minimum(room_m, box_m)[hit].max() < 1e-3


def test_the_flight_stays_clear_of_everything() -> None:
    for posed in builtin_building.fly_through().frames:
        place = posed.world_from_depth.translation_m
        assert ((place > builtin_building.LOW_M + 0.4) & (place < builtin_building.HIGH_M - 0.4)).all()
        outside_m = np.maximum(builtin_building._BOXES[:, :3] - place, place - builtin_building._BOXES[:, 3:]).max(axis=1)
        assert outside_m.min() > 0.3


def test_its_map_is_mostly_known() -> None:
    recording = builtin_building.fly_through()
    mapped = ReplayMap(recording, recording.grid, (recording.low_m, recording.high_m))
    for posed in recording.frames:
        mapped.voxels.integrate(posed)
    state = mapped.voxels.snapshot().state
    assert (state == FREE).mean() > 0.6
    assert 0.05 < (state == OCCUPIED).mean() < 0.3
