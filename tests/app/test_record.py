"""Recording of a camera stream, and its replay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_folders import HEADER, MOUNT, depth_mm, large_rgb, world_from_optical

from uav_recon.app import record as recording
from uav_recon.app.record import RecordOptions, StreamRecorder
from uav_recon.clock import ManualClock
from uav_recon.errors import UserError
from uav_recon.sensors.recordings.detection import ReadOptions, open_recording
from uav_recon.sensors.recordings.mcap_writer import McapWriter
from uav_recon.sensors.stream_format import StreamReader, StreamWriter
from uav_recon.types.pose import Pose


class Stream:
    """A camera stream, and a recorder of it."""

    def __init__(self, folder: Path, max_bytes: int = 10**9, seconds: float = 1e9) -> None:
        self.file = folder / "r.mcap"
        self.camera, self.clock = StreamWriter(folder / "camera.stream", HEADER), ManualClock(50.0)
        self.writer = McapWriter(self.file, HEADER, MOUNT, max_bytes)
        self.recorder = StreamRecorder(StreamReader(folder / "camera.stream"), self.writer, folder, self.clock, seconds)
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
