"""Scripted companion for tests of the simulated autopilots.

It uses pymavlink only, a perfect pose feed, and injected time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.byte_links import ByteEnd, pipe
from sitl.autopilots.px4.autopilot import Px4
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.geometry.ned_frd import ned_frd_from_enu_flu
from sitl.world.quadrotor import Quadrotor

LOITER, LAND, OFFBOARD, POSCTL = 50593792, 100925440, 393216, 196608
PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK
POSITION_ONLY = 0b110111111000 & ~(1 << 10)
TICK_S = 0.01
CLOCK_AHEAD_S = 1000.0  # companion clock minus world clock


class Companion:
    """Companion that owns the world's clock.

    Each tick runs physics and telemetry, and sends a pose at 50 Hz, a setpoint at setpoint_hz and a heartbeat.
    """

    system = 42

    def __init__(self, parameters: Any = None, seed: int = 1, wind_mps: float = 0.15, yaw_rad: float = 0.3) -> None:
        self.now_s = 500.0
        self.vehicle = Quadrotor(seed, wind_mps=wind_mps, yaw_rad=yaw_rad)
        end, mine = pipe()
        self.autopilot = self._make(end, parameters, seed)
        self._pipe = mine
        self._codec: Any = mavlink.MAVLink(None, self.system, 191)
        self.last: dict[str, Any] = {}
        self.acks: list[tuple[int, int]] = []
        self.texts: list[str] = []
        self.modes: list[tuple[float, int]] = []
        self.messages: list[Any] = []
        self.keep: set[str] = set()
        self.pose_on = True
        self.pose_offset = (0.0, 0.0, 0.0)
        self.pose_quality = 90
        self.pose_frame = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD)
        self.reset_counter = 0
        self.pose_age_s = 0.0
        self.stamp_shift_s = 0.0
        self.answer_timesync = True
        self.heartbeats = True
        self.setpoint: Callable[[float], tuple[Any, ...]] | None = None
        self.setpoint_hz = 30.0
        self.type_mask = 0
        self._past: list[tuple[float, Any, Any]] = []
        self._ticks = 0
        self._next_setpoint_s = 0.0
        self.autopilot.step(self.now_s)

    def _make(self, end: ByteEnd, parameters: Any, seed: int) -> Any:
        return Px4(self.vehicle, end, parameters or Px4Parameters.load(), seed)

    @property
    def px4(self) -> Px4:
        """The autopilot, which must be a PX4."""
        assert isinstance(self.autopilot, Px4)
        return self.autopilot

    # -- sending ---

    def send(self, message: Any) -> None:
        self._pipe.write(message.pack(self._codec))

    def command(self, command: int, *p: float) -> None:
        values = [*p, *[0.0] * (7 - len(p))]
        self.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, *values))

    def ask(self, command: int, *p: float) -> int:
        """Send a command and return the result of its first acknowledgement."""
        self.acks.clear()
        self.command(command, *p)
        self.run(0.1)
        return next(result for acked, result in self.acks if acked == command)

    def set_mode(self, custom_mode: int) -> int:
        return self.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, custom_mode >> 16 & 0xFF, custom_mode >> 24)

    def arm(self) -> int:
        return self.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def send_origin(self) -> None:
        self.send(mavlink.MAVLink_set_gps_global_origin_message(1, 473977000, 85456000, 488000))

    def go_to(self, x: float, y: float, z: float, yaw: float = 0.0) -> None:
        """Stream a fixed setpoint, local NED."""
        self.setpoint = lambda _t: (x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, yaw, 0.0)

    # -- time ---

    def run(self, seconds: float, until: Callable[[], bool] | None = None) -> bool:
        """Let time pass; return True as soon as `until` holds."""
        for _ in range(round(seconds / TICK_S)):
            self._tick()
            if until is not None and until():
                return True
        return until is None

    def _tick(self) -> None:
        self._ticks += 1
        self.now_s = 500.0 + self._ticks * TICK_S
        self.autopilot.step(self.now_s)
        v = self.vehicle
        self._past.append((self.now_s, v.position, v.quat_wxyz))
        self._past = self._past[-60:]
        self._hear()
        if self.pose_on and self._ticks % 2 == 0:
            self._send_pose()
        if self.setpoint is not None and self.now_s >= self._next_setpoint_s - 1e-9:
            self._next_setpoint_s = max(self._next_setpoint_s + 1.0 / self.setpoint_hz, self.now_s)
            target = self.setpoint(self.now_s)
            self.send(mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, self.type_mask, *target))
        if self.heartbeats and self._ticks % 100 == 0:
            self.send_heartbeat()

    def send_heartbeat(self) -> None:
        self.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))

    def _send_pose(self) -> None:
        wanted = self.now_s - self.pose_age_s
        stamp_s, p, q = min(self._past, key=lambda entry: abs(entry[0] - wanted))
        ox, oy, oz = self.pose_offset
        covariance = [0.0] * 21
        for i, value in ((0, 1e-4), (6, 1e-4), (11, 1e-4), (20, 1e-5)):
            covariance[i] = value
        stamp_us = round((stamp_s + CLOCK_AHEAD_S + self.stamp_shift_s) * 1e6)
        self.send(
            mavlink.MAVLink_odometry_message(
                stamp_us, *self.pose_frame, p[1] + ox, p[0] + oy, -p[2] + oz, ned_frd_from_enu_flu(q), 0.0, 0.0, 0.0,
                0.0, 0.0, 0.0, covariance, covariance, self.reset_counter, 3, self.pose_quality,
            )
        )  # fmt: skip

    def _hear(self) -> None:
        for m in self._codec.parse_buffer(self._pipe.read()) or []:
            kind = m.get_type()
            self.last[kind] = m
            if kind in self.keep:
                self.messages.append(m)
            if kind == "COMMAND_ACK":
                self.acks.append((m.command, m.result))
            elif kind == "STATUSTEXT":
                self.texts.append(m.text)
            elif kind == "HEARTBEAT":
                self.modes.append((self.now_s, m.custom_mode))
            elif kind == "TIMESYNC" and m.tc1 == 0 and self.answer_timesync:
                ours_ns = round((self.now_s + CLOCK_AHEAD_S) * 1e9)
                self.send(mavlink.MAVLink_timesync_message(ours_ns, m.ts1))

    # -- state ---

    @property
    def mode(self) -> int:
        return int(self.last["HEARTBEAT"].custom_mode)

    @property
    def armed(self) -> bool:
        return bool(self.last["HEARTBEAT"].base_mode & 128)

    @property
    def prearm(self) -> bool:
        return bool(self.last["SYS_STATUS"].onboard_control_sensors_health & PREARM)

    @property
    def flags(self) -> int:
        return int(self.last["ESTIMATOR_STATUS"].flags)

    @property
    def ned(self) -> tuple[float, float, float]:
        """True position, local NED."""
        p = self.vehicle.position
        return (p[1], p[0], -p[2])

    def away_from(self, x: float, y: float, z: float) -> float:
        """Distance of the true position from a local NED point."""
        n = self.ned
        return math.dist(n, (x, y, z))

    # -- sequences ---

    def ready(self) -> None:
        """Wait until the pose is fused, send the origin, and wait for PREARM."""
        assert self.run(5.0, lambda: "ESTIMATOR_STATUS" in self.last and bool(self.flags & 8))
        self.send_origin()
        assert self.run(8.0, lambda: self.prearm)

    def take_off(self, height: float = 1.2) -> None:
        """Arm in OFFBOARD and climb by setpoint to a hover above the pad."""
        self.ready()
        self.go_to(0.0, 0.0, -height, math.pi / 2 - 0.3)
        self.run(1.2)
        assert self.set_mode(OFFBOARD) == 0
        assert self.run(2.0, lambda: self.mode == OFFBOARD)
        assert self.arm() == 0
        assert self.run(15.0, lambda: self.away_from(0.0, 0.0, -height) < 0.05)
        self.run(1.0)
