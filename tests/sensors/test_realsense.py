from __future__ import annotations

import builtins
import gc
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyrealsense2 as rs
import pytest
from librealsense_writer import motion_stream, video_stream
from scipy.spatial.transform import Rotation
from software_realsense import GLOBAL, HARDWARE, SYSTEM, Rig, SoftwareRealSense

from uav_recon.clock import ManualClock, MonotonicClock
from uav_recon.sensors.realsense import RealSenseCamera, RealSenseError
from uav_recon.sensors.stream_format import StreamError
from uav_recon.types.camera import BODY_FROM_OPTICAL, Frame, ImuSample
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

FRAMES = 8
DEPTH = (424, 240, 223.5, 224.5, 211.25, 118.75)
RGB = (320, 180, 230.0, 231.0, 158.5, 90.5)
ROTATION = Rotation.from_euler("xyz", [0.01, -0.02, 0.03]).as_matrix()
TRANSLATION = [0.015, 0.001, -0.002]
SCALE = 0.0005
LEVEL = Pose.from_matrix(BODY_FROM_OPTICAL)
NOT_CONNECTED = "RealSense camera 146322070000 is not connected (seen: none)"


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
    depth = stereo.add_video_stream(video_stream(rs.stream.depth, 0, rs.format.z16, 2, DEPTH))
    rgb = colour.add_video_stream(video_stream(rs.stream.color, 1, rs.format.rgb8, 3, RGB))
    gyro = motion.add_motion_stream(motion_stream(rs.stream.gyro, 2))
    accel = motion.add_motion_stream(motion_stream(rs.stream.accel, 3))
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


def test_streams_are_chosen_from_what_the_device_offers() -> None:
    """A camera on USB 2 offers few streams; its frames come end to end through the real library."""
    offered = ((480, 270, 15), (640, 480, 6))
    rig = Rig(
        SoftwareRealSense(ManualClock(100.0), offered, ((640, 480, 15), (424, 240, 15)), usb="2.1"), body_from_depth=LEVEL
    )
    frames = rig.run(1.0, depth_mm=1500)
    assert len(frames) == 15
    frame = frames[-1][1]
    np.testing.assert_allclose(frame.depth_m, 1.5, rtol=1e-6)
    assert (frame.depth_m.shape, frame.rgb.shape) == ((270, 480), (240, 424, 3))
    np.testing.assert_allclose(frame.rgb_from_depth.translation_m, [0.015, 0.0, 0.0], atol=1e-7)
    streams, usb, *_ = rig.camera.remarks()
    assert streams.text() == "camera streams: depth 480x270 at 15 Hz, colour 424x240 at 15 Hz, IMU 200 Hz, USB 2.1"
    assert usb == Reason(ReasonCode.CAMERA_USB2, ("2.1", "15"))


def test_a_device_without_a_fitting_profile_is_refused_with_what_it_offers() -> None:
    device = SoftwareRealSense(ManualClock(100.0), ((1280, 720, 6),), ((640, 480, 30),))
    with pytest.raises(StreamError, match=r"offered depth 1280x720 at 6 Hz; colour 640x480 at 30 Hz$") as error:
        Rig(device)
    assert "\n" not in str(error.value)


def test_inertial_samples_are_in_body_axes_on_the_companions_clock() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)), body_from_depth=LEVEL)
    for _ in range(100):
        rig.clock.advance_to(rig.clock.now_s() + 0.005)
        rig.source.send_motion(rig.clock.now_s() - 0.002)
    samples = rig.camera.imu()
    assert len(samples) == 100
    np.testing.assert_allclose(samples[0].specific_force_mps2, [0.1, 0.0, 9.81], atol=1e-6)
    np.testing.assert_allclose(samples[0].gyro_radps, [0.3, -0.1, -0.2], atol=1e-6)
    assert samples[-1].stamp_s == pytest.approx(rig.clock.now_s(), abs=1e-6)  # the shortest delay counts as none
    assert rig.camera.imu() == []


def test_a_camera_without_imu_says_so() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0), imu_hz=None), body_from_depth=LEVEL)
    assert len(rig.run(1.0)) == 30
    assert rig.camera.imu() == []
    assert Reason(ReasonCode.CAMERA_WITHOUT_IMU) in rig.camera.remarks()


def test_firmware_that_is_known_to_be_bad_is_named_with_its_remedy(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0), firmware="05.11.01.100"))
    assert [reason.code for reason in rig.camera.remarks()] == [ReasonCode.CAMERA_STREAMS, *[ReasonCode.CAMERA_FIRMWARE] * 2]
    assert "camera firmware 05.11.01.100" in caplog.text
    assert "update the firmware to 5.11.6.200 or later" in caplog.text


def test_an_emitter_that_is_off_is_said() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)))
    off = Reason(ReasonCode.CAMERA_EMITTER_OFF)
    rig.run(0.1)
    assert off not in rig.camera.remarks()  # no metadata, no word
    for on in (False, True):
        rig.source.set_emitter(on)
        rig.run(0.1)
        assert (off in rig.camera.remarks()) is not on


@pytest.mark.parametrize("domain", [SYSTEM, GLOBAL])
def test_after_a_change_of_the_stamps_clock_frames_pause_for_half_a_second(domain: Any) -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)))
    assert len(rig.run(1.0)) == 30
    for rig.domain in (domain, HARDWARE):
        changed_s = rig.clock.now_s()
        frames = rig.run(2.0)
        assert 0.5 <= frames[0][0] - changed_s < 0.6
        assert len(frames) >= 44
        assert all(-1e-6 <= seen_s - frame.stamp_s <= 0.006 for seen_s, frame in frames), "on our clock, whatever theirs is"


def test_depth_that_is_stamped_on_arrival_is_said() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)), body_from_depth=LEVEL)
    rig.domain = SYSTEM
    rig.source.send_motion(rig.clock.now_s(), HARDWARE)
    rig.camera.imu()
    rig.run(0.2)
    codes = [reason.code for reason in rig.camera.remarks()]
    assert codes == [ReasonCode.CAMERA_STREAMS, ReasonCode.CAMERA_ARRIVAL_STAMPS, ReasonCode.CAMERA_DOMAINS]


def test_stamps_that_run_with_no_clock_are_refused_in_words() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)))
    rig.source.stamp_s = lambda domain, taken_s: 7.0 + 1e-3 * taken_s  # type: ignore[method-assign]  # milliseconds as seconds
    rig.run(12.0)
    assert rig.run(1.0) == []
    assert Reason(ReasonCode.CAMERA_STAMPS_REFUSED, ("depth",)) in rig.camera.remarks()
    assert rig.camera.dropped_frames > 30


def test_a_wall_clock_set_back_loses_at_most_two_frames() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)))
    rig.domain = SYSTEM
    assert len(rig.run(1.0)) == 30
    rig.source.wall_from_clock_s -= 3600.0
    assert len(rig.run(1.0)) >= 28


def test_depth_without_colour_of_its_time_is_no_frame() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)))
    rig.run(0.5)
    assert rig.run(0.5, colour=False) == []
    assert rig.camera.dropped_frames >= 13
    assert len(rig.run(0.5)) == 15


@pytest.mark.parametrize("colourless", [False, True])
def test_a_silent_camera_is_opened_again_within_two_seconds(colourless: bool, caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)))
    assert len(rig.run(1.0)) == 30
    lists, rig.sends = rig.lists, colourless
    assert rig.run(1.45, colour=False) == []
    assert rig.lists == lists
    rig.run(0.3, colour=False)
    assert rig.lists == lists + 1, "the devices are listed by a new context"
    assert "no frame for 1.5 s" in caplog.text
    rig.sends = True
    assert len(rig.run(1.0)) == 30
    assert "restart 1 of 3" in caplog.text


def test_a_camera_that_was_unplugged_is_given_up_after_three_restarts() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)))
    rig.run(1.0)
    lists, rig.sends, rig.connected = rig.lists, False, False
    rig.run(1.6)
    with pytest.raises(
        RealSenseError, match=r"^RealSense 146322070000: lost, 3 restarts failed \(.*not connected.*\): reconnect"
    ):
        rig.run(8.0)
    assert rig.lists == lists + 3
    assert Reason(ReasonCode.CAMERA_RESTARTS, (3, 3, NOT_CONNECTED)) in rig.camera.remarks()
    with pytest.raises(RealSenseError):
        rig.camera.poll()  # at every poll from now on
    assert rig.lists == lists + 3


def test_a_driver_that_hangs_never_blocks_a_poll() -> None:
    """No call of the driver returns: each attempt ends by its time, and polls go on."""
    rig = Rig(SoftwareRealSense(ManualClock(100.0)), executor=_Hanging())
    rig.run(1.0)
    rig.sends = False
    rig.run(2.0)
    with pytest.raises(RealSenseError, match=r"3 restarts failed \(no answer within 8 s\)"):
        rig.run(60.0)
    assert rig.clock.now_s() < 100.0 + 1.0 + 1.6 + 1.0 + 3 * 10.1


def test_another_camera_does_not_take_the_place_of_a_lost_one() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)))
    rig.run(1.0)
    rig.source, rig.sends = SoftwareRealSense(rig.clock, serial="000000000001"), False
    with pytest.raises(RealSenseError, match=r"146322070000 is not connected \(seen: 000000000001\)"):
        rig.run(12.0)


def test_a_camera_has_five_seconds_for_its_first_frame_after_the_first_poll() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)))
    rig.sends = False
    rig.clock.advance_to(rig.clock.now_s() + 60.0)
    lists = rig.lists
    assert rig.run(4.9) == []
    assert rig.lists == lists
    rig.run(0.3)
    assert rig.lists == lists + 1


def test_a_device_that_goes_while_it_is_opened_is_one_line() -> None:
    def gone() -> Any:
        raise RuntimeError("xioctl(VIDIOC_QBUF) failed,\nLast Error: No such device")

    with pytest.raises(RealSenseError, match=r"^RealSense opening: xioctl.* Last Error: No such device$"):
        RealSenseCamera(ManualClock(1.0), devices=lambda: [SimpleNamespace(supports=lambda _: False, query_sensors=gone)])


class _Hanging:
    """An executor whose work never ends."""

    def submit(self, work: Any, cost_s: float) -> Any:
        return SimpleNamespace(done=lambda: False)

    def close(self) -> None:
        raise AssertionError


def test_the_end_of_a_recording_is_not_a_lost_camera(recording: Path) -> None:
    clock = ManualClock(100.0)
    camera = RealSenseCamera(clock, playback=recording)
    _play(camera)
    for _ in range(100):
        clock.advance_to(clock.now_s() + 1.0)
        camera.poll()  # no exception
    camera.close()
