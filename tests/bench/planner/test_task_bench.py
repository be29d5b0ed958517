from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from uav_recon.bench.planner.task_bench import bench_tasks
from uav_recon.channels import MemoryChannel
from uav_recon.clock import ManualClock
from uav_recon.config import load, save
from uav_recon.errors import UserError
from uav_recon.mapping.keyframe_store import KeyframeFolder
from uav_recon.recording.map_file import save_map
from uav_recon.recording.timelapse import Timelapse
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, SurfaceElements, VoxelMap
from uav_recon.types.pose import Pose

FLOWN = Path(__file__).parents[3] / "systemd" / "config.toml"
LENS = Intrinsics.from_fov(32, 24, 1.5, 1.0)


def _room() -> VoxelMap:
    """Return a map of a box of air with solid walls."""
    from scipy.ndimage import distance_transform_edt

    grid = GridSpec(np.array([-3.2, -3.2, -0.4]), 0.1, (64, 64, 32))
    state = np.full(grid.shape, OCCUPIED, dtype=np.uint8)
    state[3:-3, 3:-3, 3:-3] = FREE
    distance2 = np.minimum(distance_transform_edt(state == FREE) ** 2, 255).astype(np.uint8)
    return VoxelMap.whole(grid, state, distance2, 1, 0)


def _wall() -> tuple[np.ndarray, np.ndarray]:
    y, z = np.meshgrid(np.arange(-2.0, 2.0, 0.05), np.arange(0.2, 2.2, 0.05))
    position = np.stack([np.full(y.size, 2.9), y.ravel(), z.ravel()], axis=1)
    return position, np.tile([-1.0, 0.0, 0.0], (len(position), 1))


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    config = load(FLOWN)
    box = config.safety.model_copy(update={"fence_min_m": (-3.0, -3.0, -0.2), "fence_max_m": (3.0, 3.0, 2.5)})
    save(config.model_copy(update={"safety": box}), tmp_path / "config.toml")
    save_map(tmp_path, _room())
    keyframes = KeyframeFolder(tmp_path / "keyframes")
    depth = np.full((LENS.height, LENS.width), 2.0, dtype=np.float32)
    frame = Frame(1.0, 0, depth, LENS, np.zeros((LENS.height, LENS.width, 3), np.uint8), LENS, Pose.identity())
    keyframes.save(PosedFrame(frame, Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))))
    clock, channel = ManualClock(2.0), MemoryChannel(SurfaceElements)
    timelapse = Timelapse(tmp_path, channel, clock)
    position, normal = _wall()
    channel.publish(SurfaceElements(position, normal, np.ones(len(position)), 1))
    timelapse.close()
    return tmp_path


def test_reports_the_number_of_tasks_and_the_time(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench_tasks(flight, flight / "tasks.json") == 0
    told = json.loads((flight / "tasks.json").read_text())
    assert told["elements"] == len(_wall()[0])
    for phase in ("merged", "end phase"):
        assert told["phases"][phase]["plans"] == 1
        assert told["phases"][phase]["tasks"] >= 1
        assert 0.0 < told["phases"][phase]["cpu_ms"]["median_ms"] < 1000.0
    assert "end phase" in capsys.readouterr().out


@pytest.mark.parametrize(("missing", "said"), [("voxels.npz", "has no voxels.npz"), ("surfaces", "no states of the surface")])
def test_missing_parts_of_a_flight_are_named(flight: Path, missing: str, said: str) -> None:
    path = flight / missing
    if path.is_dir():
        for file in path.iterdir():
            file.unlink()
    else:
        path.unlink()
    with pytest.raises(UserError, match=said):
        bench_tasks(flight, None)


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such flight folder"):
        bench_tasks(tmp_path / "nowhere", None)
