from __future__ import annotations

import builtins
import gc
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pyrealsense2 as rs
import pytest
from scipy.spatial.transform import Rotation

from uav_recon.clock import ManualClock, MonotonicClock
from uav_recon.sensors import realsense
from uav_recon.sensors.realsense import ClockOffset, RealSenseCamera, RealSenseError
from uav_recon.types.camera import BODY_FROM_OPTICAL, Frame, ImuSample
from uav_recon.types.pose import Pose

FRAMES = 8
DEPTH = (424, 240, 223.5, 224.5, 211.25, 118.75)
RGB = (320, 180, 230.0, 231.0, 158.5, 90.5)
ROTATION = Rotation.from_euler("xyz", [0.01, -0.02, 0.03]).as_matrix()
TRANSLATION = [0.015, 0.001, -0.002]
SCALE = 0.0005


def _stream(kind: Any, uid: int, fmt: Any, bpp: int, numbers: tuple[float, ...]) -> Any:
    intrinsics = rs.intrinsics()
    intrinsics.width, intrinsics.height = int(numbers[0]), int(numbers[1])
    intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = numbers[2:]
    intrinsics.model, intrinsics.coeffs = rs.distortion.none, [0.0] * 5
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.fmt, stream.bpp, stream.fps = kind, 0, uid, fmt, bpp, 30
    stream.width, stream.height, stream.intrinsics = intrinsics.width, intrinsics.height, intrinsics
    return stream


def _motion(kind: Any, uid: int, fps: int) -> Any:
    stream = rs.motion_stream()
    stream.type, stream.index, stream.uid, stream.fmt, stream.fps = kind, 0, uid, rs.format.motion_xyz32f, fps
    intrinsics = rs.motion_device_intrinsic()
    stream.intrinsics = intrinsics
    return stream


def _image(pixels: Any, profile: Any, number: int) -> Any:
    frame = rs.software_video_frame()
    frame.pixels, frame.bpp = pixels, pixels.dtype.itemsize * (pixels.shape[2] if pixels.ndim == 3 else 1)
    frame.stride = pixels.shape[1] * frame.bpp
    frame.timestamp, frame.domain = 1000.0 + number * 100.0 / 3, rs.timestamp_domain.hardware_clock
    frame.frame_number, frame.profile = number + 1, profile.as_video_stream_profile()
    if pixels.ndim == 2:
        frame.depth_units = SCALE
    return frame


def _depth_pixels(number: int) -> Any:
    pixels = np.full((DEPTH[1], DEPTH[0]), 2000 + 2 * number, np.uint16)
    pixels[:, :10] = 0
    pixels[:, 10:20] = 100  # 5 cm: nearer than the valid range
    pixels[:, 20:30] = 60000  # 30 m: farther than the valid range
    pixels[100, 200] = 3333
    return pixels


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording like that of a depth camera with colour and IMU."""
    path = tmp_path_factory.mktemp("realsense") / "flight.db3"
    device = rs.software_device()
    device.create_matcher(rs.matchers.dlr_c)
    stereo, colour, motion = (device.add_sensor(name) for name in ("Stereo Module", "RGB Camera", "Motion Module"))
    depth = stereo.add_video_stream(_stream(rs.stream.depth, 0, rs.format.z16, 2, DEPTH))
    rgb = colour.add_video_stream(_stream(rs.stream.color, 1, rs.format.rgb8, 3, RGB))
    gyro = motion.add_motion_stream(_motion(rs.stream.gyro, 2, 200))
    accel = motion.add_motion_stream(_motion(rs.stream.accel, 3, 200))
    stereo.add_read_only_option(rs.option.depth_units, SCALE)
    rgb_from_depth, same = rs.extrinsics(), rs.extrinsics()
    rgb_from_depth.rotation, rgb_from_depth.translation = ROTATION.T.ravel().tolist(), TRANSLATION  # column-major
    same.rotation, same.translation = np.eye(3).ravel().tolist(), [0.0, 0.0, 0.0]
    depth.register_extrinsics_to(rgb, rgb_from_depth)
    gyro.register_extrinsics_to(depth, same)
    accel.register_extrinsics_to(depth, same)
    recorder = rs.recorder(str(path), device)
    sensors = recorder.query_sensors()
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(lambda frame: None)
    clock = MonotonicClock()
    start_s = clock.now_s()
    for number in range(FRAMES):
        clock.sleep_until(start_s + number / 30)  # librealsense records arrival times and plays back at that rate
        stereo.on_video_frame(_image(_depth_pixels(number), depth, number))
        colour.on_video_frame(_image(np.full((RGB[1], RGB[0], 3), 20 * number, np.uint8), rgb, number))
        for profile, data in ((accel, (0.0, -9.81, 0.1)), (gyro, (0.1, 0.2, 0.3))):
            frame = rs.software_motion_frame()
            vector = rs.vector()
            vector.x, vector.y, vector.z = data
            frame.data, frame.timestamp, frame.domain = vector, 1001.0 + number * 100.0 / 3, rs.timestamp_domain.hardware_clock
            frame.frame_number, frame.profile = number + 1, profile.as_motion_stream_profile()
            motion.on_motion_frame(frame)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    del sensors, recorder
    gc.collect()
    return path


@pytest.fixture
def camera(recording: Path) -> Iterator[RealSenseCamera]:
    camera = RealSenseCamera(MonotonicClock(), playback=recording, body_from_depth=Pose.from_matrix(BODY_FROM_OPTICAL))
    yield camera
    camera.close()


def _play(camera: RealSenseCamera, want_samples: int = 0) -> tuple[list[Frame], list[ImuSample]]:
    """Poll in real time until the recording, a quarter of a second long, is over."""
    clock = MonotonicClock()
    end_s = clock.now_s() + 3.0
    frames: list[Frame] = []
    samples: list[ImuSample] = []
    while clock.now_s() < end_s and (len(frames) < FRAMES - 2 or len(samples) < want_samples):
        frame = camera.poll()
        frames += [frame] if frame is not None else []
        samples += camera.imu()
    return frames, samples


def test_a_recording_plays_back_as_it_was_recorded(camera: RealSenseCamera) -> None:
    frames, samples = _play(camera, want_samples=FRAMES - 2)
    assert len(frames) >= 3  # a busy machine may miss frames, because poll() returns the newest
    for frame in frames:
        number = frame.sequence - 1
        pixels = _depth_pixels(number)
        np.testing.assert_allclose(frame.depth_m[:, 30:], pixels[:, 30:] * SCALE, rtol=1e-6)
        assert np.isnan(frame.depth_m[:, :30]).all()
        np.testing.assert_array_equal(frame.rgb, 20 * number)  # the colour image of the same time
    assert frames[0].rgb.shape == (180, 320, 3)
    assert (np.diff([frame.stamp_s for frame in frames]) > 0).all()
    assert abs(frames[-1].stamp_s - MonotonicClock().now_s()) < 3.0
    assert len(samples) >= 3
    np.testing.assert_allclose(samples[0].specific_force_mps2, [0.1, 0.0, 9.81], atol=1e-6)  # up in the body
    np.testing.assert_allclose(samples[0].gyro_radps, [0.3, -0.1, -0.2], atol=1e-6)


def test_intrinsics_and_extrinsics_are_those_of_the_device(camera: RealSenseCamera) -> None:
    (frame, *_), _samples = _play(camera)
    for ours, theirs in ((frame.depth_intrinsics, DEPTH), (frame.rgb_intrinsics, RGB)):
        np.testing.assert_allclose((ours.width, ours.height, ours.fx, ours.fy, ours.cx, ours.cy), theirs)
    np.testing.assert_allclose(frame.rgb_from_depth.rotation(), ROTATION, atol=1e-6)
    np.testing.assert_allclose(frame.rgb_from_depth.translation_m, TRANSLATION, atol=1e-7)


def test_pixel_zero_is_the_centre_of_the_first_pixel(camera: RealSenseCamera) -> None:
    """librealsense's deprojection of integer pixels equals our bearings."""
    (frame, *_), _samples = _play(camera)
    intrinsics = rs.intrinsics()
    intrinsics.width, intrinsics.height = int(DEPTH[0]), int(DEPTH[1])
    intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = DEPTH[2:]
    intrinsics.model = rs.distortion.none
    ours = frame.depth_intrinsics.bearings()
    for u, v in ((0, 0), (423, 239), (100, 7)):
        np.testing.assert_allclose(ours[v, u], rs.rs2_deproject_pixel_to_point(intrinsics, [u, v], 1.0), atol=1e-6)


def test_a_missing_recording_is_a_one_line_error(tmp_path: Path) -> None:
    with pytest.raises(RealSenseError, match=r"absent\.db3: no such recording") as error:
        RealSenseCamera(MonotonicClock(), playback=tmp_path / "absent.db3")
    assert "\n" not in str(error.value)


def test_a_missing_camera_is_a_one_line_error() -> None:
    with pytest.raises(RealSenseError, match=r"RealSense camera 000000000000 is not connected \(seen: none\)") as error:
        RealSenseCamera(MonotonicClock(), serial="000000000000")
    assert "\n" not in str(error.value)


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "pyrealsense2":
            raise ModuleNotFoundError(name)
        return real(name, *args, **kwargs)

    monkeypatch.delitem(sys.modules, "pyrealsense2")
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(RealSenseError, match=r"pip install uav-recon\[realsense\]"):
        RealSenseCamera(MonotonicClock())


def test_the_clock_offset_is_the_shortest_delay_and_survives_a_reset() -> None:
    rng = np.random.default_rng(3)
    offset = ClockOffset()
    errors = []
    for k in range(3000):
        t = 50.0 + k / 30
        device_s = (t - 40.0) * (1 + 20e-6) if k < 2000 else t - 100.0  # 20 ppm fast, then its clock is reset
        stamp_s = offset.monotonic_s(device_s, t + 0.004 + rng.exponential(0.005))
        if k % 2000 > 300:
            errors.append(stamp_s - t)
    assert 0.0035 < np.min(errors) <= np.max(errors) < 0.007


class _Live:
    """Mock camera with frames stamped by the device's clock or the machine's.

    A frame is 5 ms old when it is polled.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = ManualClock(100.0)
        self.wall_from_clock_s = 1.7e9
        self.late_by_s = 0.005
        self._rs = MagicMock()
        self._number = 0
        monkeypatch.setattr(realsense, "_library", lambda: self._rs)
        self._rs.context.return_value.query_devices.return_value = [MagicMock()]
        self._rs.pipeline.return_value.start.return_value.get_stream.side_effect = self._stream
        self._rs.pipeline.return_value.start.return_value.get_device.return_value.query_sensors.return_value = []
        self._rs.pipeline.return_value.poll_for_frames.side_effect = self._frames
        self.system = self.silent = self.colourless = False
        self._rs.pipeline.return_value.start.return_value.get_device.return_value.get_info.return_value = "146322070000"
        self.camera = RealSenseCamera(self.clock, wall_s=lambda: self.clock.now_s() + self.wall_from_clock_s)

    def _stream(self, kind: Any) -> Any:
        stream = MagicMock()
        stream.as_video_stream_profile.return_value = stream
        stream.intrinsics = SimpleNamespace(fx=5.0, fy=5.0, ppx=3.5, ppy=2.5, width=8, height=6)
        stream.format.return_value = self._rs.format.z16 if kind is self._rs.stream.depth else self._rs.format.rgb8
        stream.get_extrinsics_to.return_value = SimpleNamespace(rotation=np.eye(3).ravel().tolist(), translation=[0.0] * 3)
        return stream

    def _frames(self) -> Any:
        if self.silent:
            return None
        self._number += 1
        taken_s = self.clock.now_s() - self.late_by_s
        frame, domains = MagicMock(), self._rs.timestamp_domain
        frame.get_timestamp.return_value = 1e3 * (taken_s + (self.wall_from_clock_s if self.system else -90.0))
        frame.get_frame_timestamp_domain.return_value = domains.system_time if self.system else domains.hardware_clock
        frame.get_frame_number.return_value = self._number
        frame.get_data.return_value = np.zeros((6, 8), np.uint16)
        return SimpleNamespace(get_depth_frame=lambda: frame, get_color_frame=lambda: None if self.colourless else frame)

    def poll(self, seconds: float) -> list[tuple[float, float]]:
        """Return the arrival time of each frame, and its age by its time stamp."""
        out = []
        for _ in range(round(30 * seconds)):
            self.clock.advance_to(self.clock.now_s() + 1 / 30)
            frame = self.camera.poll()
            if frame is not None:
                out.append((self.clock.now_s(), self.clock.now_s() - frame.stamp_s))
        return out


def test_after_a_change_of_the_stamps_clock_frames_pause_for_half_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    live = _Live(monkeypatch)
    assert len(live.poll(1.0)) == 30
    for system in (True, False):
        live.system, changed_s = system, live.clock.now_s()
        came = live.poll(2.0)
        assert 0.5 <= came[0][0] - changed_s < 0.6
        assert len(came) >= 44
        assert all(-1e-6 <= age_s <= 0.006 for _, age_s in came), "on our clock whichever the camera goes by"


def test_a_wall_clock_set_back_loses_at_most_two_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    live = _Live(monkeypatch)
    live.system = True
    assert len(live.poll(1.0)) == 30
    live.late_by_s = -3600.0  # taken before the machine's clock was set back by an hour, polled afterwards
    assert live.poll(1 / 30)[0][1] == pytest.approx(-3600.0, abs=1e-3)
    live.late_by_s = 0.005
    assert len(live.poll(1.0)) == 29


@pytest.mark.parametrize("falls", ["silent", "colourless"])
def test_an_open_camera_without_frames_is_lost_after_a_second_and_a_half(monkeypatch: pytest.MonkeyPatch, falls: str) -> None:
    live = _Live(monkeypatch)
    assert len(live.poll(1.0)) == 30
    setattr(live, falls, True)
    assert live.poll(1.45) == []
    with pytest.raises(RealSenseError, match=r"^RealSense 146322070000: open, but no frame for 1\.5 s: reconnect it$"):
        live.poll(0.15)
    with pytest.raises(RealSenseError, match=r"no frame for 1\.6 s"):
        live.poll(1 / 30)
    setattr(live, falls, False)
    assert len(live.poll(1.0)) == 30  # a caller that ignored the error can continue


def test_a_camera_has_five_seconds_for_its_first_frame_after_the_first_poll(monkeypatch: pytest.MonkeyPatch) -> None:
    live = _Live(monkeypatch)
    live.silent = True
    live.clock.advance_to(live.clock.now_s() + 60.0)
    assert live.poll(4.9) == []
    with pytest.raises(RealSenseError, match=r"no frame for 5\.0 s"):
        live.poll(0.2)


def test_the_end_of_a_recording_is_not_a_lost_camera(recording: Path) -> None:
    clock = ManualClock(100.0)
    camera = RealSenseCamera(clock, playback=recording)
    _play(camera)
    for _ in range(100):
        clock.advance_to(clock.now_s() + 1.0)
        camera.poll()  # no exception
    camera.close()
