"""The engines of others: their files are checked, and their answers read in the right direction."""

from __future__ import annotations

import sys
from enum import Enum
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from uav_recon.trackers.cuvslam import CuVslam
from uav_recon.trackers.droid import SHAPES, Droid, check_weights, image_size, keyframe_pose
from uav_recon.trackers.engine import RgbdView, TrackerError
from uav_recon.trackers.orbslam3 import OrbSlam3, check_vocabulary, settings
from uav_recon.types.camera import Intrinsics
from uav_recon.types.pose import Pose

CAMERA = Intrinsics(300.0, 301.0, 211.5, 119.5, 424, 240)
NODE = " ".join(["0", "1", *["7"] * 32, "0.5"])
VOCABULARY = f"10 5 0 0\n{NODE}\n{NODE}\n"


def view(stamp_s: float) -> RgbdView:
    return RgbdView(stamp_s, np.zeros((240, 424, 3), np.uint8), np.full((240, 424), 1.5, np.float32), CAMERA)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (None, "cannot be read"),
        ("", "empty"),
        ("PK binary\n", "not an ORB vocabulary"),
        ("10 5\n" + NODE, "not an ORB vocabulary"),
        ("10 50 0 0\n" + NODE, "not an ORB vocabulary"),
        (VOCABULARY[:-20], "truncated"),
        ("10 5 0 0\n", "truncated"),
    ],
)
def test_a_wrong_vocabulary_is_one_line(tmp_path: Path, text: str | None, fault: str) -> None:
    path = tmp_path / "ORBvoc.txt"
    if text is not None:
        path.write_text(text)
    with pytest.raises(TrackerError, match=fault) as failure:
        check_vocabulary(path)
    assert str(path) in str(failure.value)
    assert "\n" not in str(failure.value)


class State(Enum):
    NO_IMAGES_YET = 0
    NOT_INITIALIZED = 1
    OK = 2
    LOST = 3


class System:
    """As the wheel orbslam3-python 2.0 answered on a rendered sequence: get_frame_pose() is rgb_from_world."""

    def __init__(self, vocabulary: str, file: str, sensor: str) -> None:
        self.settings = Path(file).read_text()
        self.states = [State.OK, State.LOST, State.NO_IMAGES_YET, State.OK]
        self.images: list[Any] = []

    def set_use_viewer(self, on: bool) -> None:
        assert not on

    def initialize(self) -> bool:
        return True

    def process_image_rgbd(self, rgb: Any, depth: Any, stamp_s: float) -> bool:
        self.images.append((rgb.shape, depth.dtype, stamp_s))
        return True

    def get_tracking_state(self) -> State:
        return self.states[len(self.images) - 1]

    def get_frame_pose(self) -> Any:
        return Pose.from_yaw(0.0, np.array([1.0, 0.0, 0.0])).matrix()

    def get_num_matched_features(self) -> int:
        return 60

    def shutdown(self) -> None:
        pass


def test_orbslam3_gives_poses_while_it_tracks_and_another_world_after_it_began_a_new_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "voc").write_text(VOCABULARY)
    wheel = SimpleNamespace(System=System, Sensor=SimpleNamespace(RGBD="rgbd"), TrackingState=State)
    monkeypatch.setitem(sys.modules, "orbslam3", wheel)
    engine = OrbSlam3(tmp_path / "voc", CAMERA)
    tracked = [engine.track(view(float(n))) for n in range(4)]
    assert [len(poses) for poses in tracked] == [1, 0, 0, 1]
    assert [poses[0].world for poses in tracked if poses] == [0, 1]
    assert np.allclose(tracked[0][0].world_from_rgb.translation_m, (-1.0, 0.0, 0.0))
    assert tracked[0][0].quality == 60
    assert "Camera1.fx: 300.0" in engine._system.settings
    assert engine._system.images[0] == ((240, 424, 3), np.float32, 0.0)
    engine.close()


def test_engines_that_are_not_installed_say_how_to_get_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("orbslam3", "cuvslam", "droid"):
        monkeypatch.setitem(sys.modules, name, None)
    (tmp_path / "voc").write_text(VOCABULARY)
    torch.save(random_weights(), tmp_path / "droid.pth")
    with pytest.raises(TrackerError, match="pip install --no-deps orbslam3-python"):
        OrbSlam3(tmp_path / "voc", CAMERA)
    with pytest.raises(TrackerError, match="install NVIDIA's wheel"):
        CuVslam(CAMERA)
    with pytest.raises(TrackerError, match="put droid_slam/ of its checkout on PYTHONPATH"):
        Droid(tmp_path / "droid.pth", CAMERA)


def random_weights(**changes: tuple[int, ...]) -> dict[str, torch.Tensor]:
    """A checkpoint of the right shape: a published one names its tensors "module....", and has three rows in its heads."""
    heads = {"update.weight.2.weight": (3, 128, 3, 3), "update.delta.2.weight": (3, 128, 3, 3)}
    shapes = {**SHAPES, **heads, "fnet.conv1.bias": (32,)} | changes
    return {f"module.{name}": torch.randn(shape) for name, shape in shapes.items()}


def load(path: Path) -> Any:
    return torch.load(path, map_location="cpu", weights_only=True)


def test_a_random_checkpoint_of_the_right_shape_is_accepted_and_every_other_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "droid.pth"
    torch.save(random_weights(), path)
    check_weights(path, load)
    whole = path.read_bytes()
    cases: list[tuple[bytes | dict[str, Any] | None, str]] = [
        (None, "cannot be read"),
        (b"", "not a checkpoint"),
        (whole[: len(whole) // 2], "truncated"),
        (b"<html>" + b"x" * 5000, "truncated, or not a checkpoint"),
        ({"a": torch.zeros(3)}, "fnet.conv1.weight has shape None"),
        (random_weights(**{"cnet.conv2.weight": (128, 128, 1, 1)}), r"cnet.conv2.weight has shape \(128, 128, 1, 1\), want"),
        (random_weights(**{"update.delta.2.weight": (1, 128, 3, 3)}), "update.delta.2.weight"),
    ]
    for content, fault in cases:
        path.unlink(missing_ok=True)
        if isinstance(content, bytes):
            path.write_bytes(content)
        elif content is not None:
            torch.save(content, path)
        with pytest.raises(TrackerError, match=fault) as failure:
            check_weights(path, load)
        assert "\n" not in str(failure.value)


def test_images_for_droid_are_multiples_of_its_cells_and_its_poses_are_turned_round() -> None:
    assert image_size(CAMERA) == (328, 584)
    half = np.sqrt(0.5)
    row = np.array([1.0, 0.0, 0.0, 0.0, 0.0, half, half], dtype=np.float32)  # 90 degrees about z, then 1 m along x
    world_from_rgb = keyframe_pose(row)
    assert np.allclose(world_from_rgb.translation_m, (0.0, 1.0, 0.0), atol=1e-6)
    assert world_from_rgb.yaw_rad() == pytest.approx(-np.pi / 2)


def test_the_settings_scale_the_features_with_the_image() -> None:
    assert "nFeatures: 500" in settings(CAMERA)
    assert "nFeatures: 1000" in settings(Intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480))
