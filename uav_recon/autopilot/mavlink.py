"""THE codec: MAVLink 2 bytes to values in our frames, and our values to bytes. NED and FRD end here.

Nothing that arrives raises. A frame counts only if its checksum holds; MAVLink 1 frames are dropped and counted.
"""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from uav_recon.autopilot.axes import swap_attitude, swap_body, swap_covariance, swap_world, swap_yaw
from uav_recon.autopilot.messages import (
    Ack,
    Attitude,
    EstimatorStatus,
    Firmware,
    GimbalAttitude,
    Heartbeat,
    LocalPosition,
    Message,
    OriginSet,
    Received,
    StatusText,
    SystemStatus,
    TimeSync,
)
from uav_recon.types.pose import StampedPose
from uav_recon.types.trajectory import Setpoint

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as wire

_MAGIC_1, _MAGIC_2 = 0xFE, 0xFD
_HEADER_1, _HEADER_2, _CHECKSUM, _SIGNATURE = 6, 10, 2, 13
_BUFFER_LIMIT = 1 << 16
_UPPER = np.triu_indices(6)
# (m/s)² and (rad/s)²: the pose filter publishes neither; PX4 reads the first three of the diagonal
_TWIST_COVARIANCE = np.diag([0.1**2] * 3 + [100.0] * 3)[_UPPER].tolist()


class Decoder:
    """Finds frames in a byte stream. Counters: garbage bytes, frames of MAVLink 1, frames of unknown kind."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._mavlink = wire.MAVLink(None)
        self.garbage_bytes = 0
        self.mavlink1_frames = 0
        self.unknown_frames = 0

    def feed(self, data: bytes) -> list[Received]:
        """Every whole frame up to the end of these bytes, oldest first; an unfinished one waits for the next call."""
        self._buffer += data[-_BUFFER_LIMIT:]
        received, at, end = [], 0, len(self._buffer)
        while at < end:
            length = self._frame_length(at)
            if length < 0:
                break
            message = self._checked(at, length) if length else None
            if message is None:
                self.garbage_bytes += 1
                at += 1
                continue
            if self._buffer[at] == _MAGIC_1:
                self.mavlink1_frames += 1
            elif isinstance(message, wire.MAVLink_unknown):
                self.unknown_frames += 1
            else:
                frame = bytes(self._buffer[at : at + length])
                received.append(Received(message.get_srcSystem(), message.get_srcComponent(), _value(message), frame))
            at += length
        del self._buffer[:at]
        return received

    def _frame_length(self, at: int) -> int:
        """Length of the frame that starts here, 0 if none can, -1 if its end has not arrived."""
        magic, left = self._buffer[at], len(self._buffer) - at
        if magic not in (_MAGIC_1, _MAGIC_2):
            return 0
        if left < 3:
            return -1
        if magic == _MAGIC_1:
            length = _HEADER_1 + self._buffer[at + 1] + _CHECKSUM
        elif self._buffer[at + 2] > 1:  # incompatibility flags nobody has defined
            return 0
        else:
            length = _HEADER_2 + self._buffer[at + 1] + _CHECKSUM + (_SIGNATURE if self._buffer[at + 2] else 0)
        return length if left >= length else -1

    def _checked(self, at: int, length: int) -> Any:
        """The wire message, or None if these bytes are not a frame. One of unknown kind counts if another follows it."""
        try:
            message = self._mavlink.decode(self._buffer[at : at + length])
        except (wire.MAVError, ValueError, TypeError, UnicodeDecodeError):
            return None
        if isinstance(message, wire.MAVLink_unknown):
            end = at + length
            return message if end == len(self._buffer) or self._buffer[end] in (_MAGIC_1, _MAGIC_2) else None
        return message


class Encoder:
    """Our voice on the link: system and component id, and our own sequence number. Every method returns one frame."""

    def __init__(self, system: int, component: int) -> None:
        self._mavlink = wire.MAVLink(None, srcSystem=system, srcComponent=component)

    def heartbeat(self) -> bytes:
        """An onboard controller that is active."""
        return self._pack(
            wire.MAVLink_heartbeat_message(
                wire.MAV_TYPE_ONBOARD_CONTROLLER, wire.MAV_AUTOPILOT_INVALID, 0, 0, wire.MAV_STATE_ACTIVE, 3
            )
        )

    def timesync(self, tc1_ns: int, ts1_ns: int) -> bytes:
        """A request (tc1_ns = 0, our clock) or an answer (our clock, their ts1)."""
        return self._pack(wire.MAVLink_timesync_message(tc1_ns, ts1_ns))

    def command(self, target: int, command: int, *parameters: float) -> bytes:
        """COMMAND_LONG to the autopilot of system ``target``; missing parameters are 0."""
        padded = (*parameters, *([0.0] * (7 - len(parameters))))
        return self._pack(wire.MAVLink_command_long_message(target, wire.MAV_COMP_ID_AUTOPILOT1, command, 0, *padded))

    def origin(self, target: int, lat_deg: float, lon_deg: float, alt_m: float) -> bytes:
        """SET_GPS_GLOBAL_ORIGIN: where on the globe the local origin is to be."""
        return self._pack(
            wire.MAVLink_set_gps_global_origin_message(
                target, round(lat_deg * 1e7), round(lon_deg * 1e7), round(alt_m * 1e3), 0
            )
        )

    def odometry(self, pose: StampedPose, time_us: int) -> bytes:
        """ODOMETRY, LOCAL_FRD pose and BODY_FRD velocity; time_us in the autopilot's clock.

        The angular rate is not known here: zero with a variance that says so (nothing on this wire is ever NaN).
        Quality is clipped to 1..100 (0 would say "unknown").
        """
        covariance = swap_covariance(pose.covariance)[_UPPER].tolist()
        velocity_body = pose.odom_from_body.rotation().T @ pose.velocity_odom_mps
        return self._pack(
            wire.MAVLink_odometry_message(
                time_us,
                wire.MAV_FRAME_LOCAL_FRD,
                wire.MAV_FRAME_BODY_FRD,
                *swap_world(pose.odom_from_body.translation_m),
                list(swap_attitude(pose.odom_from_body.quat_wxyz)),
                *swap_body(velocity_body),
                *(0.0, 0.0, 0.0),
                covariance,
                _TWIST_COVARIANCE,
                pose.reset_counter % 256,
                wire.MAV_ESTIMATOR_TYPE_VIO,
                min(max(pose.quality, 1), 100),
            )
        )

    def setpoint(self, target: int, setpoint: Setpoint, time_boot_ms: int) -> bytes:
        """SET_POSITION_TARGET_LOCAL_NED with position, velocity, acceleration, yaw and yaw rate (mask 0)."""
        return self._pack(
            wire.MAVLink_set_position_target_local_ned_message(
                time_boot_ms % (1 << 32),
                target,
                wire.MAV_COMP_ID_AUTOPILOT1,
                wire.MAV_FRAME_LOCAL_NED,
                0,
                *swap_world(setpoint.position_m),
                *swap_world(setpoint.velocity_mps),
                *swap_world(setpoint.acceleration_mps2),
                swap_yaw(setpoint.yaw_rad),
                -setpoint.yaw_rate_radps,
            )
        )

    def gimbal_pitch(self, target: int, pitch_down_rad: float) -> bytes:
        """GIMBAL_MANAGER_SET_PITCHYAW: pitch against the horizon, yaw stays with the vehicle."""
        flags = wire.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | wire.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
        return self._pack(
            wire.MAVLink_gimbal_manager_set_pitchyaw_message(
                target, wire.MAV_COMP_ID_AUTOPILOT1, flags, 0, -pitch_down_rad, 0.0, math.nan, math.nan
            )
        )

    def _pack(self, message: Any) -> bytes:
        frame = bytes(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return frame


def _value(message: Any) -> Message | None:
    """A wire message in our frames, or None for kinds we do not use and numbers that are not finite."""
    make = _READERS.get(message.get_msgId())
    return None if make is None else make(message)


def _heartbeat(m: Any) -> Message:
    return Heartbeat(m.type, m.autopilot, bool(m.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED), m.custom_mode)


def _system_status(m: Any) -> Message:
    bit = wire.MAV_SYS_STATUS_PREARM_CHECK
    battery = m.battery_remaining / 100 if 0 <= m.battery_remaining <= 100 else math.nan
    return SystemStatus(bool(m.onboard_control_sensors_present & m.onboard_control_sensors_health & bit), battery)


def _local_position(m: Any) -> Message | None:
    numbers = np.array([m.x, m.y, m.z, m.vx, m.vy, m.vz])
    if not np.isfinite(numbers).all():
        return None
    return LocalPosition(np.array(swap_world(numbers[:3])), np.array(swap_world(numbers[3:])))


def _attitude(m: Any) -> Message | None:
    quat = np.array([m.q1, m.q2, m.q3, m.q4])
    good = np.isfinite(quat).all() and abs(float(np.linalg.norm(quat)) - 1.0) < 1e-2
    return Attitude(np.array(swap_attitude(quat))) if good else None


def _firmware(m: Any) -> Message:
    number = m.flight_sw_version
    return Firmware((number >> 24 & 0xFF, number >> 16 & 0xFF, number >> 8 & 0xFF))


def _status_text(m: Any) -> Message:
    text = m.text.decode(errors="replace") if isinstance(m.text, bytes) else str(m.text)
    return StatusText(m.severity, "".join(c for c in text if c.isprintable()))


def _gimbal(m: Any) -> Message | None:
    w, x, y, z = m.q
    sine = 2.0 * (w * y - z * x)  # FRD: positive pitch is nose up
    return GimbalAttitude(-math.asin(min(max(sine, -1.0), 1.0))) if math.isfinite(sine) else None


_READERS = {
    wire.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    wire.MAVLINK_MSG_ID_COMMAND_ACK: lambda m: Ack(m.command, m.result),
    wire.MAVLINK_MSG_ID_TIMESYNC: lambda m: TimeSync(m.tc1, m.ts1),
    wire.MAVLINK_MSG_ID_ESTIMATOR_STATUS: lambda m: EstimatorStatus(bool(m.flags & wire.ESTIMATOR_POS_HORIZ_REL)),
    wire.MAVLINK_MSG_ID_SYS_STATUS: _system_status,
    wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    wire.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude,
    wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: lambda m: OriginSet(),
    wire.MAVLINK_MSG_ID_HOME_POSITION: lambda m: OriginSet(),
    wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _firmware,
    wire.MAVLINK_MSG_ID_STATUSTEXT: _status_text,
    wire.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: _gimbal,
}
