from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uav_recon.clock import ManualClock
from uav_recon.sensors.stream_camera import StreamCamera, StreamPoses, depth_lookup_table, open_stream
from uav_recon.sensors.stream_format import HEADER, POSE_SLOTS, CameraSpec, StreamError, StreamHeader, StreamWriter

HEADER_OF = StreamHeader(
    CameraSpec(16, 12, 10.0, 11.0, 7.5, 5.5), CameraSpec(8, 6, 5.0, 5.5, 3.5, 2.5), (1.0, 0.0, 0.0, 0.0, 0.015, 0.0, 0.001)
)
RGB = np.arange(8 * 6 * 3, dtype=np.uint8).reshape(6, 8, 3)


def _depth(value: int) -> np.ndarray[tuple[int, int], np.dtype[np.uint16]]:
    return np.full((12, 16), value, np.uint16)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "camera.stream"


@pytest.fixture
def writer(path: Path) -> StreamWriter:
    return StreamWriter(path, HEADER_OF)


def test_a_frame_arrives_as_it_was_written_once(path: Path, writer: StreamWriter) -> None:
    camera = StreamCamera(path)
    assert camera.poll() is None
    depth = _depth(2000)
    depth[0, :5] = (0, 299, 300, 6000, 6001)
    writer.write_frame(5.25, depth, RGB)
    frame = camera.poll()
    assert frame is not None
    assert (frame.stamp_s, frame.sequence) == (5.25, 1)
    np.testing.assert_array_equal(np.isnan(frame.depth_m[0, :5]), [True, True, False, False, True])  # no return, near, far
    np.testing.assert_allclose(frame.depth_m[1:], 2.0)
    assert frame.depth_m.dtype == np.float32
    np.testing.assert_array_equal(frame.rgb, RGB)
    assert (frame.depth_intrinsics.fy, frame.depth_intrinsics.cx, frame.rgb_intrinsics.width) == (11.0, 7.5, 8)
    np.testing.assert_allclose(frame.rgb_from_depth.translation_m, [0.015, 0.0, 0.001])
    assert camera.poll() is None


def test_only_the_newest_frame_is_handed_out(path: Path, writer: StreamWriter) -> None:
    camera = StreamCamera(path)
    for k in range(6):
        writer.write_frame(1.0 + k, _depth(1000 + k), RGB)
    frame = camera.poll()
    assert frame is not None
    assert frame.sequence == 6
    assert camera.poll() is None


@pytest.mark.parametrize("stamp_s", [2.0, 1.5, float("nan"), float("inf")])
def test_wrong_stamps_are_dropped_and_counted(path: Path, writer: StreamWriter, stamp_s: float) -> None:
    camera = StreamCamera(path)
    writer.write_frame(2.0, _depth(1000), RGB)
    assert camera.poll() is not None
    writer.write_frame(stamp_s, _depth(1000), RGB)
    assert camera.poll() is None
    assert camera.dropped_frames == 1
    writer.write_frame(2.1, _depth(1000), RGB)
    assert camera.poll() is not None


def test_a_time_stamp_in_the_future_loses_at_most_two_frames(path: Path, writer: StreamWriter) -> None:
    camera, got = StreamCamera(path), []
    for k in range(30):
        writer.write_frame(100.0 + k / 15 if k != 10 else 1e6, _depth(1000), RGB)
        frame = camera.poll()
        got += [k] if frame is not None and frame.stamp_s < 1e6 else []
    assert got == [*range(10), *range(12, 30)]
    assert camera.dropped_frames == 1


def test_inertial_samples_come_once_and_in_order(path: Path, writer: StreamWriter) -> None:
    camera = StreamCamera(path)
    for k in range(7):
        writer.write_imu(k * 0.005, np.array([k, 0.0, 0.0]), np.array([0.0, 0.0, 9.8]))
    samples = camera.imu()
    assert [sample.gyro_radps[0] for sample in samples] == list(range(7))
    assert samples[3].stamp_s == 0.015
    assert camera.imu() == []


def test_poses_keep_stamp_variance_and_counters(path: Path, writer: StreamWriter) -> None:
    source = StreamPoses(path)
    variance = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e-4
    writer.write_pose(3.5, np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 0.0, 0.0]), variance, quality=80, reset_counter=257)
    (pose,) = source.poses()
    assert (pose.stamp_s, pose.quality, pose.reset_counter) == (3.5, 80, 1)
    np.testing.assert_array_equal(pose.covariance, np.diag(variance))
    np.testing.assert_array_equal(pose.odom_from_body.translation_m, [1.0, 2.0, 3.0])
    assert source.poses() == []


@pytest.mark.parametrize(
    ("position", "quat", "variance"),
    [
        ([np.nan, 0, 0], [1, 0, 0, 0], 1e-4),
        ([0, 0, 0], [1, 0, np.nan, 0], 1e-4),
        ([0, 0, 0], [0, 0, 0, 0], 1e-4),
        ([0, 0, 0], [0.9, 0, 0, 0], 1e-4),
        ([0, np.inf, 0], [1, 0, 0, 0], 1e-4),
        ([0, 0, 0], [1, 0, 0, 0], -1e-4),
        ([0, 0, 0], [1, 0, 0, 0], np.nan),
    ],
)
def test_invalid_poses_are_refused(
    path: Path, writer: StreamWriter, position: list[float], quat: list[float], variance: float
) -> None:
    source = StreamPoses(path)
    writer.write_pose(1.0, np.array(position), np.array(quat), np.full(6, variance))
    writer.write_pose(1.1, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.full(6, 1e-4))
    assert [pose.stamp_s for pose in source.poses()] == [1.1]
    assert source.refused == 1


def test_a_slow_reader_loses_the_oldest_poses_only(path: Path, writer: StreamWriter) -> None:
    source = StreamPoses(path)
    for k in range(POSE_SLOTS + 10):
        writer.write_pose(float(k), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.full(6, 1e-4))
    stamps = [pose.stamp_s for pose in source.poses()]
    assert stamps == list(range(POSE_SLOTS + 10 - len(stamps), POSE_SLOTS + 10))
    assert len(stamps) >= POSE_SLOTS // 2


def test_a_restarted_camera_is_followed(path: Path, writer: StreamWriter) -> None:
    camera, source = StreamCamera(path), StreamPoses(path)
    for k in range(3):
        writer.write_frame(1.0 + k, _depth(1000), RGB)
    assert camera.poll() is not None
    fresh = StreamWriter(path, StreamHeader(CameraSpec(20, 10, 9.0, 9.0, 9.5, 4.5), HEADER_OF.rgb, HEADER_OF.rgb_from_depth))
    fresh.write_frame(9.0, np.full((10, 20), 1500, np.uint16), RGB)
    fresh.write_pose(9.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.full(6, 1e-4))
    frames = [camera.poll() for _ in range(10)]  # 0.1 s at 100 Hz
    (frame,) = [frame for frame in frames if frame is not None]
    assert frames[0] is None
    assert frame.depth_m.shape == (10, 20)
    assert frame.depth_intrinsics.width == 20
    assert sum(len(source.poses()) for _ in range(10)) == 1


class _Appears(ManualClock):
    """Clock on which the camera stream appears at a given time."""

    def __init__(self, path: Path, appears_s: float) -> None:
        super().__init__(10.0)
        self._path = path
        self._appears_s = appears_s

    def sleep_until(self, instant_s: float) -> None:
        self.advance_to(instant_s)
        if instant_s >= self._appears_s and not self._path.exists():
            StreamWriter(self._path, HEADER_OF)


def test_opening_waits_for_the_camera(path: Path) -> None:
    clock = _Appears(path, 11.0)
    assert open_stream(path, clock, 5.0).header == HEADER_OF
    assert clock.now_s() == pytest.approx(11.0)


@pytest.mark.parametrize("clock", [ManualClock(), _Appears(Path("/nonexistent"), 1e9)])
def test_opening_gives_up_with_a_one_line_error(path: Path, clock: ManualClock) -> None:
    with pytest.raises(
        StreamError, match=r"camera\.stream: cannot be read \(No such file or directory\); waited 0\.5 s"
    ) as error:
        open_stream(path, clock, 0.5)
    assert "\n" not in str(error.value)


def test_opening_logs_once_why_it_waits_and_stops_on_request(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path.write_bytes(b"x" * 5000)
    clock = _Appears(path, 1e9)
    with pytest.raises(StreamError, match=r"camera\.stream: ended while waiting for it"):
        open_stream(path, clock, 5.0, lambda: clock.now_s() > 11.0)
    assert clock.now_s() < 11.2
    assert [record.message for record in caplog.records] == [
        f"waiting for a camera stream: {path}: not a camera stream (want UAVSTRM1 at its start)"
    ]


def test_opening_repeats_what_it_waits_for(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(StreamError):
        open_stream(path, _Appears(path, 1e9), 40.0)
    message = f"waiting for a camera stream: {path}: cannot be read (No such file or directory)"
    assert [record.message for record in caplog.records] == [message, f"{message}; 15 s", f"{message}; 30 s"]


def test_a_stream_behind_a_symlink_is_a_one_line_error(path: Path, writer: StreamWriter) -> None:
    path.with_name("link").symlink_to(path)
    with pytest.raises(StreamError, match="link: cannot be mapped"):
        StreamCamera(path.with_name("link"))


@pytest.mark.parametrize(
    ("offset", "value", "message"),
    [
        ("magic", b"NOTMINE!", "not a camera stream"),
        ("depth_size", np.array([0, 12], "<i4").tobytes(), "depth size 0x12"),
        ("rgb_size", np.array([8, 5000], "<i4").tobytes(), "rgb size 8x5000"),
        ("depth_size", np.array([4096, 4096], "<i4").tobytes(), "truncated"),
        ("depth_k", np.array([np.nan, 1, 1, 1]).tobytes(), "depth intrinsics make no sense"),
        ("rgb_k", np.array([5.0, -1, 1, 1]).tobytes(), "rgb intrinsics make no sense"),
        ("rgb_from_depth", np.zeros(7).tobytes(), "rgb_from_depth"),
    ],
)
def test_an_invalid_stream_file_is_a_one_line_error(
    path: Path, writer: StreamWriter, offset: str, value: bytes, message: str
) -> None:
    assert HEADER.fields is not None
    with path.open("r+b") as file:
        file.seek(HEADER.fields[offset][1])
        file.write(value)
    with pytest.raises(StreamError, match=message) as error:
        StreamCamera(path)
    assert "\n" not in str(error.value)


def test_the_depth_table_is_in_metres_within_the_valid_range() -> None:
    table = depth_lookup_table(0.3, 6.0, 0.001)
    counts = np.arange(65536)
    in_range = (counts >= 300) & (counts <= 6000)
    np.testing.assert_allclose(table[in_range], counts[in_range] / 1000, rtol=1e-6)
    assert np.isnan(table[~in_range]).all()
    assert np.isnan(depth_lookup_table(0.0, 100.0)[0])  # zero means unknown, never near
