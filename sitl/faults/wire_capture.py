"""Captured MAVLink of the product, decoded into the world's axes.

pymavlink decodes it; no code of the product is used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

from sitl.faults.mavlink_proxy import frames, message_id

F64 = NDArray[np.float64]
_AUTOPILOTS = (3, 12)  # MAV_AUTOPILOT of ArduPilot and PX4
MODE_OR_ARM = frozenset(
    {
        mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_NAV_TAKEOFF,
        mavlink.MAV_CMD_NAV_LAND, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, mavlink.MAV_CMD_MISSION_START,
        mavlink.MAV_CMD_DO_FLIGHTTERMINATION,
    }
)  # fmt: skip
FORCE_ARM_MAGIC = 21196.0
_CHECKED = ("SET_POSITION_TARGET_LOCAL_NED", "ODOMETRY", "COMMAND_LONG", "COMMAND_INT")


@dataclass(frozen=True)
class CapturedCommand:
    """A command of the product: time, number, and its first two parameters."""

    stamp_s: float
    command: int
    first: float
    second: float


@dataclass(frozen=True)
class WireCapture:
    """Decoded messages of the product, in the world's ENU axes and on its clock.

    setpoint_s (N,): arrival time of each setpoint. setpoint_stamp_ms (N,): the sender's timestamp. position_m, velocity_mps and
    acceleration_mps2 (N, 3), yaw_rate_radps (N,).
    odometry_s (M,), odometry_m (M, 3), odometry_yaw_rad (M,), -pi to pi; odometry_stamp_us (M,), on the autopilot's clock;
    reset_counter (M,).
    texts: (time, STATUSTEXT).
    not_finite: number of setpoints, poses and commands that contain a NaN or an infinity.
    yaw_rad (N,): yaw of the setpoints, from the world's x axis towards its y axis; NaN where a setpoint has none. It is empty
    where no check needs it.
    """

    setpoint_s: F64
    setpoint_stamp_ms: F64
    position_m: F64
    velocity_mps: F64
    acceleration_mps2: F64
    yaw_rate_radps: F64
    odometry_s: F64
    odometry_m: F64
    odometry_yaw_rad: F64
    odometry_stamp_us: F64
    reset_counter: F64
    orders: tuple[CapturedCommand, ...]
    texts: tuple[tuple[float, str], ...]
    not_finite: int
    yaw_rad: F64 = field(default_factory=lambda: np.zeros(0))


def decode(sent: Sequence[tuple[float, bytes]]) -> WireCapture:
    """Decode all that the product wrote.

    sent: (time, bytes).
    """
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    setpoints: list[tuple[float, ...]] = []
    odometry: list[tuple[float, ...]] = []
    orders: list[CapturedCommand] = []
    texts: list[tuple[float, str]] = []
    not_finite = 0
    for stamp_s, data in sent:
        for m in parser.parse_buffer(data) or ():
            kind = m.get_type()
            if kind == "SET_POSITION_TARGET_LOCAL_NED":
                place, speed = (m.y, m.x, -m.z), (m.vy, m.vx, -m.vz)
                push = (m.afy, m.afx, -m.afz) if not m.type_mask & 0x1C0 else (0.0, 0.0, 0.0)
                turn = m.yaw_rate if not m.type_mask & 2048 else 0.0
                yaw = math.pi / 2.0 - m.yaw if not m.type_mask & 1024 else math.nan
                setpoints.append((stamp_s, float(m.time_boot_ms), *place, *speed, *push, turn, yaw))
            elif kind == "ODOMETRY":
                odometry.append((stamp_s, *_enu(m), _yaw_rad(m), float(m.time_usec), float(m.reset_counter)))
            elif kind in {"COMMAND_LONG", "COMMAND_INT"}:
                orders.append(CapturedCommand(stamp_s, m.command, m.param1, m.param2))
            elif kind == "SET_MODE":
                orders.append(CapturedCommand(stamp_s, mavlink.MAV_CMD_DO_SET_MODE, float(m.base_mode), float(m.custom_mode)))
            elif kind == "STATUSTEXT":
                texts.append((stamp_s, str(m.text)))
            not_finite += kind in _CHECKED and not math.isfinite(sum(_numbers(m)))  # one NaN makes the sum NaN
    s = np.array(setpoints, dtype=np.float64).reshape(-1, 13)
    o = np.array(odometry, dtype=np.float64).reshape(-1, 7)
    return WireCapture(
        s[:, 0], s[:, 1], s[:, 2:5], s[:, 5:8], s[:, 8:11], s[:, 11], o[:, 0], o[:, 1:4], o[:, 4], o[:, 5],
        o[:, 6],
        tuple(orders), tuple(texts), not_finite, s[:, 12],
    )  # fmt: skip


def setpoints_in(arrived: Sequence[tuple[float, bytes]]) -> F64:
    """Return the times (N,) of the intact setpoints among whole frames."""
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    kind = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
    whole = [(stamp_s, frame) for stamp_s, frame in arrived if message_id(frame) == kind]
    found = [stamp_s for stamp_s, frame in whole for m in parser.parse_buffer(frame) or () if m.get_msgId() == kind]
    return np.array(found, dtype=np.float64)


def heartbeats_in(heard: Sequence[tuple[float, bytes]], system: int = 1) -> list[tuple[float, int, bool]]:
    """Return (time, custom mode, armed) of each heartbeat that reached the product.

    Only the HEARTBEAT messages of autopilots with the given system id count, not those of a router or a ground station.
    """
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    found = []
    for stamp_s, data in heard:
        wanted = data if parser.buf_len() else _heartbeats(data)
        for m in parser.parse_buffer(wanted) or () if wanted else ():
            if m.get_type() == "HEARTBEAT" and m.get_srcSystem() == system and m.autopilot in _AUTOPILOTS:
                found.append((stamp_s, int(m.custom_mode), bool(m.base_mode & 128)))
    return found


def _heartbeats(data: bytes) -> bytes:
    """Return the heartbeat frames, to save decoding the others.

    Data that is not whole frames only is returned unchanged.
    """
    *whole, rest = frames(data + b"\0")  # it remains a separate piece only after whole frames
    if rest != b"\0":
        return data
    return b"".join(frame for frame in whole if message_id(frame) == mavlink.MAVLINK_MSG_ID_HEARTBEAT)


def _numbers(m: mavlink.MAVLink_message) -> list[float]:
    """Return all numbers of a message, those of arrays too."""
    values = [getattr(m, name) for name in m.get_fieldnames()]
    return [float(v) for value in values for v in (value if isinstance(value, (list, tuple)) else (value,))]


def _enu(m: mavlink.MAVLink_odometry_message) -> tuple[float, float, float]:
    """Return the position in ENU, NaN where a number is not finite.

    A product without a compass sends LOCAL_FRD with north along the world's y axis, as in LOCAL_NED.
    """
    return (m.y, m.x, -m.z) if all(map(math.isfinite, (m.x, m.y, m.z))) else (math.nan,) * 3


def _yaw_rad(m: mavlink.MAVLink_odometry_message) -> float:
    """Return the yaw from the world's x axis towards its y axis, NaN if a number is not finite.

    In the message's quaternion, north is along the world's y axis.
    """
    w, x, y, z = m.q
    from_north = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return math.remainder(math.pi / 2.0 - from_north, math.tau) if math.isfinite(from_north) else math.nan
