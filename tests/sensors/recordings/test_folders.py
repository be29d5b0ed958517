"""Readers of TUM and 7-Scenes folders against files that the test writes itself."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from recording_folders import K, depth_mm, rgb, world_from_optical, write_seven_scenes, write_tum

from uav_recon.clock import ManualClock
from uav_recon.sensors.recordings.detection import ReadOptions, open_recording
from uav_recon.sensors.recordings.frame_stamps import require_increasing
from uav_recon.sensors.recordings.recording import DepthUnit, PlaybackCamera, PlaybackPoses, Recording, RecordingError
from uav_recon.sensors.recordings.seven_scenes_folder import DEFAULT_K, SevenScenesFolder
from uav_recon.sensors.recordings.tum_folder import CALIBRATIONS, TumFolder
from uav_recon.types.pose import Pose


def opened(folder: Path, options: ReadOptions | None = None) -> Recording:
    return open_recording(folder, options or ReadOptions())


@pytest.fixture(params=[write_seven_scenes, write_tum])
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Recording:
    request.param(tmp_path / "r", 3)
    return opened(tmp_path / "r", ReadOptions(k=K))


def test_depth_in_metres_without_zero_and_65535(recording: Recording) -> None:
    for number, frame in enumerate(recording.frames()):
        wanted = depth_mm(number).astype(float) * 0.001
        wanted[0, 0] = wanted[0, 1] = np.nan  # 65535 x 5 units of TUM overflow to 13.1 m, beyond the range
        np.testing.assert_allclose(frame.depth_m, wanted, atol=1e-6)
        assert (frame.depth_intrinsics.fx, frame.depth_intrinsics.cy) == (K[0], K[3])
    assert number == 2


def test_largest_raw_depth_is_no_return_in_any_unit() -> None:
    unit = DepthUnit(1 / 5000)
    raw = np.array([[0, 65534, 65535, 5000]], np.uint16)
    np.testing.assert_allclose(unit.metres(raw), [[np.nan, 65534 / 5000, np.nan, 1.0]], rtol=1e-6)


def test_colour_is_rgb(recording: Recording) -> None:
    np.testing.assert_array_equal(list(recording.frames())[2].rgb, rgb(2))


def test_camera_pose_is_body_pose_and_mount(recording: Recording) -> None:
    mount = recording.info.body_from_depth
    for number, pose in enumerate(recording.poses()):
        np.testing.assert_allclose((pose.odom_from_body @ mount).matrix(), world_from_optical(number), atol=1e-9)


def test_level_mount_looks_along_x(recording: Recording) -> None:
    np.testing.assert_allclose(recording.info.body_from_depth.rotation() @ (0, 0, 1), (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(recording.info.body_from_depth.rotation() @ (0, -1, 0), (0, 0, 1), atol=1e-12)


def test_frames_are_thirty_a_second(recording: Recording) -> None:
    stamps_s = [frame.stamp_s for frame in recording.frames()]
    np.testing.assert_allclose(np.diff(stamps_s), 1 / 30, atol=1e-5)
    assert [frame.sequence for frame in recording.frames(step=2)] == [0, 2]
    assert recording.info.frames == 3


def test_playback_gives_each_frame_once_when_due(recording: Recording) -> None:
    clock = ManualClock(50.0)
    camera, given = PlaybackCamera(recording, clock), []
    poses = PlaybackPoses(recording, clock, camera.shift_s, Pose.identity())
    due = []
    for tick in range(12):
        clock.advance_to(50.0 + 0.01 * tick)
        frame = camera.poll()
        if frame is not None:
            assert frame.stamp_s <= clock.now_s() + 1e-9
            given.append(frame.stamp_s)
        due += [pose.stamp_s for pose in poses.poses()]
        assert all(stamp_s <= clock.now_s() + 1e-9 for stamp_s in due)
    np.testing.assert_allclose(given, 50.0 + np.arange(3) / 30, atol=1e-5)
    np.testing.assert_allclose(due, given, atol=1e-9)
    assert camera.finished
    assert camera.read == 3


def test_frame_without_pose_file_has_no_pose(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, 3)
    (tmp_path / "frame-000001.pose.txt").unlink()
    (tmp_path / "frame-000002.pose.txt").write_text("0 " * 16)
    assert len(opened(tmp_path).poses()) == 1
    assert len(list(opened(tmp_path).frames())) == 3


def test_depth_without_near_colour_is_skipped(tmp_path: Path) -> None:
    write_tum(tmp_path / "r", 3)
    lines = (tmp_path / "r/rgb.txt").read_text().splitlines()
    (tmp_path / "r/rgb.txt").write_text("\n".join(lines[:-1]))
    assert [frame.sequence for frame in opened(tmp_path / "r").frames()] == [0, 1]


def test_listed_images_that_are_missing_are_counted(tmp_path: Path) -> None:
    write_tum(tmp_path / "r", 4)
    sorted((tmp_path / "r/depth").iterdir())[1].unlink()
    sorted((tmp_path / "r/rgb").iterdir())[2].unlink()
    recording = opened(tmp_path / "r")
    stamps_s = [frame.stamp_s for frame in recording.frames()]
    np.testing.assert_allclose(stamps_s, (100.0, 100.1), atol=1e-5)
    assert dict(recording.info.skipped) == {"images listed but missing": 2, "depth images without colour": 1}


def test_tum_without_poses(tmp_path: Path) -> None:
    write_tum(tmp_path / "r", 2, poses=False)
    assert opened(tmp_path / "r").poses() == []


def one_line(folder: Path) -> str:
    with pytest.raises(RecordingError) as error:
        recording = opened(folder)
        recording.poses()
        list(recording.frames())
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("depth.txt", "yesterday depth/a.png\n", "want a stamp in seconds and a file name"),
        ("depth.txt", "1.0 ../../etc/passwd\n", "leads out of the folder"),
        ("depth.txt", "# nothing\n", "has no depth frame"),
        (
            "depth.txt",
            "100.0 depth/1.png\n100.1 depth/2.png\n",
            "depth.txt: none of its 2 images exists, the first: depth/1.png",
        ),
        ("rgb.txt", "# nothing\n", "depth.txt is 100.000 to 100.033 s, rgb.txt is empty"),
        ("groundtruth.txt", "1 2 3\n", "want 8 numbers"),
        ("groundtruth.txt", "1 nan 3 4 0 0 0 1\n", "want 8 numbers"),
        ("camera-intrinsics.txt", "1 2 3\n", "want a matrix of 3 x 3 numbers"),
        ("camera-intrinsics.txt", "0 0 1 0 5 1 0 0 1\n", "must be positive"),
    ],
)
def test_wrong_tum_folder_is_one_line(tmp_path: Path, name: str, text: str, said: str) -> None:
    write_tum(tmp_path / "r", 2)
    (tmp_path / "r" / name).write_text(text)
    assert said in one_line(tmp_path / "r")


@pytest.mark.parametrize("kept", [0, 20])
@pytest.mark.parametrize("kind", ["depth", "color"])
def test_a_damaged_image_is_left_out_and_counted(
    tmp_path: Path, kind: str, kept: int, capfd: pytest.CaptureFixture[str]
) -> None:
    write_seven_scenes(tmp_path, 3)
    image = tmp_path / f"frame-000001.{kind}.png"
    image.write_bytes(image.read_bytes()[:kept])
    recording = opened(tmp_path)
    for _ in range(2):
        assert [frame.sequence for frame in recording.frames()] == [0, 2]
        ((reason, count),) = recording.info.skipped
        assert (image.name in reason, count) == (True, 1)
    assert capfd.readouterr() == ("", ""), "nothing of a library is printed"


def test_a_folder_of_damaged_images_is_one_line(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, 2)
    for number in range(2):
        shutil.copy(tmp_path / f"frame-00000{number}.color.png", tmp_path / f"frame-00000{number}.depth.png")
    said = one_line(tmp_path)
    assert "none of 2 frames can be read, the first:" in said
    assert "frame-000000.depth.png: is an image of mode RGB; want a 16-bit grey PNG" in said


def test_other_things_say_what_was_found_and_what_is_wanted(tmp_path: Path) -> None:
    assert "does not exist" in one_line(tmp_path / "nowhere")
    assert "an empty folder; want a flight folder" in one_line(tmp_path)
    (tmp_path / "holiday.jpg").write_bytes(b"\xff\xd8\xff\xe0jpeg")
    assert "a folder with holiday.jpg" in one_line(tmp_path)
    assert "a file that begins with" in one_line(tmp_path / "holiday.jpg")
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(20))
    assert "a ROS 1 bag" in one_line(tmp_path / "old.bag")


@pytest.mark.parametrize(
    ("stamps_s", "said"),
    [
        ([2.0, 2.1, 1.7e9], r"gap of 1.7e\+09 s after 2.100 s; want at most 600 s"),
        ([float("nan")], "the first stamp is nan"),
        ([2.0, 2.0], "stamps must increase"),
        ([], "has no depth frame"),
    ],
)
def test_stamps_increase_without_a_jump_of_the_clock(stamps_s: list[float], said: str) -> None:
    with pytest.raises(RecordingError, match=f"walk: {said}"):
        require_increasing(Path("walk"), stamps_s)


def test_frames_without_leading_zeros_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, 12)
    for file in list(tmp_path.glob("frame-*")):
        number, kind = file.name.removeprefix("frame-").split(".", 1)
        file.rename(tmp_path / f"frame-{int(number)}.{kind}")
    assert [frame.sequence for frame in opened(tmp_path).frames()] == list(range(12))


def test_a_mirrored_pose_is_no_pose(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, 2)
    np.savetxt(tmp_path / "frame-000001.pose.txt", np.diag([1.0, -1.0, 1.0, 1.0]))
    assert len(opened(tmp_path).poses()) == 1


def test_a_tum_pose_without_a_rotation_is_skipped_and_counted(tmp_path: Path) -> None:
    write_tum(tmp_path / "r", 3)
    file = tmp_path / "r/groundtruth.txt"
    head, _, *rest = file.read_text().splitlines()
    file.write_text("\n".join((head, "100 0 0 0 0 0 0 0", *rest)))
    recording = opened(tmp_path / "r")
    assert len(recording.poses()) == 2
    assert dict(recording.info.skipped) == {"poses without a rotation": 1}


def test_what_the_system_refuses_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.mcap").mkdir()
    assert one_line(tmp_path) == f"{tmp_path / 'a.mcap'}: cannot be read (Is a directory)"
    assert one_line(tmp_path / ("x" * 300)).endswith(": cannot be read (File name too long)")
    (tmp_path / "b.mcap").touch()

    def refused(path: Path, *_: object) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", refused)
    assert one_line(tmp_path / "b.mcap") == f"{tmp_path / 'b.mcap'}: cannot be read (Permission denied)"


def test_the_camera_of_a_tum_folder_is_known_by_its_name_and_its_distortion_taken_out(tmp_path: Path) -> None:
    """Straight lines of the room are bent in the image by the lens; they are straight in the frame."""
    folder = tmp_path / "rgbd_dataset_freiburg1_desk"
    write_tum(folder, 1)
    (fx, fy, cx, cy), distortion = CALIBRATIONS["freiburg1"]
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    across = np.column_stack((np.linspace(-0.4, 0.4, 60), np.full(60, -0.3), np.ones(60)))
    bent, _ = cv2.projectPoints(across, np.zeros(3), np.zeros(3), matrix, np.array(distortion))
    image, depth = np.zeros((480, 640, 3), np.uint8), np.full((480, 640), 10000, np.uint16)
    cv2.polylines(image, [np.rint(bent).astype(np.int32)], False, (255, 255, 255), 2)
    for file, content in zip([*folder.glob("rgb/*.png"), *folder.glob("depth/*.png")], (image, depth), strict=True):
        cv2.imwrite(str(file), content)
    frame = next(TumFolder(folder, None).frames())
    assert (frame.depth_intrinsics.fx, frame.rgb_intrinsics.cy) == (fx, cy)
    row, column = np.nonzero(frame.rgb[..., 0] > 128)
    inside = (column > cx - 0.3 * fx) & (column < cx + 0.3 * fx)
    assert inside.sum() > 200
    np.testing.assert_allclose(row[inside], cy - 0.3 * fy, atol=2.0)
    assert np.abs(bent[:, 0, 1] - (cy - 0.3 * fy)).max() > 2.0, "the image is bent by more"
    own = next(TumFolder(folder, K).frames())
    assert own.depth_intrinsics.fx == K[0], "what the user says counts"


def test_the_colour_of_seven_scenes_is_that_of_another_camera(tmp_path: Path) -> None:
    """Its depth camera is named by its authors, its colour camera is a Kinect's; other folders hold registered colour."""
    write_seven_scenes(tmp_path, 1)
    registered = next(SevenScenesFolder(tmp_path, None).frames())
    assert registered.rgb_intrinsics.fx == K[0]
    np.testing.assert_array_equal(registered.rgb_from_depth.translation_m, np.zeros(3))
    raw = next(SevenScenesFolder(tmp_path, DEFAULT_K).frames())
    assert (raw.depth_intrinsics.fx, raw.rgb_intrinsics.fx) == (585.0, 525.0)
    np.testing.assert_allclose(raw.rgb_from_depth.translation_m, [-0.025, 0.0, 0.0])
