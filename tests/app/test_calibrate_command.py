"""A camera moved by hand is calibrated, and the printed config removes its errors."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rich.console import Console

from uav_recon.app import calibrate_command, camera_sources
from uav_recon.app.calibrate_command import PLOT, CalibrateOptions, calibrate, config_lines
from uav_recon.clock import ManualClock
from uav_recon.config import Config, load, save
from uav_recon.errors import UserError
from uav_recon.sensors.npz_recording import NpzRecording
from uav_recon.sensors.recordings.mcap_writer import McapWriter
from uav_recon.sensors.recordings.recording import LEVEL_MOUNT
from uav_recon.sensors.stream_format import CameraSpec, StreamError, StreamHeader, StreamWriter
from uav_recon.types.camera_calibration import CameraCalibration
from uav_recon.types.pose import Pose

sys.path.append(str(Path(__file__).parents[1] / "localization"))

from textured_room import CAMERA, LENS, depth_of

FLOWN = Path(__file__).parents[2] / "systemd" / "config.toml"
ROOM_M = np.array([[-3.5, -2.5, 0.0], [3.5, 2.5, 2.6]])
CABINET_M = np.array([[1.8, 0.9, 0.0], [2.4, 1.6, 1.9]])
DELAY_S = 0.03
SCALE = 0.012
RGB_LENS = (2.9, 2.6, 1.5, 0.5, 4, 2)
WRONG = Pose.from_rotation_vector(np.array([0.014, -0.010, 0.008]), np.zeros(3))  # nominal_from_true


def _body(t: float) -> Pose:
    """Carried about: up to 0.7 m/s and 0.9 rad/s."""
    yaw = 1.5 * math.sin(0.45 * t) + 0.35 * t
    place = np.array([1.6 * math.sin(0.35 * t), math.sin(0.51 * t + 0.7), 1.2 + 0.35 * math.sin(0.6 * t)])
    return Pose.from_yaw(yaw, place)


def _config(tmp_path: Path, **camera: Any) -> Path:
    config = load(FLOWN)
    path = tmp_path / "config.toml"
    save(config.model_copy(update={"camera": config.camera.model_copy(update=camera)}), path)
    return path


def _wandering(sigma_m: float, sigma_rad: float, seed: int = 1) -> Callable[[float], Pose]:
    """Motions with these deviations per axis, which change within seconds."""
    random = np.random.default_rng(seed)
    rate, phase = random.uniform(0.3, 1.5, (6, 4)), random.uniform(0.0, 2.0 * math.pi, (6, 4))
    scale = np.repeat([sigma_rad, sigma_m], 3) * math.sqrt(2.0 / 4)

    def at(t: float) -> Pose:
        x = scale * np.sin(rate * t + phase).sum(axis=1)
        return Pose.from_rotation_vector(x[:3], x[3:])

    return at


def _recording(
    tmp_path: Path,
    seconds: float,
    body: Callable[[float], Pose] = _body,
    *,
    poses: bool = True,
    scale: float = 0.0,
    wrong: Callable[[float], Pose] = lambda t: Pose.identity(),
) -> Path:
    """Frames at 6 Hz that are DELAY_S older than their stamp, and poses at 30 Hz.

    scale: share by which depth is too large; wrong: error of the poses, in the body.
    """
    nominal = camera_sources.tilted_camera(load(FLOWN))
    stamps_s = 0.2 + np.arange(round(6 * seconds)) / 6
    depth_m = [depth_of(body(t - DELAY_S) @ nominal @ WRONG, ROOM_M, CABINET_M, seed=n) for n, t in enumerate(stamps_s)]
    pose_s = np.arange(round(30 * seconds)) / 30 + (0.0 if poses else 20.0)
    places = [body(t) @ wrong(t) for t in pose_s]
    lens = np.array([*CAMERA, LENS.width, LENS.height])
    path = tmp_path / "hand.npz"
    np.savez(
        path,
        frame_stamp_s=stamps_s,
        depth_mm=np.nan_to_num(1e3 * (1.0 + scale) * np.array(depth_m)).round().astype(np.uint16),
        rgb=np.zeros((len(stamps_s), 2, 4, 3), np.uint8),
        depth_intrinsics=lens,
        rgb_intrinsics=RGB_LENS,
        rgb_from_depth=np.array([1.0, 0, 0, 0, 0, 0, 0]),
        pose_stamp_s=pose_s,
        pose_position_m=np.array([place.translation_m for place in places]),
        pose_quat_wxyz=np.array([place.quat_wxyz for place in places]),
    )
    return path


def _options(tmp_path: Path, recording: Path | None, config: Path, write: Path | None = None) -> CalibrateOptions:
    return CalibrateOptions.of(recording, recording is None, config, 60.0, tmp_path / "out", write)


def test_the_written_config_removes_the_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Scale, yaw of the mount and delay together, with poses that are wrong by 5 mm and 0.2 degrees."""
    wandering = _wandering(0.005, math.radians(0.2))
    recording, written = _recording(tmp_path, 60.0, scale=SCALE, wrong=wandering), tmp_path / "new.toml"
    assert calibrate(_options(tmp_path, recording, _config(tmp_path), written)) == 0
    said = capsys.readouterr().out
    assert "not known" not in said
    assert (tmp_path / "out" / PLOT).stat().st_size > 5000
    found = load(written).camera
    assert found.delay_s == pytest.approx(DELAY_S, abs=0.004)
    assert found.depth_scale == pytest.approx(SCALE, abs=0.003)
    true = camera_sources.tilted_camera(load(FLOWN)) @ WRONG
    off = camera_sources.tilted_camera(load(written)).inverse() @ true
    off_rad = 0.5 * (off.rotation() - off.rotation().T)[[2, 0, 1], [1, 2, 0]]
    assert abs(off_rad[1]) < math.radians(0.15)  # yaw
    assert np.linalg.norm(off_rad) < math.radians(0.25)
    before_mm, after_mm = (float(word) for word in said.split("residuals: ")[1].replace("mm before,", "").split()[:2])
    assert after_mm < 0.85 * before_mm


def test_a_walk_of_some_frames_falls_back_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate(_options(tmp_path, _recording(tmp_path, 2.0), _config(tmp_path))) == 1
    said = capsys.readouterr().out
    assert "too few views" in said
    assert "turn left and right" in said


def test_poses_from_the_depth_images_show_neither_mount_nor_scale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded = calibrate_command._from_recording
    monkeypatch.setattr(calibrate_command, "_from_recording", lambda *given: recorded(*given)._replace(own_poses=True))
    recording = _recording(tmp_path, 12.0, scale=SCALE)
    assert calibrate(_options(tmp_path, recording, _config(tmp_path))) == 1
    said = capsys.readouterr().out
    assert "not known: delay, mount and depth scale: the poses come from the depth images" in said
    assert "depth_scale = 0.0\n" in said
    assert "delay_s = 0.0\n" in said
    assert "not known yet" not in said  # no motion would show it


def test_a_camera_at_rest_is_not_calibrated_and_the_missing_motion_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = _recording(tmp_path, 10.0, lambda t: _body(3.0))
    assert calibrate(_options(tmp_path, recording, _config(tmp_path))) == 1
    said = capsys.readouterr().out
    assert "turn left and right" in said
    assert "delay_s = 0.0\n" in said


def _as_mcap(npz: Path, body_from_depth: Pose) -> Path:
    """The same recording as `uav-recon record` writes it."""
    path = npz.with_suffix(".mcap")
    with np.load(npz) as data:
        fx, fy, cx, cy, width, height = data["depth_intrinsics"].tolist()
        lens, (h, w) = CameraSpec(int(width), int(height), fx, fy, cx, cy), data["rgb"].shape[1:3]
        header = StreamHeader(lens, CameraSpec(w, h, *RGB_LENS[:4]), (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        writer = McapWriter(path, header, body_from_depth, 10**9)
        for stamp_s, place, quat in zip(data["pose_stamp_s"], data["pose_position_m"], data["pose_quat_wxyz"], strict=True):
            writer.write_pose(float(stamp_s), Pose(quat, place), np.full(6, 1e-4))
        for stamp_s, depth_mm, rgb in zip(data["frame_stamp_s"], data["depth_mm"], data["rgb"], strict=True):
            writer.write_frame(float(stamp_s), depth_mm, rgb)
    writer.close()
    return path


def test_a_bag_of_a_flight_gives_what_the_npz_file_gives(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    npz = _recording(tmp_path, 12.0)
    said = []
    for recording in (npz, _as_mcap(npz, camera_sources.tilted_camera(load(FLOWN)))):
        calibrate(_options(tmp_path, recording, _config(tmp_path)))
        said.append(capsys.readouterr().out)
    values = [[float(row.split("│")[2]) for row in text.splitlines() if row.count("│") == 5] for text in said]
    assert len(values[0]) == 9
    limit = np.array([0.003, *[0.08] * 3, *[0.003] * 5])  # rotations in degrees; the views are not the same instants
    assert (np.abs(np.array(values[1]) - np.array(values[0])) < limit).all()
    assert abs(values[0][0]) > 0.005  # the delay has been seen


class FeedingClock(ManualClock):
    """Time passes only while somebody sleeps, and a camera writes its stream meanwhile."""

    def __init__(self, npz: Path, writer: StreamWriter) -> None:
        super().__init__(100.0)
        self._writer = writer
        with np.load(npz) as data:
            self._data = dict(data)
        self._frame = self._pose = 0

    def sleep_until(self, instant_s: float) -> None:
        self.advance_to(instant_s)
        data = self._data
        while self._pose < len(data["pose_stamp_s"]) and 100.0 + data["pose_stamp_s"][self._pose] <= instant_s:
            k, self._pose = self._pose, self._pose + 1
            place, quat = data["pose_position_m"][k], data["pose_quat_wxyz"][k]
            self._writer.write_pose(100.0 + data["pose_stamp_s"][k], place, quat, np.full(6, 1e-5))
        while self._frame < len(data["frame_stamp_s"]) and 100.0 + data["frame_stamp_s"][self._frame] <= instant_s:
            k, self._frame = self._frame, self._frame + 1
            self._writer.write_frame(100.0 + data["frame_stamp_s"][k], data["depth_mm"][k], data["rgb"][k])


def test_a_camera_that_runs_is_calibrated_until_it_is_known_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    npz = _recording(tmp_path, 40.0)
    with np.load(npz) as data:
        fx, fy, cx, cy, width, height = data["depth_intrinsics"].tolist()
    lens = CameraSpec(int(width), int(height), fx, fy, cx, cy)
    header = StreamHeader(lens, CameraSpec(4, 2, *RGB_LENS[:4]), (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    clock = FeedingClock(npz, StreamWriter(tmp_path / "camera.stream", header))
    monkeypatch.setattr("uav_recon.app.calibrate_command.MonotonicClock", lambda: clock)
    config = load(_config(tmp_path, source="stream"))
    save(config.model_copy(update={"runtime": config.runtime.model_copy(update={"folder": tmp_path})}), tmp_path / "live.toml")
    code = calibrate(CalibrateOptions.of(None, True, tmp_path / "live.toml", 38.0, tmp_path / "out", tmp_path / "new.toml"))
    said = capsys.readouterr().out
    assert "turn left and right" in said  # what to do
    assert clock.now_s() == pytest.approx(138.0)  # the filter did not know all of it
    assert code == 0  # all views together do
    assert "not known" not in said
    assert load(tmp_path / "new.toml").camera.delay_s == pytest.approx(DELAY_S, abs=0.01)


def test_a_bag_whose_poses_are_of_the_camera_is_one_line(tmp_path: Path) -> None:
    bag = _as_mcap(_recording(tmp_path, 1.0, poses=False), LEVEL_MOUNT)
    with pytest.raises(UserError, match="no frame with a pose"):
        calibrate(_options(tmp_path, bag, _config(tmp_path)))
    (tmp_path / "scenes").mkdir()
    for name, image in (("depth", np.full((4, 6), 1000, np.uint16)), ("color", np.zeros((4, 6, 3), np.uint8))):
        cv2.imwrite(str(tmp_path / f"scenes/frame-000000.{name}.png"), image)
    np.savetxt(tmp_path / "scenes/frame-000000.pose.txt", np.eye(4))
    with pytest.raises(UserError, match="7-Scenes folder with poses of the camera: want those of the vehicle"):
        calibrate(_options(tmp_path, tmp_path / "scenes", _config(tmp_path)))


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04"])
def test_a_file_that_is_no_recording_is_one_line(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "hand.npz"
    file.write_bytes(content)
    with pytest.raises(UserError, match="not a recording") as error:
        calibrate(_options(tmp_path, file, _config(tmp_path)))
    assert "\n" not in str(error.value)


def test_a_recording_without_fitting_poses_is_one_line(tmp_path: Path) -> None:
    recording = _recording(tmp_path, 3.0, poses=False)
    with pytest.raises(UserError, match="no frame with a pose"):
        calibrate(_options(tmp_path, recording, _config(tmp_path)))


def test_a_gimbal_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="gimbal"):
        calibrate(_options(tmp_path, tmp_path / "hand.npz", _config(tmp_path, mount="gimbal")))


def test_the_options_name_what_is_wrong(tmp_path: Path) -> None:
    for recording, live in ((None, False), (tmp_path / "a.npz", True)):
        with pytest.raises(UserError, match="one of both"):
            CalibrateOptions.of(recording, live, FLOWN, 60.0, tmp_path, None)
    with pytest.raises(UserError, match=r"--seconds 1: want 5 to 600"):
        CalibrateOptions.of(None, True, FLOWN, 1.0, tmp_path, None)


def _lines(config: Config, calibration: CameraCalibration) -> Config:
    camera = config.camera.model_copy(update=config_lines(config, calibration))
    return config.model_copy(update={"camera": camera})


@pytest.mark.parametrize("camera", [{}, {"roll_deg": 2.0, "yaw_deg": -3.0, "pitch_down_deg": -20.0, "delay_s": 0.01}])
def test_the_lines_are_the_true_mount(camera: dict[str, float]) -> None:
    config = load(FLOWN)
    config = config.model_copy(update={"camera": config.camera.model_copy(update=camera)})
    calibration = CameraCalibration(0.02, Pose.from_rotation_vector(np.array([0.02, -0.03, 0.01]), np.full(3, 0.01)), 0.01)
    true = camera_sources.tilted_camera(config) @ calibration.nominal_from_true
    calibrated = _lines(config, calibration)
    np.testing.assert_allclose(camera_sources.tilted_camera(calibrated).matrix(), true.matrix(), atol=3e-4)
    assert calibrated.camera.delay_s == pytest.approx(config.camera.delay_s + 0.02)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("frame_stamp_s", [0.0, 1e9], "gap of 1e\\+09 s after 0.000 s"),
        ("frame_stamp_s", [0.0, np.inf], "not finite"),
        ("pose_stamp_s", 3.0, "of shape \\(\\); want"),
        ("depth_mm", np.zeros((1, 48, 64), np.uint16), "of shape \\(1, 48, 64\\); want uint16 of shape \\(2, 48, 64\\)"),
        ("depth_mm", np.full((2, 48, 64), -1), "is int64 of shape"),
        ("rgb", np.zeros((2, 48, 64), np.uint8), "want uint8 of shape"),
        ("depth_intrinsics", [60.0, 60, 32, 24, 64, 0], "want fx fy cx cy width height"),
        ("rgb_from_depth", np.zeros(3), "want float64 of shape \\(7,\\)"),
        ("pose_quat_wxyz", np.zeros((2, 4)), "without a direction"),
        ("pose_position_m", np.full((2, 3), np.nan), "not finite"),
        ("imu_stamp_s", [0.0, 1.0], "is missing"),
        ("frame_stamp_s", np.array([None, None]), "Object arrays cannot be loaded"),
    ],
)
def test_a_damaged_array_is_one_line_that_names_file_and_array(tmp_path: Path, name: str, value: Any, said: str) -> None:
    lens, stamps_s = [60.0, 60, 32, 24, 64, 48], [0.0, 0.1]
    arrays: dict[str, Any] = {
        "frame_stamp_s": stamps_s, "depth_mm": np.zeros((2, 48, 64), np.uint16), "rgb": np.zeros((2, 2, 4, 3), np.uint8),
        "depth_intrinsics": lens, "rgb_intrinsics": lens, "rgb_from_depth": [1.0, 0, 0, 0, 0, 0, 0], "pose_stamp_s": stamps_s,
        "pose_position_m": np.zeros((2, 3)), "pose_quat_wxyz": [[1.0, 0, 0, 0]] * 2,
    }  # fmt: skip
    file = tmp_path / "hand.npz"
    np.savez(file, **arrays)
    NpzRecording(file, ManualClock(), 0.3, 6.0)
    np.savez(file, **(arrays | {name: value}))
    where = "gyro_radps" if name == "imu_stamp_s" else name
    with pytest.raises(StreamError, match=rf"hand\.npz: {where}: .*{said}") as error:
        NpzRecording(file, ManualClock(), 0.3, 6.0)
    assert "\n" not in str(error.value)


def test_a_pose_long_after_the_last_frame_does_not_lengthen_the_calibration(tmp_path: Path) -> None:
    npz = _recording(tmp_path, 2.0)
    with np.load(npz) as data:
        arrays = dict(data)
    arrays["pose_stamp_s"][-1] = 1e6
    np.savez(npz, **arrays)
    path = _as_mcap(npz, camera_sources.tilted_camera(load(FLOWN)))
    source = calibrate_command._open_recording(path, None, load(FLOWN), ManualClock(-math.inf), Console(quiet=True))
    assert source.end_s - source.begin_s < 4.0


def test_the_depth_unit_counts_for_an_npz_file_too(tmp_path: Path) -> None:
    npz = _recording(tmp_path, 1.0)
    plain, halved = (NpzRecording(npz, ManualClock(1e9), 0.3, 20.0, unit).poll() for unit in (None, 0.0005))
    assert plain is not None
    assert halved is not None
    both = np.isfinite(plain.depth_m) & np.isfinite(halved.depth_m)
    assert both.any()
    np.testing.assert_allclose(halved.depth_m[both], plain.depth_m[both] / 2, rtol=1e-5)
