"""Replay of tiny recordings end to end, and the first look at a recording."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from uav_recon.app.recording_survey import floor_normal, survey_recording
from uav_recon.app.replay import POSES, ReplayOptions, replay, replay_config
from uav_recon.errors import UserError
from uav_recon.sensors.recordings.detection import ReadOptions, open_recording
from uav_recon.sensors.recordings.recording import PlaybackCamera, RecordingError
from uav_recon.types.camera import body_from_camera
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

WIDTH, HEIGHT, F = 160, 120, 120.0
K = (F, F, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
HALF_M = np.array([2.5, 2.0, 1.2])  # of the room, a box around the origin
FRAMES = 45


def camera_pose(number: int, pitch_rad: float = 0.2) -> Pose:
    """Return world_from_depth: forward and sideways at 0.3 m/s, slowly turning."""
    t = number / 30.0
    body = Pose.from_yaw(0.3 * t, np.array([-0.5 + 0.3 * t, 0.1 * math.sin(t), 0.0]))
    return body @ body_from_camera(np.zeros(3), pitch_rad)


def depth_of_box(world_from_depth: Pose) -> FloatArray:
    """Return depth (H, W) along the optical axis of the box's inner walls."""
    v, u = np.indices((HEIGHT, WIDTH))
    bearings = np.stack([(u - K[2]) / F, (v - K[3]) / F, np.ones_like(u, float)], axis=-1)
    rays = bearings @ world_from_depth.rotation().T
    with np.errstate(divide="ignore"):
        far = np.where(rays > 0, (HALF_M - world_from_depth.translation_m) / rays,
                       (-HALF_M - world_from_depth.translation_m) / rays)  # fmt: skip
    return np.asarray(far.min(axis=-1))


def write_recording(folder: Path, source_from_world: Pose, *, jump_m: float = 0.0) -> None:
    folder.mkdir()
    fx, fy, cx, cy = K
    np.savetxt(folder / "camera-intrinsics.txt", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]))
    for number in range(FRAMES):
        pose = camera_pose(number)
        depth_mm = np.rint(depth_of_box(pose) * 1000).astype(np.uint16)
        cv2.imwrite(str(folder / f"frame-{number:06d}.depth.png"), depth_mm)
        rng = np.random.default_rng(number)
        cv2.imwrite(str(folder / f"frame-{number:06d}.color.png"), rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8))
        said = (source_from_world @ pose).matrix()
        said[0, 3] += jump_m if number > FRAMES // 2 else 0.0
        np.savetxt(folder / f"frame-{number:06d}.pose.txt", said)


SOURCE_FROM_WORLD = Pose(np.array([0.9, 0.3, -0.25, 0.2]), np.array([3.0, -1.0, 7.0]))


def run(tmp_path: Path, **options: object) -> dict[str, object]:
    wanted = ReplayOptions(tmp_path / "r", tmp_path / "out", mapper="none", **options)  # type: ignore[arg-type]
    assert replay(wanted, Console(quiet=True)) == 0
    return dict(json.loads((tmp_path / "out/replay.json").read_text()))


def test_replay_of_a_rendered_room(tmp_path: Path) -> None:
    write_recording(tmp_path / "r", SOURCE_FROM_WORLD)
    summary = run(tmp_path)
    assert (summary["frames_read"], summary["frames_used"], summary["refused"]) == (FRAMES, FRAMES, {})
    assert (summary["drift_alarms"], summary["lost_s"], summary["imu_samples"]) == (0, 0.0, 0)
    assert 3.0 < float(str(summary["explored_m3"])) < 24.0 * 1.2
    for name in ("report.html", "report.json", "config.toml", "voxels.npz", "timeline.jsonl", "trajectory.txt"):
        assert (tmp_path / "out" / name).is_file(), name
    written = np.loadtxt(tmp_path / "out/trajectory.txt")
    assert written.shape == (FRAMES, 8)
    for row in written:
        wanted = SOURCE_FROM_WORLD @ camera_pose(round(row[0] * 30))
        found = Pose(row[[7, 4, 5, 6]], row[1:4])
        assert np.linalg.norm(found.translation_m - wanted.translation_m) < 0.01  # in the recording's own frame
        assert abs(found.quat_wxyz @ wanted.quat_wxyz) > math.cos(0.01 / 2)


def test_what_is_left_out_and_a_wrong_unit_are_in_the_results(tmp_path: Path) -> None:
    write_recording(tmp_path / "r", SOURCE_FROM_WORLD)
    (tmp_path / "r/frame-000007.depth.png").write_bytes(b"")
    (tmp_path / "r/frame-000008.color.png").unlink()
    console = Console(file=io.StringIO(), width=80)
    options = ReplayOptions(tmp_path / "r", tmp_path / "out", ReadOptions(metres_per_unit=0.0011), mapper="none")
    assert replay(options, console) == 0
    summary = json.loads((tmp_path / "out/replay.json").read_text())
    assert summary["frames_read"] == FRAMES - 2
    ((reason, count),) = summary["skipped"].items()
    assert ("frame-000007.depth.png: has no bytes" in reason, count) == (True, 2)
    (remark,) = summary["remarks"]
    assert remark.endswith(" of its unit: --depth-unit 0.001 (it was read with 0.0011)")
    assert f"note: {remark}\n" in console.file.getvalue()  # type: ignore[attr-defined]


def test_floor_of_the_room_is_level(tmp_path: Path) -> None:
    write_recording(tmp_path / "r", SOURCE_FROM_WORLD)
    survey = survey_recording(open_recording(tmp_path / "r", ReadOptions()), "auto", use_poses=True)
    world_from_odom = (survey.odom_from_source @ SOURCE_FROM_WORLD).inverse()
    np.testing.assert_allclose(world_from_odom.rotation() @ (0, 0, 1), (0, 0, 1), atol=0.01)
    np.testing.assert_allclose(world_from_odom.translation_m, (*camera_pose(0).translation_m[:2], -HALF_M[2]), atol=0.02)
    assert survey.box_min_m[2] == pytest.approx(-0.3, abs=0.1)
    assert 1.5 < survey.box_max_m[2] < 2 * HALF_M[2] + 0.4  # the camera looks down: not all of the ceiling is seen


def test_pose_jump_is_reported(tmp_path: Path) -> None:
    write_recording(tmp_path / "r", SOURCE_FROM_WORLD, jump_m=0.5)
    summary = run(tmp_path)
    refused, used = summary["refused"], summary["frames_used"]
    assert refused or int(str(used)) < FRAMES


def test_recording_without_poses_names_slam(tmp_path: Path) -> None:
    write_recording(tmp_path / "r", SOURCE_FROM_WORLD)
    for pose in (tmp_path / "r").glob("*.pose.txt"):
        pose.unlink()
    with pytest.raises(UserError, match="7-Scenes folder without poses; --pose slam") as error:
        replay(ReplayOptions(tmp_path / "r", tmp_path / "out"), Console(quiet=True))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("pose", POSES)
def test_each_source_of_poses_gives_a_config_that_can_be_used(tmp_path: Path, pose: str) -> None:
    write_recording(tmp_path / "r", SOURCE_FROM_WORLD)
    recording = open_recording(tmp_path / "r", ReadOptions())
    survey = survey_recording(recording, "auto", use_poses=pose == "recording")
    config = replay_config(ReplayOptions(tmp_path / "r", tmp_path / "out", pose=pose), recording, survey)
    assert config.localization.source == {"recording": "stream"}.get(pose, pose)


@pytest.mark.parametrize(("name", "value"), [("pose", "gps"), ("mapper", "magic"), ("up", "down")])
def test_wrong_options_are_one_line(tmp_path: Path, name: str, value: str) -> None:
    with pytest.raises(UserError, match=f"--{name} {value}: want one of"):
        replay(ReplayOptions(tmp_path, tmp_path / "out", **{name: value}), Console(quiet=True))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["report.json", "config.toml", "keyframes"])
def test_results_are_not_overwritten(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    with pytest.raises(UserError, match=f"already contains {name}"):
        replay(ReplayOptions(tmp_path / "r", tmp_path), Console(quiet=True))


def test_a_recording_is_not_its_own_output(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="is the recording itself"):
        replay(ReplayOptions(tmp_path, tmp_path / "." / ""), Console(quiet=True))


@pytest.mark.parametrize("text", ["", '{"keyframes": []}', '{"keyframes": [{"world_from_depth": {}, "sequence": Infinity}]}'])
def test_a_damaged_flight_folder_is_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "r").mkdir()
    (tmp_path / "r/poses.json").write_text(text)
    with pytest.raises(UserError, match=r"poses\.json: ") as error:
        replay(ReplayOptions(tmp_path / "r", tmp_path / "out"), Console(quiet=True))
    assert "\n" not in str(error.value)


def test_a_recording_without_depth_within_the_range_is_one_line(tmp_path: Path) -> None:
    write_recording(tmp_path / "r", SOURCE_FROM_WORLD)
    read = ReadOptions(depth_min_m=15.0, depth_max_m=20.0)
    with pytest.raises(UserError, match="no depth within --depth-range"):
        replay(ReplayOptions(tmp_path / "r", tmp_path / "out", read), Console(quiet=True))


@settings(max_examples=50, deadline=None)
@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.integers(0, 1000))
def test_floor_normal_among_walls_and_clutter(roll_rad: float, pitch_rad: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    floor = np.tile((0.0, 0.0, 1.0), (400, 1)) * rng.choice([-1, 1], (400, 1)) + rng.normal(0, 0.02, (400, 3))
    walls = np.tile((1.0, 0.0, 0.0), (600, 1)) + rng.normal(0, 0.02, (600, 3))
    clutter = rng.normal(0, 1, (200, 3))
    normals = np.concatenate([floor, walls, clutter])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    start = np.array([math.sin(pitch_rad), math.sin(roll_rad) * math.cos(pitch_rad), math.cos(roll_rad) * math.cos(pitch_rad)])
    assert floor_normal(normals, start)[2] > math.cos(math.radians(1.5))


@pytest.mark.parametrize("failure", [RecordingError("r: damaged"), KeyboardInterrupt()])
def test_a_replay_that_failed_can_be_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException) -> None:
    write_recording(tmp_path / "r", SOURCE_FROM_WORLD)
    polls: list[int] = []

    def fails_late(camera: PlaybackCamera) -> None:
        polls.append(len(polls))
        if len(polls) > 20:
            assert (tmp_path / "out/timeline.jsonl").exists()
            raise failure

    with monkeypatch.context() as patch:
        patch.setattr(PlaybackCamera, "poll", fails_late)
        with pytest.raises((UserError, KeyboardInterrupt)):
            run(tmp_path)
    assert not {"config.toml", "timeline.jsonl"} & {path.name for path in (tmp_path / "out").iterdir()}
    assert run(tmp_path)["frames_used"] == FRAMES
