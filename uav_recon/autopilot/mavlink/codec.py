"""The MAVLink codec: MAVLink 2 bytes to values in our frames, and values to bytes.

NED and FRD are used only here. No received data raises. A frame counts only if its checksum is correct; MAVLink 1 frames are
dropped and counted.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from uav_recon.autopilot.mavlink.frame_conversion import swap_attitude, swap_body, swap_covariance, swap_world, swap_yaw
from uav_recon.autopilot.mavlink.framing import (
    MAGIC_1,
    MAGIC_2,
    MessageLayout,
    frame_length,
    framed,
    is_intact,
    kind_of,
    sender_of,
    wire,
)
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
    LandedState,
    LocalPosition,
    Message,
    OdometryMessage,
    OriginSet,
    ParameterValue,
    Received,
    StatusText,
    SystemStatus,
    TimesyncMessage,
    UpwardRange,
)
from uav_recon.types.frames import FloatArray, frozen
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.trajectory import Setpoint

_BUFFER_LIMIT = 1 << 16
_LARGEST = float(np.finfo(np.float32).max)
_UPPER = np.triu_indices(6)
# (m/s)² and (rad/s)²: the pose filter publishes neither; PX4 reads the first three of the diagonal
_TWIST_COVARIANCE = np.diag([0.1**2] * 3 + [100.0] * 3)[_UPPER].tolist()


class Decoder:
    """Finds frames in a byte stream.

    Counters: garbage bytes, frames of MAVLink 1, frames of unknown kind.
    """

    def __init__(self) -> None:
        self._buffer = b""
        self.garbage_bytes = 0
        self.mavlink1_frames = 0
        self.unknown_frames = 0

    def feed(self, data: bytes) -> list[Received]:
        """Return every whole frame up to the end of these bytes, oldest first.

        An unfinished frame waits for the next call.
        """
        self._buffer += data[-_BUFFER_LIMIT:]
        received, at, end = [], 0, len(self._buffer)
        while at < end:
            length = frame_length(self._buffer, at)
            if length < 0:
                break
            frame = self._buffer[at : at + length]
            kind = wire.mavlink_map.get(kind_of(frame)) if length else None
            if not length or not (self._followed(at + length) if kind is None else is_intact(frame, kind)):
                self.garbage_bytes += 1
                at += 1
                continue
            if frame[0] == MAGIC_1:
                self.mavlink1_frames += 1
            elif kind is None:
                self.unknown_frames += 1
            else:
                received.append(Received(*sender_of(frame), _value(kind.id, frame), frame))
            at += length
        self._buffer = self._buffer[at:]
        return received

    def _followed(self, end: int) -> bool:
        """Return True if no bytes or another frame follow.

        This is the only check of a frame of unknown kind.
        """
        return end == len(self._buffer) or self._buffer[end] in (MAGIC_1, MAGIC_2)


class Encoder:
    """Encodes our messages with our system and component id and sequence number.

    Every method returns one frame.
    """

    def __init__(self, system: int, component: int) -> None:
        self._mavlink = wire.MAVLink(None, srcSystem=system, srcComponent=component)

    def heartbeat(self) -> bytes:
        """Return HEARTBEAT of an active onboard controller."""
        who = (wire.MAV_TYPE_ONBOARD_CONTROLLER, wire.MAV_AUTOPILOT_INVALID)
        return self._frame(_HEARTBEAT, _HEARTBEAT.unpacker.pack(0, *who, 0, wire.MAV_STATE_ACTIVE, 3))

    def timesync(self, tc1_ns: int, ts1_ns: int) -> bytes:
        """Return TIMESYNC: a request (tc1_ns = 0, our clock) or an answer (our clock, their ts1)."""
        return self._frame(_TIMESYNC, _TIMESYNC.unpacker.pack(tc1_ns, ts1_ns))

    def command(self, target: int, command: int, *parameters: float) -> bytes:
        """Return COMMAND_LONG to the autopilot of system ``target``; missing parameters are 0."""
        padded = (*parameters, *([0.0] * (7 - len(parameters))))
        return self._pack(wire.MAVLink_command_long_message(target, wire.MAV_COMP_ID_AUTOPILOT1, command, 0, *padded))

    def origin(self, target: int, lat_deg: float, lon_deg: float, alt_m: float) -> bytes:
        """Return SET_GPS_GLOBAL_ORIGIN: the geographic position of the local origin."""
        return self._pack(
            wire.MAVLink_set_gps_global_origin_message(
                target, round(lat_deg * 1e7), round(lon_deg * 1e7), round(alt_m * 1e3), 0
            )
        )

    def odometry(self, pose: StampedPose, time_us: int, frame: int) -> bytes:
        """Return ODOMETRY.

        Pose in frame (LOCAL_NED or LOCAL_FRD, the same axes to us) and BODY_FRD velocity; time_us in the autopilot's clock.

        The angular rate is not known here: it is zero with a variance that shows this (no number on this wire is ever NaN).
        Quality is clipped to 1..100 (0 would mean "unknown").
        """
        velocity_body = pose.odom_from_body.rotation().T @ pose.velocity_odom_mps
        payload = _packed(
            _ODOMETRY,
            time_us,
            *swap_world(pose.odom_from_body.translation_m.tolist()),
            *swap_attitude(pose.odom_from_body.quat_wxyz.tolist()),
            *swap_body(velocity_body.tolist()),
            *(0.0, 0.0, 0.0),
            *swap_covariance(pose.covariance)[_UPPER].tolist(),
            *_TWIST_COVARIANCE,
            frame,
            wire.MAV_FRAME_BODY_FRD,
            pose.reset_counter % 256,
            wire.MAV_ESTIMATOR_TYPE_VIO,
            min(max(pose.quality, 1), 100),
        )
        return self._frame(_ODOMETRY, payload)

    def setpoint(self, target: int, setpoint: Setpoint, time_boot_ms: int, mask: int) -> bytes:
        """Return SET_POSITION_TARGET_LOCAL_NED. mask: bits of the ignored fields, 0 = none."""
        payload = _packed(
            _SETPOINT,
            time_boot_ms % (1 << 32),
            *swap_world(setpoint.position_m.tolist()),
            *swap_world(setpoint.velocity_mps.tolist()),
            *swap_world(setpoint.acceleration_mps2.tolist()),
            swap_yaw(setpoint.yaw_rad),
            -setpoint.yaw_rate_radps,
            mask,
            target,
            wire.MAV_COMP_ID_AUTOPILOT1,
            wire.MAV_FRAME_LOCAL_NED,
        )
        return self._frame(_SETPOINT, payload)

    def gimbal_pitch(self, target: int, pitch_down_rad: float) -> bytes:
        """Return GIMBAL_MANAGER_SET_PITCHYAW: pitch against the horizon, yaw stays with the vehicle."""
        flags = wire.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | wire.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
        return self._pack(
            wire.MAVLink_gimbal_manager_set_pitchyaw_message(
                target, wire.MAV_COMP_ID_AUTOPILOT1, flags, 0, -pitch_down_rad, 0.0, math.nan, math.nan
            )
        )

    def text(self, text: str) -> bytes:
        """Return STATUSTEXT with severity warning.

        Only the first 50 characters are sent; each non-ASCII one becomes a question mark.
        """
        return self._pack(wire.MAVLink_statustext_message(wire.MAV_SEVERITY_WARNING, text.encode("ascii", "replace")[:50]))

    def parameter_request(self, target: int, name: str) -> bytes:
        """Return PARAM_REQUEST_READ by name."""
        return self._pack(wire.MAVLink_param_request_read_message(target, wire.MAV_COMP_ID_AUTOPILOT1, name.encode(), -1))

    def parameter_set(self, target: int, value: ParameterValue) -> bytes:
        """Return PARAM_SET."""
        return self._pack(
            wire.MAVLink_param_set_message(target, wire.MAV_COMP_ID_AUTOPILOT1, value.name.encode(), value.number, value.kind)
        )

    def _pack(self, message: Any) -> bytes:
        frame = bytes(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return frame

    def _frame(self, kind: Any, payload: bytes) -> bytes:
        """Return a frame of a frequent message; fields in the order of the wire."""
        frame = framed(kind, payload, self._mavlink.seq, self._mavlink.srcSystem, self._mavlink.srcComponent)
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return frame


def _packed(kind: Any, *fields: float) -> bytes:
    """Return fields, in the order of the wire, as a payload.

    The callers bound their numbers. One that a float32 cannot hold still raises nothing, and is sent as the largest float32.
    """
    try:
        return bytes(kind.unpacker.pack(*fields))
    except OverflowError:
        return bytes(kind.unpacker.pack(*(min(max(f, -_LARGEST), _LARGEST) if isinstance(f, float) else f for f in fields)))


def _value(identifier: int, frame: bytes) -> Message | None:
    """Return the message of a checked frame in our frames.

    None for kinds that are not used and for numbers that are not finite.
    """
    reader = _READERS.get(identifier)
    if reader is None:
        return None
    layout, make = reader
    return make(*layout.read(frame))


def _heartbeat(kind: int, autopilot: int, base_mode: int, custom_mode: int) -> Message:
    return Heartbeat(kind, autopilot, bool(base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED), custom_mode)


def _system_status(health: int, battery_remaining: int) -> Message:
    battery = battery_remaining / 100 if 0 <= battery_remaining <= 100 else math.nan
    return SystemStatus(bool(health & wire.MAV_SYS_STATUS_PREARM_CHECK), battery)  # PX4 never reports this sensor as present


def _local_position(boot_ms: int, *numbers: float) -> Message | None:
    if not all(map(math.isfinite, numbers)):
        return None
    return LocalPosition(boot_ms, frozen(np.array(swap_world(numbers[:3]))), frozen(np.array(swap_world(numbers[3:]))))


def _attitude(boot_ms: int, *numbers: float) -> Message | None:
    quat, rate = numbers[:4], numbers[4:]
    good = abs(math.hypot(*quat) - 1.0) < 1e-2  # False if any element is not finite
    turning = frozen(np.array(swap_body(rate))) if all(map(math.isfinite, rate)) else None
    return Attitude(frozen(np.array(swap_attitude(quat))), boot_ms, turning) if good else None


def _odometry(
    boot_us: int, frame: int, child_frame: int, estimator: int, quality: int, reset_counter: int, covariance: tuple[float, ...],
    *numbers: float | tuple[float, ...],
) -> Message | None:  # fmt: skip
    """Convert ODOMETRY. A quality of 0 is unknown, a negative one a failure."""
    quat: Any = numbers[3]
    place, speed = numbers[:3], numbers[4:]
    good = abs(math.hypot(*quat) - 1.0) < 1e-2 and all(map(math.isfinite, place))  # type: ignore[arg-type]
    if not good or frame not in _LOCAL_FRAMES or estimator in _GLOBAL_ESTIMATORS:
        return None
    attitude, variance = Pose(np.array(swap_attitude(quat)), np.zeros(3)), np.array([covariance[k] for k in _DIAGONAL])
    known = bool(np.isfinite(variance).all() and (variance > 0.0).all())
    return OdometryMessage(
        boot_us, frozen(np.array(swap_world(place))), attitude.quat_wxyz,  # type: ignore[arg-type]
        frozen(_velocity(child_frame, speed, attitude)),  # type: ignore[arg-type]
        frozen(np.diagonal(swap_covariance(np.diag(variance)))) if known else None,
        100 if quality == 0 else min(max(quality, 0), 100), reset_counter,
    )  # fmt: skip


def _velocity(child_frame: int, numbers: tuple[float, ...], attitude: Pose) -> FloatArray:
    """Return the velocity of an ODOMETRY in the frame of its pose, zero if it is not known."""
    if not all(map(math.isfinite, numbers)):
        return np.zeros(3)
    if child_frame in _LOCAL_FRAMES:
        return np.array(swap_world(numbers))
    return attitude.rotation() @ np.array(swap_body(numbers)) if child_frame == wire.MAV_FRAME_BODY_FRD else np.zeros(3)


def _firmware(number: int, uid: int, uid2: tuple[int, ...]) -> Message:
    told = bytes(uid2).hex() if any(uid2) else f"{uid:016x}" if uid else ""
    return Firmware((number >> 24 & 0xFF, number >> 16 & 0xFF, number >> 8 & 0xFF), told)


def _status_text(severity: int, text: bytes) -> Message:
    return StatusText(severity, "".join(c for c in text.split(b"\0")[0].decode(errors="replace") if c.isprintable()))


def _gimbal(boot_ms: int, quat: tuple[float, float, float, float]) -> Message | None:
    w, x, y, z = quat
    sine = 2.0 * (w * y - z * x)  # FRD: positive pitch is nose up
    return GimbalAttitude(-math.asin(min(max(sine, -1.0), 1.0)), boot_ms) if math.isfinite(sine) else None


def _range(
    boot_ms: int, min_cm: int, max_cm: int, current_cm: int, sensor: int, orientation: int, wide_rad: float, high_rad: float,
    signal: int,
) -> Message | None:  # fmt: skip
    """Convert DISTANCE_SENSOR with orientation up or down.

    A reading at or beyond the maximum is none: the message does not tell a clear view from a lost echo.
    """
    if signal == _INVALID_SIGNAL or not (min_cm <= current_cm < max_cm and current_cm > 0):
        return None
    if orientation == wire.MAV_SENSOR_ROTATION_PITCH_270:
        return DownwardRange(sensor, current_cm / 100.0, boot_ms)
    angles = [angle for angle in (wide_rad, high_rad) if angle != 0.0]  # 0 is unknown
    if orientation != wire.MAV_SENSOR_ROTATION_PITCH_90 or not all(0.0 < angle < math.pi for angle in angles):
        return None
    return UpwardRange(sensor, current_cm / 100.0, min(angles, default=math.inf), boot_ms)


def _flow_angle(
    boot_us: int, sensor: int, interval_us: int, x: float, y: float, gyro_x: float, gyro_y: float, gyro_z: float, quality: int
) -> Message | None:
    """Convert OPTICAL_FLOW_RAD. Its sender leaves NaN in the gyro's angles if it has none."""
    interval_s = interval_us * 1e-6
    flow_rad, gyro_rad = swap_body((x, y, 0.0))[:2], swap_body((gyro_x, gyro_y, gyro_z))
    if not (0.0 < interval_s <= _LONGEST_FLOW_S and _plausible(flow_rad, interval_s)):
        return None
    gyro_rad = gyro_rad if _plausible(gyro_rad[:2], interval_s) else (math.nan, math.nan, math.nan)
    return FlowAngle(sensor, boot_us, interval_s, flow_rad, gyro_rad, quality)


def _flow_rate(
    boot: int, sensor: int, comp_x: float, comp_y: float, rate_x: float, rate_y: float, quality: int
) -> Message | None:
    """Convert ArduPilot's OPTICAL_FLOW.

    Its `flow_comp_m` is the rate less that of the body, in rad/s (GCS_Common.cpp).
    """
    rate_radps, gyro_radps = swap_body((rate_x, rate_y, 0.0))[:2], swap_body((rate_x - comp_x, rate_y - comp_y, 0.0))[:2]
    if not (_plausible(rate_radps, 1.0) and _plausible(gyro_radps, 1.0)):
        return None
    return FlowRate(sensor, boot, rate_radps, gyro_radps, quality)


def _plausible(angles_rad: tuple[float, ...], interval_s: float) -> bool:
    """Return True for finite angles that a sensor can measure over an interval."""
    return all(abs(angle) <= _FASTEST_FLOW_RADPS * interval_s for angle in angles_rad)


def _ekf(flags: int, horizontal: float) -> Message:
    """Convert ArduPilot's EKF_STATUS_REPORT.

    Good: the estimator follows, knows its position, and does not reject what it is fed (innovation over gate).
    """
    return EstimatorStatus(flags & (_EKF_FOLLOWS | _EKF_DOES_NOT) == _EKF_FOLLOWS and horizontal < 1.0)


def _parameter(name: bytes, number: float, kind: int) -> Message:
    return ParameterValue(name.split(b"\0")[0].decode(errors="replace"), number, kind)


def _origin() -> Message:
    return OriginSet()


_LONGEST_FLOW_S = 0.5  #: reject: optical flow that was integrated over a longer time: it says little of any instant
_FASTEST_FLOW_RADPS = 35.0  #: reject: optical flow, and turns of its gyro, beyond the range of any sensor
_INVALID_SIGNAL = 1  # signal_quality of DISTANCE_SENSOR; 0 is unknown, 2 to 100 a share
_EKF_FOLLOWS = 0x33F  # attitude, velocities, positions and their predictions (measured)
_EKF_DOES_NOT = wire.EKF_CONST_POS_MODE | wire.EKF_UNINITIALIZED
_LOCAL_FRAMES = (wire.MAV_FRAME_LOCAL_NED, wire.MAV_FRAME_LOCAL_FRD)
_GLOBAL_ESTIMATORS = (wire.MAV_ESTIMATOR_TYPE_GPS, wire.MAV_ESTIMATOR_TYPE_GPS_INS)  # no local pose
_DIAGONAL = (0, 6, 11, 15, 18, 20)  # of the upper right triangle of a 6x6 matrix, row by row
_ODOMETRY = wire.MAVLink_odometry_message
_SETPOINT = wire.MAVLink_set_position_target_local_ned_message
_HEARTBEAT = wire.MAVLink_heartbeat_message
_TIMESYNC = wire.MAVLink_timesync_message
_READ: tuple[tuple[Any, tuple[str, ...], Callable[..., Message | None]], ...] = (
    (wire.MAVLink_heartbeat_message, ("type", "autopilot", "base_mode", "custom_mode"), _heartbeat),
    (wire.MAVLink_command_ack_message, ("command", "result"), Ack),
    (wire.MAVLink_timesync_message, ("tc1", "ts1"), TimesyncMessage),
    (
        wire.MAVLink_estimator_status_message,
        ("flags",),
        lambda flags: EstimatorStatus(bool(flags & wire.ESTIMATOR_POS_HORIZ_REL)),
    ),
    (
        wire.MAVLink_extended_sys_state_message,
        ("landed_state",),
        lambda state: LandedState(state == wire.MAV_LANDED_STATE_ON_GROUND),
    ),
    (wire.MAVLink_ekf_status_report_message, ("flags", "pos_horiz_variance"), _ekf),
    (
        wire.MAVLink_sys_status_message,
        ("onboard_control_sensors_health", "battery_remaining"),
        _system_status,
    ),
    (wire.MAVLink_local_position_ned_message, ("time_boot_ms", "x", "y", "z", "vx", "vy", "vz"), _local_position),
    (
        wire.MAVLink_attitude_quaternion_message,
        ("time_boot_ms", "q1", "q2", "q3", "q4", "rollspeed", "pitchspeed", "yawspeed"),
        _attitude,
    ),
    (
        wire.MAVLink_odometry_message,
        (
            "time_usec",
            "frame_id",
            "child_frame_id",
            "estimator_type",
            "quality",
            "reset_counter",
            "pose_covariance",
            "x",
            "y",
            "z",
            "q",
            "vx",
            "vy",
            "vz",
        ),
        _odometry,
    ),
    (wire.MAVLink_gps_global_origin_message, (), _origin),
    (wire.MAVLink_home_position_message, (), _origin),
    (wire.MAVLink_autopilot_version_message, ("flight_sw_version", "uid", "uid2"), _firmware),
    (wire.MAVLink_statustext_message, ("severity", "text"), _status_text),
    (wire.MAVLink_gimbal_device_attitude_status_message, ("time_boot_ms", "q"), _gimbal),
    (
        wire.MAVLink_distance_sensor_message,
        (
            "time_boot_ms",
            "min_distance",
            "max_distance",
            "current_distance",
            "id",
            "orientation",
            "horizontal_fov",
            "vertical_fov",
            "signal_quality",
        ),
        _range,
    ),
    (
        wire.MAVLink_optical_flow_rad_message,
        (
            "time_usec",
            "sensor_id",
            "integration_time_us",
            "integrated_x",
            "integrated_y",
            "integrated_xgyro",
            "integrated_ygyro",
            "integrated_zgyro",
            "quality",
        ),
        _flow_angle,
    ),
    (
        wire.MAVLink_optical_flow_message,
        ("time_usec", "sensor_id", "flow_comp_m_x", "flow_comp_m_y", "flow_rate_x", "flow_rate_y", "quality"),
        _flow_rate,
    ),
    (wire.MAVLink_param_value_message, ("param_id", "param_value", "param_type"), _parameter),
)
_READERS = {kind.id: (MessageLayout(kind, *names), make) for kind, names, make in _READ}
