"""Recording of a camera stream, and its replay."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from recording_folders import HEADER, MOUNT, RGB_FROM_DEPTH, depth_mm, large_rgb, world_from_optical

from uav_recon import config as configuration
from uav_recon.app import camera_sources, pose_sources
from uav_recon.app import record as recording
from uav_recon.app.record import RecordOptions, SensorRecorder
from uav_recon.clock import ManualClock
from uav_recon.config import Config
from uav_recon.errors import UserError
from uav_recon.sensors.recordings.detection import ReadOptions, open_recording
from uav_recon.sensors.recordings.mcap_writer import McapWriter
from uav_recon.sensors.recordings.recording_sources import CameraSource, StreamSource, header_of
from uav_recon.sensors.stream_format import StreamReader, StreamWriter
from uav_recon.types.camera import Frame, ImuSample, Intrinsics
from uav_recon.types.pose import Pose, StampedPose

FLOWN = Path(__file__).parents[2] / "systemd" / "config.toml"


class Stream:
    """A camera stream, and a recorder of it."""

    def __init__(self, folder: Path, max_bytes: int = 10**9, seconds: float = 1e9) -> None:
        self.file = folder / "r.mcap"
        self.camera, self.clock = StreamWriter(folder / "camera.stream", HEADER), ManualClock(50.0)
        self.writer = McapWriter(self.file, HEADER, MOUNT, max_bytes)
        source = StreamSource(StreamReader(folder / "camera.stream"))
        self.recorder = SensorRecorder(source, self.writer, folder, self.clock, seconds)
        self.frames = 0

    def frame(self) -> None:
        stamp_s, pose = self.clock.now_s(), Pose.from_matrix(world_from_optical(self.frames))
        self.camera.write_imu(stamp_s, np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 9.8]))
        self.camera.write_pose(stamp_s, pose.translation_m, pose.quat_wxyz, np.full(6, 1e-4))
        self.camera.write_frame(stamp_s, depth_mm(self.frames), large_rgb(self.frames))
        self.frames += 1

    def step(self, seconds: float) -> None:
        self.clock.advance_to(self.clock.now_s() + seconds)
        self.recorder.step()


def test_every_record_of_the_stream_is_in_the_file_once(tmp_path: Path) -> None:
    stream = Stream(tmp_path)
    for _ in range(8):
        stream.frame()
        stream.step(0.02)
        stream.step(0.02)
    stream.writer.close()
    recorded = open_recording(stream.file, ReadOptions())
    assert (len(list(recorded.frames())), len(recorded.poses()), len(recorded.imu())) == (8, 8, 8)
    assert [frame.stamp_s for frame in recorded.frames()] == pytest.approx(50.0 + 0.04 * np.arange(8), abs=1e-8)
    np.testing.assert_allclose(recorded.poses()[7].odom_from_body.matrix(), world_from_optical(7), atol=1e-9)
    assert "8 frames (25.0/s), 8 inertial samples, 8 poses" in stream.recorder.status()


def test_missed_frames_are_counted(tmp_path: Path) -> None:
    stream = Stream(tmp_path)
    stream.frame()
    stream.step(0.02)
    stream.frame()
    stream.frame()
    stream.step(0.02)
    stream.writer.close()
    assert "1 missed" in stream.recorder.status()


@pytest.mark.parametrize(
    ("options", "wait_s", "said"),
    [({"seconds": 1.0}, 1.1, "--seconds"), ({"max_bytes": 10}, 0.1, "--max-gb"), ({}, 10.1, "silent")],
)
def test_recording_ends(tmp_path: Path, options: dict[str, float], wait_s: float, said: str) -> None:
    stream = Stream(tmp_path, **options)  # type: ignore[arg-type]
    stream.frame()
    stream.step(0.01)
    if said != "--max-gb":
        assert stream.recorder.ended == ""
    stream.step(wait_s)
    stream.writer.close()
    assert said in stream.recorder.ended


def test_a_pose_that_is_no_pose_is_left_out(tmp_path: Path) -> None:
    stream = Stream(tmp_path)
    stream.frame()
    stream.camera.write_pose(50.0, np.full(3, np.nan), np.array([1.0, 0, 0, 0]), np.full(6, 1e-4))
    stream.camera.write_pose(50.0, np.zeros(3), np.zeros(4), np.full(6, 1e-4))
    stream.camera.write_pose(50.0, np.zeros(3), np.array([1.0, 0, 0, 0]), np.full(6, 1e-4), quality=0)
    stream.step(0.01)
    stream.writer.close()
    assert stream.writer.poses == 1


def test_disk_is_never_filled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "FREE_BYTES", 10**18)
    stream = Stream(tmp_path)
    stream.step(0.01)
    stream.writer.close()
    assert "of the disk is free" in stream.recorder.ended


def test_wrong_name_and_existing_file_are_one_line(tmp_path: Path) -> None:
    from rich.console import Console

    (tmp_path / "there.mcap").write_bytes(b"")
    for name, said in (("x.bag", "ends in .mcap"), ("there.mcap", "exists already"), ("no/x.mcap", "no such folder")):
        with pytest.raises(UserError, match=said) as error:
            recording.record(RecordOptions(tmp_path / "c.toml", tmp_path / name), Console(quiet=True), lambda: True)
        assert "\n" not in str(error.value)


class Camera:
    """A camera that is read directly, and a source of poses: each poll() gives a frame, an inertial sample and two poses."""

    def __init__(self, numbers: tuple[int, ...]) -> None:
        self.numbers = list(numbers)
        self.closed = False
        self._samples: list[ImuSample] = []
        self._poses: list[StampedPose] = []

    def poll(self) -> Frame | None:
        if not self.numbers:
            return None
        number = self.numbers.pop(0)
        stamp_s, pose = 50.0 + 0.04 * number, Pose.from_matrix(world_from_optical(number))
        self._samples.append(ImuSample(stamp_s, np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 9.8])))
        self._poses += [StampedPose(stamp_s, pose, np.zeros(3), quality=quality) for quality in (0, 50)]
        metres = 1e-3 * depth_mm(number).astype(np.float32)
        metres[depth_mm(number) == 0] = np.nan
        depth, colour = (Intrinsics(c.fx, c.fy, c.cx, c.cy, c.width, c.height) for c in (HEADER.depth, HEADER.rgb))
        return Frame(stamp_s, number, metres, depth, large_rgb(number), colour, RGB_FROM_DEPTH)

    def imu(self) -> list[ImuSample]:
        given, self._samples = self._samples, []
        return given

    def poses(self) -> list[StampedPose]:
        given, self._poses = self._poses, []
        return given

    def close(self) -> None:
        self.closed = True


def test_a_camera_that_is_read_directly_is_recorded_as_it_is(tmp_path: Path) -> None:
    camera = Camera((0, 1, 4, 5))
    first = camera.poll()
    assert first is not None
    source, writer = CameraSource(camera, camera, first), McapWriter(tmp_path / "r.mcap", header_of(first), MOUNT, 10**9)
    while source.copy_to(writer):
        pass
    source.close()
    writer.close()
    assert camera.closed
    assert source.missed == 2
    recorded = open_recording(tmp_path / "r.mcap", ReadOptions())
    frames = list(recorded.frames())
    assert [frame.stamp_s for frame in frames] == pytest.approx([50.0, 50.04, 50.16, 50.2], abs=1e-8)
    assert (len(recorded.imu()), len(recorded.poses())) == (4, 4), "a pose of quality 0 is none"
    np.testing.assert_allclose(recorded.poses()[3].odom_from_body.matrix(), world_from_optical(5), atol=1e-9)
    known = (depth_mm(5) > 0) & (depth_mm(5) < 65000)
    assert np.array_equal(np.rint(1e3 * frames[3].depth_m[known]), depth_mm(5)[known])
    assert np.isnan(frames[3].depth_m[~known]).all()
    np.testing.assert_allclose(frames[3].rgb_from_depth.matrix(), RGB_FROM_DEPTH.matrix(), atol=1e-6)


def flight_config(folder: Path, poses: str, **camera: float) -> Config:
    tree = configuration.load(FLOWN).model_dump(mode="json", exclude_none=True)
    tree["runtime"]["folder"] = str(folder)
    tree["camera"] |= {"source": "realsense", **camera}
    tree["localization"] |= {"source": poses}
    return configuration.parse(tree, "test")


class FastClock(ManualClock):
    """A clock that is moved by those who sleep."""

    def sleep_until(self, instant_s: float) -> None:
        self.advance_to(instant_s)


@pytest.mark.parametrize(("numbers", "stops_after", "said"), [((), 10**9, "no frame in 10 s"), ((), 5, "stopped")])
def test_a_camera_without_frames_is_one_line_and_released(
    numbers: tuple[int, ...], stops_after: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera, asked = Camera(numbers), itertools.count()
    config = flight_config(tmp_path, "slam", delay_s=0.03)
    opened = list[Config]()

    def open_camera(config: Config, *_: object) -> Camera:
        opened.append(config)
        return camera

    monkeypatch.setattr(camera_sources, "open_camera", open_camera)
    with pytest.raises(UserError, match=said):
        recording.open_source(config, FastClock(50.0), lambda: next(asked) >= stops_after)
    assert camera.closed
    assert opened[0].camera.delay_s == 0.0, "the recording has the camera's stamps, not corrected ones"


@pytest.mark.parametrize(("source", "poses"), [("slam", 0), ("ros2", 1)])
def test_poses_of_the_embedded_slam_are_left_out(
    source: str, poses: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, camera = flight_config(tmp_path, source), Camera((0,))
    monkeypatch.setattr(camera_sources, "open_camera", lambda *_: camera)
    monkeypatch.setattr(pose_sources, "open_poses", lambda context: pose_sources.OpenedPoses(context.camera, camera))
    opened, header = recording.open_source(config, FastClock(50.0), lambda: False)
    writer = McapWriter(tmp_path / "r.mcap", header, MOUNT, 10**9)
    opened.copy_to(writer)
    writer.close()
    assert (writer.frames, writer.poses) == (1, poses)
