from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from uav_recon.clock import ManualClock
from uav_recon.mapping.keyframe_store import KeyframeFolder
from uav_recon.sensors.recorded_camera import RecordedCamera, RecordedPoses
from uav_recon.sensors.recordings.recording import RecordingError
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame, body_from_camera
from uav_recon.types.camera_calibration import CameraCalibration
from uav_recon.types.pose import Pose

MOUNT = body_from_camera(np.array([0.1, 0.0, 0.0]), 0.26)


def _flown(k: int) -> Pose:
    return Pose.from_yaw(0.3 * k, np.array([0.5 * k, 0.0, 1.0])) @ MOUNT


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """Return a flight folder with three keyframes, one second apart."""
    keyframes = KeyframeFolder(tmp_path / "keyframes")
    depth_optics, rgb_optics = Intrinsics(20.0, 21.0, 15.5, 11.5, 32, 24), Intrinsics(10.0, 11.0, 7.5, 3.5, 16, 8)
    rgb_from_depth = Pose.from_yaw(0.0, np.array([0.015, 0.0, 0.0]))
    for k in range(3):
        depth = np.full((24, 32), 1.0 + 0.001 * k, np.float32)
        depth[0, 0] = np.nan
        rgb = np.full((8, 16, 3), (200, 100, 10), np.uint8)
        frame = Frame(700.0 + k, 40 + k, depth, depth_optics, rgb, rgb_optics, rgb_from_depth)
        keyframes.save(PosedFrame(frame, _flown(k)))
    return tmp_path


def test_keyframes_play_back_at_their_recorded_rate(flight: Path) -> None:
    clock = ManualClock(50.0)
    camera = RecordedCamera(flight, clock)
    frames: list[Frame] = []
    for step in range(300):
        clock.advance_to(50.0 + step * 0.01)
        frame = camera.poll()
        frames += [frame] if frame else []
    assert [(frame.sequence, frame.stamp_s) for frame in frames] == [(40, 50.0), (41, 51.0), (42, 52.0)]
    assert np.isnan(frames[1].depth_m[0, 0])
    np.testing.assert_allclose(frames[1].depth_m[1:], 1.001, rtol=1e-6)
    np.testing.assert_allclose(frames[1].rgb[4, 8], [200, 100, 10], atol=4)  # RGB order, with JPEG rounding
    assert frames[1].depth_intrinsics.fy == 21.0
    np.testing.assert_allclose(frames[1].rgb_from_depth.translation_m, [0.015, 0, 0])
    assert camera.imu() == []


def test_depth_has_the_scale_that_the_keyframe_was_corrected_for(tmp_path: Path) -> None:
    lens, depth = Intrinsics(20.0, 21.0, 15.5, 11.5, 32, 24), np.full((24, 32), 2.0, np.float32)
    frame = Frame(7.0, 0, depth, lens, np.zeros((24, 32, 3), np.uint8), lens, Pose.identity())
    KeyframeFolder(tmp_path / "keyframes").save(
        PosedFrame(frame, Pose.identity(), calibration=CameraCalibration(0.0, Pose.identity(), 0.02))
    )
    played = RecordedCamera(tmp_path, ManualClock(0.0)).poll()
    assert played is not None
    np.testing.assert_allclose(played.depth_m, 2.0, atol=0.001)


@pytest.mark.parametrize("scale", [-1.0, -3.0, "nan", None])
def test_a_scale_of_no_camera_is_refused_in_one_line(flight: Path, scale: object) -> None:
    path = flight / "keyframes" / "poses.json"
    tree = json.loads(path.read_text())
    tree["keyframes"][1]["calibration"]["depth_scale"] = scale
    path.write_text(json.dumps(tree))
    with pytest.raises(RecordingError, match="not a keyframe list"):
        RecordedCamera(flight, ManualClock(0.0))


def test_every_keyframe_has_its_pose_and_poses_between_are_interpolated(flight: Path) -> None:
    clock = ManualClock(50.0)
    source = RecordedPoses(flight, clock, MOUNT)
    clock.advance_to(53.0)
    poses = source.poses()
    assert source.poses() == []
    by_stamp = {round(pose.stamp_s, 6): pose for pose in poses}
    for k in range(3):
        expected = _flown(k) @ MOUNT.inverse()
        np.testing.assert_allclose(by_stamp[50.0 + k].odom_from_body.matrix(), expected.matrix(), atol=1e-9)
    gaps_s = np.diff([pose.stamp_s for pose in poses])
    assert 0.03 < gaps_s.min() <= gaps_s.max() < 0.11
    yaws = [pose.odom_from_body.yaw_rad() for pose in poses]
    assert (np.diff(yaws) > 0).all()


def test_a_missing_image_is_left_out_and_counted(flight: Path) -> None:
    (flight / "keyframes" / "0000_rgb.jpg").unlink()
    clock = ManualClock(0.0)
    camera = RecordedCamera(flight, clock)
    assert camera.poll() is None
    clock.advance_to(1.0)
    assert camera.poll() is not None
    assert camera.missing_images == 1


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"keyframes": 3}', '{"keyframes": [{"sequence": 1}]}'])
def test_a_folder_that_is_not_a_flight_is_a_one_line_error(flight: Path, text: str) -> None:
    (flight / "keyframes" / "poses.json").write_text(text)
    with pytest.raises(RecordingError, match=r"poses\.json: (not a keyframe list|is no JSON from line 1,)") as error:
        RecordedCamera(flight, ManualClock())
    assert "\n" not in str(error.value)


def test_a_flight_without_keyframes_is_a_one_line_error(flight: Path) -> None:
    (flight / "keyframes" / "poses.json").write_text('{"keyframes": []}')
    with pytest.raises(RecordingError, match="wants at least one keyframe"):
        RecordedCamera(flight, ManualClock())


def test_images_outside_the_folder_are_not_read(flight: Path) -> None:
    path = flight / "keyframes" / "poses.json"
    (flight / "keyframes" / "0000_rgb.jpg").rename(flight / "0000_rgb.jpg")
    path.write_text(path.read_text().replace('"0000_rgb.jpg"', '"../0000_rgb.jpg"'))
    camera = RecordedCamera(flight, ManualClock(0.0))
    assert camera.poll() is None
    assert camera.missing_images == 1


def test_a_missing_folder_is_a_one_line_error(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"cannot be read \(No such file"):
        RecordedCamera(tmp_path / "absent", ManualClock())
