"""The codec against pymavlink's own messages, with frames turned by matrices here."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.dialects.v20 import common as wire

from uav_recon.autopilot.mavlink.codec import Decoder, Encoder
from uav_recon.autopilot.mavlink.messages import (
    Ack,
    Attitude,
    DownwardRange,
    EstimatorStatus,
    Firmware,
    FlowAngle,
    FlowRate,
    GimbalAttitude,
    Heartbeat,
    LocalPosition,
    Message,
    OriginSet,
    StatusText,
    SystemStatus,
    TimesyncMessage,
    UpwardRange,
)
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.trajectory import Setpoint

NED_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_FLU = np.diag([1.0, -1.0, -1.0])
SOURCE = wire.MAVLink(None, srcSystem=1, srcComponent=1)


def frame_of(message: Any, mavlink1: bool = False) -> bytes:
    return bytes(message.pack(SOURCE, force_mavlink1=mavlink1))


def read(message: Any) -> Message | None:
    (received,) = Decoder().feed(frame_of(message))
    assert (received.system, received.component) == (1, 1)
    return received.message


def written(frame: bytes) -> Any:
    return wire.MAVLink(None).decode(bytearray(frame))


HEARTBEAT = wire.MAVLink_heartbeat_message(2, 12, 0x80, 6 << 16, 4, 3)


def numbers(*shape: int) -> st.SearchStrategy[FloatArray]:
    size = int(np.prod(shape))
    values = st.lists(st.floats(-50.0, 50.0), min_size=size, max_size=size)
    return values.map(lambda v: np.array(v).reshape(shape))


@settings(max_examples=100, deadline=None)
@given(
    numbers(3), numbers(4).filter(lambda q: np.linalg.norm(q) > 1.0), numbers(3), st.integers(0, 600), st.integers(-5, 200),
    st.sampled_from((1, 20)),
)  # fmt: skip
def test_odometry_is_the_pose_in_frd(
    position: FloatArray, quat: FloatArray, velocity: FloatArray, resets: int, quality: int, frame: int
) -> None:
    root = np.arange(36.0).reshape(6, 6) * 1e-3 + np.eye(6)
    pose = StampedPose(5.0, Pose(quat, position), velocity, root @ root.T, quality, resets)
    m = written(Encoder(233, 191).odometry(pose, 123_456_789, frame))
    rotation = pose.odom_from_body.rotation()
    np.testing.assert_allclose([m.x, m.y, m.z], NED_ENU @ position, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(Pose(np.array(m.q), np.zeros(3)).rotation(), NED_ENU @ rotation @ FRD_FLU, atol=1e-5)
    np.testing.assert_allclose([m.vx, m.vy, m.vz], FRD_FLU @ rotation.T @ velocity, rtol=1e-5, atol=1e-4)
    turned = np.kron(np.eye(2), NED_ENU) @ root @ root.T @ np.kron(np.eye(2), NED_ENU).T
    upper = [turned[i, j] for i in range(6) for j in range(i, 6)]
    np.testing.assert_allclose(m.pose_covariance, upper, rtol=1e-5, atol=1e-6)
    assert (m.frame_id, m.child_frame_id, m.time_usec) == (frame, 12, 123_456_789)
    assert m.reset_counter == resets % 256
    assert m.quality == min(max(quality, 1), 100)
    sent = [m.x, m.y, m.z, *m.q, m.vx, m.vy, m.vz, m.rollspeed, m.pitchspeed, m.yawspeed, *m.pose_covariance]
    assert np.isfinite([*sent, *m.velocity_covariance]).all()


@settings(max_examples=100, deadline=None)
@given(numbers(3), numbers(3), numbers(3), st.floats(-9, 9), st.floats(-2, 2))
def test_setpoints_carry_everything(p: FloatArray, v: FloatArray, a: FloatArray, yaw: float, rate: float) -> None:
    m = written(Encoder(233, 191).setpoint(7, Setpoint(p, v, a, yaw, rate, 0.3), 2**32 + 5, 2496))
    np.testing.assert_allclose([m.x, m.y, m.z], NED_ENU @ p, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose([m.vx, m.vy, m.vz], NED_ENU @ v, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose([m.afx, m.afy, m.afz], NED_ENU @ a, rtol=1e-6, atol=1e-6)
    forward = NED_ENU @ [math.cos(yaw), math.sin(yaw), 0.0]
    np.testing.assert_allclose([math.cos(m.yaw), math.sin(m.yaw)], forward[:2], atol=1e-5)
    assert m.yaw_rate == pytest.approx(-rate, abs=1e-6)
    assert (m.type_mask, m.coordinate_frame, m.target_system, m.target_component, m.time_boot_ms) == (2496, 1, 7, 1, 5)


@pytest.mark.parametrize("size", [1e38, 3.5e38, 0.85e39, 1e300])
def test_a_number_that_no_float32_holds_raises_nothing_and_goes_out_as_the_largest(size: float) -> None:
    encoder, wide, most = Encoder(233, 191), np.array([size, -size, size]), min(size, float(np.finfo(np.float32).max))
    m = written(encoder.odometry(StampedPose(5.0, Pose.identity(), np.zeros(3), np.diag([size] * 6)), 1, 1))
    assert m.pose_covariance[0] == pytest.approx(most)
    m = written(encoder.odometry(StampedPose(5.0, Pose.identity(), wide), 1, 1))
    assert (m.vx, m.vy, m.vz) == pytest.approx((most, most, -most))
    m = written(encoder.odometry(StampedPose(5.0, Pose.from_yaw(0.0, wide), np.zeros(3)), 1, 1))
    assert (m.x, m.y, m.z) == pytest.approx((-most, most, -most))
    m = written(encoder.setpoint(7, Setpoint(wide, wide, wide, size, -size, 0.0), 0, 0))
    assert (m.x, m.afy, m.vz, m.yaw_rate) == pytest.approx((-most, most, -most, most))


@pytest.mark.parametrize(
    ("flags", "horizontal", "good"),
    [(0x33F, 0.4, True), (0x33F, 1.0, False), (0x25, 0.0, False), (0xA5, 0.0, False), (0x400, 0.0, False), (0x73F, 0.1, False)],
)
def test_ardupilots_estimator_follows_only_when_it_takes_what_it_is_fed(flags: int, horizontal: float, good: bool) -> None:
    report = ardupilotmega.MAVLink_ekf_status_report_message(flags, 0.1, horizontal, 0.1, 0.0, 0.0)
    (received,) = Decoder().feed(bytes(report.pack(ardupilotmega.MAVLink(None, 1, 1))))
    assert received.message == EstimatorStatus(good)


def test_other_things_we_say() -> None:
    encoder = Encoder(233, 191)
    beat = written(encoder.heartbeat())
    assert (beat.type, beat.autopilot, beat.get_srcSystem(), beat.get_srcComponent()) == (18, 8, 233, 191)
    order = written(encoder.command(3, 176, 1.0, 4.0, 6.0))
    assert (order.target_system, order.command, order.param1, order.param2, order.param3, order.param7) == (3, 176, 1, 4, 6, 0)
    origin = written(encoder.origin(3, 47.3977, -8.5456, 488.2))
    assert (origin.latitude, origin.longitude, origin.altitude) == (473977000, -85456000, 488200)
    gimbal = written(encoder.gimbal_pitch(3, 0.25))
    assert gimbal.pitch == pytest.approx(-0.25)
    assert gimbal.flags == 8 | 4
    sync = written(encoder.timesync(11, 22))
    assert (sync.tc1, sync.ts1) == (11, 22)
    assert [written(encoder.heartbeat()).get_seq() for _ in range(300)][250:253] == [255, 0, 1]


def test_what_the_autopilot_says() -> None:
    assert read(HEARTBEAT) == Heartbeat(2, 12, True, 393216)
    assert read(wire.MAVLink_command_ack_message(176, 4)) == Ack(176, 4)
    assert read(wire.MAVLink_timesync_message(-1, 7)) == TimesyncMessage(-1, 7)
    assert read(wire.MAVLink_estimator_status_message(0, 8, *[0.0] * 8)) == EstimatorStatus(True)
    assert read(wire.MAVLink_estimator_status_message(0, 0xFFF7, *[0.0] * 8)) == EstimatorStatus(False)
    bit = wire.MAV_SYS_STATUS_PREARM_CHECK
    assert read(wire.MAVLink_sys_status_message(bit, bit, bit, 0, 0, 0, 80, *[0] * 6)) == SystemStatus(True, 0.8)
    assert read(wire.MAVLink_sys_status_message(0, 0, bit, 0, 0, 0, 80, *[0] * 6)) == SystemStatus(True, 0.8), "PX4 1.17"
    sick = read(wire.MAVLink_sys_status_message(bit, bit, 0, 0, 0, 0, -1, *[0] * 6))
    assert isinstance(sick, SystemStatus)
    assert not sick.prearm_good
    assert math.isnan(sick.battery_fraction)
    assert read(wire.MAVLink_gps_global_origin_message(1, 2, 3)) == OriginSet()
    version = 1 << 24 | 15 << 16 | 4 << 8 | 255
    assert read(wire.MAVLink_autopilot_version_message(0, version, 0, 0, 0, *[[0] * 8] * 3, 0, 0, 0)) == Firmware((1, 15, 4))


@pytest.mark.parametrize(
    ("uid", "uid2", "told"),
    [
        (0, [], ""),
        (0x5349, [], "0000000000005349"),
        (0x5349, [0, 1, 0xAB], "0001ab" + 15 * "00"),
        (1 << 63, [], "8" + 15 * "0"),
    ],
)
def test_the_hardware_is_named_by_its_longer_uid(uid: int, uid2: list[int], told: str) -> None:
    longer = [*uid2, *[0] * (18 - len(uid2))]
    message = wire.MAVLink_autopilot_version_message(0, 1 << 24, 0, 0, 0, *[[0] * 8] * 3, 0, 0, uid, longer)
    assert read(message) == Firmware((1, 0, 0), told)
    assert read(wire.MAVLink_statustext_message(3, b"no \x1b[31mGPS\xff")) == StatusText(3, "no [31mGPS\ufffd")


@given(numbers(3), numbers(3), numbers(4).filter(lambda q: np.linalg.norm(q) > 1.0))
def test_where_the_autopilot_believes_to_be(p: FloatArray, v: FloatArray, quat: FloatArray) -> None:
    place = read(wire.MAVLink_local_position_ned_message(0, *p, *v))
    assert isinstance(place, LocalPosition)
    np.testing.assert_allclose(place.position_m, NED_ENU.T @ p, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(place.velocity_mps, NED_ENU.T @ v, rtol=1e-6, atol=1e-6)
    quat = quat / np.linalg.norm(quat)
    attitude = read(wire.MAVLink_attitude_quaternion_message(77, *quat, 0.1, 0.2, 0.3))
    assert isinstance(attitude, Attitude)
    assert attitude.boot_ms == 77
    assert attitude.rate_radps is not None
    np.testing.assert_allclose(attitude.rate_radps, [0.1, -0.2, -0.3], atol=1e-7)
    unknown = read(wire.MAVLink_attitude_quaternion_message(77, *quat, math.nan, 0.2, 0.3))
    assert isinstance(unknown, Attitude)
    assert unknown.rate_radps is None
    ned_from_frd = Pose(quat, np.zeros(3)).rotation()
    np.testing.assert_allclose(Pose(attitude.quat_wxyz, np.zeros(3)).rotation(), NED_ENU.T @ ned_from_frd @ FRD_FLU, atol=1e-6)


@pytest.mark.parametrize("down", [-0.9, -0.2, 0.0, 0.4, 1.0])
def test_gimbal_pitch_is_positive_down(down: float) -> None:
    quat = [math.cos(down / 2), 0.0, -math.sin(down / 2), 0.0]
    heard = read(wire.MAVLink_gimbal_device_attitude_status_message(0, 0, 1234, 0, quat, 0, 0, 0, 0))
    assert isinstance(heard, GimbalAttitude)
    assert heard.boot_ms == 1234
    assert heard.pitch_down_rad == pytest.approx(down, abs=1e-6)


@pytest.mark.parametrize(
    "message",
    [
        wire.MAVLink_local_position_ned_message(0, math.nan, 0, 0, 0, 0, 0),
        wire.MAVLink_attitude_quaternion_message(0, 0, 0, 0, 0, 0, 0, 0),
        wire.MAVLink_attitude_quaternion_message(0, math.inf, 0, 0, 0, 0, 0, 0),
        wire.MAVLink_gimbal_device_attitude_status_message(0, 0, 0, 0, [math.nan] * 4, 0, 0, 0, 0),
        wire.MAVLink_vfr_hud_message(0, 0, 0, 0, 0, 0),
    ],
)
def test_numbers_that_are_none_are_not_told(message: Any) -> None:
    assert read(message) is None


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400), st.lists(st.integers(1, 40), min_size=1, max_size=60))
def test_garbage_neither_raises_nor_hides_what_follows(garbage: bytes, cuts: list[int]) -> None:
    """Whatever came before, in whatever pieces: after one frame's length of clean data the clean frames are heard."""
    clean = [frame_of(HEARTBEAT) for _ in range(30)]
    data, decoder, heard, at = garbage + b"".join(clean), Decoder(), [], 0
    for cut in cuts:
        heard += decoder.feed(data[at : at + cut])
        at += cut
    heard += decoder.feed(data[at:])
    beats = [r for r in heard if isinstance(r.message, Heartbeat)]
    assert 30 - 14 <= len(beats) <= 31
    assert beats[-1].frame == clean[-1]


def test_every_flipped_bit_is_noticed() -> None:
    frame = frame_of(HEARTBEAT)
    for bit in range(8 * len(frame)):
        bent = bytearray(frame)
        bent[bit // 8] ^= 1 << bit % 8
        assert not [r for r in Decoder().feed(bytes(bent)) if r.message is not None], bit


def test_mavlink_1_is_dropped_and_counted() -> None:
    decoder = Decoder()
    heard = decoder.feed(frame_of(HEARTBEAT, mavlink1=True) + frame_of(HEARTBEAT) + frame_of(HEARTBEAT, mavlink1=True))
    assert len(heard) == 1
    assert decoder.mavlink1_frames == 2
    assert decoder.garbage_bytes == 0


def test_kinds_nobody_knows_are_stepped_over() -> None:
    unknown = bytes([0xFD, 4, 0, 0, 9, 1, 1, 0xFF, 0xEE, 0x77, 1, 2, 3, 4, 0xAB, 0xCD])
    decoder = Decoder()
    assert len(decoder.feed(unknown + frame_of(HEARTBEAT))) == 1
    assert (decoder.unknown_frames, decoder.garbage_bytes) == (1, 0)


def test_a_megabyte_of_noise_is_digested_in_bounded_memory() -> None:
    decoder, rng = Decoder(), np.random.default_rng(4)
    for _ in range(16):
        assert not [r for r in decoder.feed(rng.bytes(1 << 14)) if r.message is not None]
        assert len(decoder._buffer) < 300


def distance_sensor(current_cm: int = 130, **changes: Any) -> Any:
    """A sensor of 5 cm to 4 m that looks up, as PX4 and ArduPilot send it: without field of view and quality."""
    fields = {
        "time_boot_ms": 1234, "min_distance": 5, "max_distance": 400, "current_distance": current_cm, "type": 0, "id": 2,
        "orientation": wire.MAV_SENSOR_ROTATION_PITCH_90, "covariance": 0, "horizontal_fov": 0.0, "vertical_fov": 0.0,
        "quaternion": [0.0] * 4, "signal_quality": 0,
    }  # fmt: skip
    return wire.MAVLink_distance_sensor_message(**(fields | changes))


def test_a_range_that_looks_up_is_read() -> None:
    assert read(distance_sensor()) == UpwardRange(2, 1.3, math.inf, 1234)
    assert read(distance_sensor(5)) == UpwardRange(2, 0.05, math.inf, 1234)
    assert read(distance_sensor(399, signal_quality=2)) == UpwardRange(2, 3.99, math.inf, 1234)
    for wide, high, fov_rad in ((0.5, 0.25, 0.25), (0.25, 0.5, 0.25), (0.5, 0.0, 0.5), (0.0, 0.5, 0.5)):
        assert read(distance_sensor(horizontal_fov=wide, vertical_fov=high)) == UpwardRange(2, 1.3, fov_rad, 1234)


@pytest.mark.parametrize(
    "changes",
    [
        {"orientation": wire.MAV_SENSOR_ROTATION_NONE},
        {"orientation": wire.MAV_SENSOR_ROTATION_CUSTOM, "quaternion": [1.0, 0.0, 0.0, 0.0]},
        {"signal_quality": 1},
        {"current_cm": 4},
        {"current_cm": 400},
        {"current_cm": 65535},
        {"current_cm": 0, "min_distance": 0},
        {"min_distance": 400, "max_distance": 5},
        {"max_distance": 0},
        {"horizontal_fov": math.nan},
        {"vertical_fov": math.inf},
        {"horizontal_fov": -0.1},
        {"vertical_fov": 3.2},
    ],
)
def test_a_range_that_is_none_is_not_read(changes: dict[str, Any]) -> None:
    assert read(distance_sensor(**changes)) is None


def test_a_range_that_looks_down_is_read() -> None:
    down = {"orientation": wire.MAV_SENSOR_ROTATION_PITCH_270, "horizontal_fov": math.nan}
    assert read(distance_sensor(**down)) == DownwardRange(2, 1.3, 1234)
    for none in ({"signal_quality": 1}, {"current_cm": 4}, {"current_cm": 400}, {"current_cm": 0, "min_distance": 0}):
        assert read(distance_sensor(**(down | none))) is None


def flow_of(
    velocity_frd_mps: tuple[float, float], rate_frd_radps: tuple[float, float], distance_m: float
) -> tuple[float, float]:
    """The rates that a sensor measures, by MAVLink's convention: as a right-handed turn of the sensor about its axes."""
    (vx, vy), (wx, wy) = velocity_frd_mps, rate_frd_radps
    return wx - vy / distance_m, wy + vx / distance_m


def optical_flow_rad(**changes: Any) -> Any:
    """1 m above the floor, over 50 ms: 0.4 m/s forward and 0.2 m/s to the right, without a turn."""
    x, y = flow_of((0.4, 0.2), (0.0, 0.0), 1.0)
    fields = {
        "time_usec": 7_000_123, "sensor_id": 3, "integration_time_us": 50_000,
        "integrated_x": x * 0.05, "integrated_y": y * 0.05,
        "integrated_xgyro": 0.01, "integrated_ygyro": 0.02, "integrated_zgyro": 0.03, "temperature": 0, "quality": 200,
        "time_delta_distance_us": 0, "distance": -1.0,
    }  # fmt: skip
    return wire.MAVLink_optical_flow_rad_message(**(fields | changes))


def test_flow_angles_are_read_in_flu() -> None:
    """In FLU the motion is 0.4 m/s along x and -0.2 m/s along y: angles of vy / d and -vx / d about x and y."""
    flow = read(optical_flow_rad())
    assert isinstance(flow, FlowAngle)
    assert (flow.sensor, flow.boot_us, flow.quality) == (3, 7_000_123, 200)
    assert flow.interval_s == pytest.approx(0.05)
    assert flow.flow_rad == pytest.approx((-0.2 * 0.05, -0.4 * 0.05))
    assert flow.gyro_rad == pytest.approx((0.01, -0.02, -0.03))
    without = read(optical_flow_rad(integrated_xgyro=math.nan))
    assert isinstance(without, FlowAngle)
    assert all(math.isnan(angle) for angle in without.gyro_rad)


@pytest.mark.parametrize(
    "changes",
    [
        {"integration_time_us": 0}, {"integration_time_us": 500_001}, {"integrated_x": math.nan}, {"integrated_y": math.inf},
        {"integrated_y": -1.8},
    ],
)  # fmt: skip
def test_flow_angles_that_cannot_be_are_not_read(changes: dict[str, Any]) -> None:
    assert read(optical_flow_rad(**changes)) is None


def test_flow_rates_are_read_in_flu() -> None:
    """ArduPilot sends the rates, and in flow_comp_m the rates less those of the body."""
    body = (0.3, -0.1)
    x, y = flow_of((0.4, 0.2), body, 2.0)
    message = wire.MAVLink_optical_flow_message(5_000, 0, 0, 0, x - body[0], y - body[1], 90, 2.0, x, y)
    flow = read(message)
    assert isinstance(flow, FlowRate)
    assert (flow.sensor, flow.boot, flow.quality) == (0, 5_000, 90)
    assert flow.rate_radps == pytest.approx((0.3 - 0.1, 0.1 - 0.2), abs=1e-6)
    assert flow.gyro_radps == pytest.approx((0.3, 0.1), abs=1e-6)
    assert read(wire.MAVLink_optical_flow_message(5_000, 0, 0, 0, math.nan, 0.0, 90, 2.0, 0.1, 0.1)) is None
