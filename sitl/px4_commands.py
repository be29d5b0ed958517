"""What the simulated PX4 does with each message from outside."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from sitl.control import ControlSetpoint
from sitl.estimator import ExternalPose
from sitl.mavlink_server import MavlinkServer
from sitl.mavlink_wire import Heard, packet
from sitl.px4_modes import ACCEPTED, DENIED, FORCE, UNSUPPORTED, Mode
from sitl.px4_state import State

_FORCE_SET = 512
_DUPLICATE_ACKS = 0.5  # share of DO_SET_MODE that is acknowledged twice
_POSE_FRAMES = (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_LOCAL_NED)


class Commands:
    """Dispatches messages by id; unknown ones are left alone."""

    def __init__(self, state: State, server: MavlinkServer, seed: int) -> None:
        self._s = state
        self._server = server
        self._random = random.Random(seed)
        self.setpoint_arrivals_s: list[float] = []
        self.poses_refused = 0
        self._handlers: dict[int, Callable[[Heard, float], None]] = {
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._setpoint,
            mavlink.MAVLINK_MSG_ID_ODOMETRY: self._odometry,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._timesync,
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG: self._command_long,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT: self._command_int,
            mavlink.MAVLINK_MSG_ID_SET_MODE: self._set_mode,
            mavlink.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: self._origin,
            mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_PITCHYAW: self._gimbal_pitch,
        }

    def take(self, message: Heard, arrival_s: float) -> None:
        """Act on one message that arrived at arrival_s (world clock)."""
        handler = self._handlers.get(message.kind)
        if handler is not None:
            handler(message, arrival_s)
        else:
            self._server.take_parameter_message(message)

    # -- streams --------------------------------------------------------------------------------------------------

    def _setpoint(self, message: Heard, arrival_s: float) -> None:
        """Masked fields become NaN; a setpoint that controls nothing is no proof of life (PX4 mavlink_receiver)."""
        s = self._s
        mask = message.type_mask
        if message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED:
            self._server.say(mavlink.MAV_SEVERITY_CRITICAL, "SET_POSITION_TARGET_LOCAL_NED: frame not supported")
            return
        raw = (message.x, message.y, message.z, message.vx, message.vy, message.vz, message.afx, message.afy, message.afz)
        f = [math.nan if mask >> i & 1 or not math.isfinite(value) else value for i, value in enumerate(raw)]
        if mask & _FORCE_SET or all(math.isnan(value) for value in f):
            return
        yaw = math.nan if mask & 1024 else message.yaw
        yaw_rate = math.nan if mask & 2048 else message.yaw_rate
        s.flight.offboard = ControlSetpoint((f[0], f[1], f[2]), (f[3], f[4], f[5]), (f[6], f[7], f[8]), yaw, yaw_rate)
        s.commander.stream.arrived(s.now_s)
        if s.commander.armed and s.commander.mode is Mode.OFFBOARD:
            self.setpoint_arrivals_s.append(arrival_s)

    def _odometry(self, message: Heard, arrival_s: float) -> None:
        """External vision. Other frames are not poses of the body and are dropped without a word."""
        s = self._s
        if message.frame_id not in _POSE_FRAMES or message.child_frame_id != mavlink.MAV_FRAME_BODY_FRD:
            self.poses_refused += 1
            return
        arrival_us = round((arrival_s - s.boot_s) * 1e6)
        stamp_us = s.timesync.local_us(message.time_usec, arrival_us)
        covariance = message.pose_covariance  # upper triangle: x 0, y 6, z 11, roll 15, pitch 18, yaw 20
        position_variance = max(covariance[0], covariance[6], covariance[11]) if math.isfinite(covariance[0]) else math.nan
        s.estimator.take(
            ExternalPose(
                stamp_us * 1e-6,
                (message.x, message.y, message.z),
                (message.q[0], message.q[1], message.q[2], message.q[3]),
                position_variance,
                covariance[20] if math.isfinite(covariance[0]) else math.nan,
                message.quality,
                message.reset_counter,
            )
        )

    def _timesync(self, message: Heard, arrival_s: float) -> None:
        s = self._s
        if message.tc1 == 0:  # a question
            answer = packet(mavlink.MAVLink_timesync_message, s.boot_us * 1000, message.ts1)
            self._server.send(answer)
        elif message.tc1 > 0:
            arrival_us = round((arrival_s - s.boot_s) * 1e6)
            s.timesync.answered(arrival_us, message.tc1, message.ts1)

    # -- origin ---------------------------------------------------------------------------------------------------

    def _origin(self, message: Heard, _arrival_s: float) -> None:
        """Before the first fused pose it drags the local height to the origin's altitude (measured: z = 488 m)."""
        s = self._s
        if s.commander.armed:
            return
        if not s.estimator.started and s.origin is None:
            s.estimator.offset_height(message.altitude * 1e-3)
        s.origin = (message.latitude, message.longitude, message.altitude)
        s.estimator.origin_set = True
        s.commander.origin_at_s = min(s.commander.origin_at_s, s.now_s)
        self._server.send(packet(mavlink.MAVLink_gps_global_origin_message, *s.origin, s.boot_us))
        if s.estimator.started:
            s.home = s.estimator.position
            self._server.request(mavlink.MAVLINK_MSG_ID_HOME_POSITION)

    # -- commands -------------------------------------------------------------------------------------------------

    def _command_long(self, m: Heard, _arrival_s: float) -> None:
        parameters = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
        self._command(m.command, parameters, m.sender)

    def _command_int(self, m: Heard, _arrival_s: float) -> None:
        parameters = (m.param1, m.param2, m.param3, m.param4, float(m.x), float(m.y), m.z)
        self._command(m.command, parameters, m.sender)

    def _command(self, command: int, p: tuple[float, ...], sender: tuple[int, int]) -> None:
        result = self._carry_out(command, p, sender)
        self._server.acknowledge(command, result, sender)
        if command == mavlink.MAV_CMD_DO_SET_MODE and self._random.random() < _DUPLICATE_ACKS:
            self._server.acknowledge(command, result, sender)

    def _carry_out(self, command: int, p: tuple[float, ...], sender: tuple[int, int]) -> int:
        s = self._s
        if command == mavlink.MAV_CMD_DO_SET_MODE:
            if not int(p[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
                return DENIED
            return s.commander.request_mode(int(p[1]) << 16 | int(p[2]) << 24, s.condition())
        if command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            return s.commander.request_arming(p[0] > 0.5, p[1] == FORCE, s.condition())
        if command == mavlink.MAV_CMD_NAV_LAND:
            return s.commander.request_mode(Mode.LAND, s.condition())
        if command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return ACCEPTED if self._server.set_interval(int(p[0]), p[1], s.now_s) else DENIED
        if command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            return ACCEPTED if self._server.request(int(p[0])) else DENIED
        if command == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            return ACCEPTED if self._server.request(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION) else DENIED
        if command == mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE:
            return self._gimbal_owner(p, sender)
        if command == mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW:  # degrees, unlike the message
            moved = s.gimbal.command(sender, math.radians(p[0]), math.radians(p[2]))
            return ACCEPTED if moved else DENIED
        return UNSUPPORTED

    def _gimbal_owner(self, p: tuple[float, ...], sender: tuple[int, int]) -> int:
        """An id of 0 or more is the new owner, -1 leaves it, -2 takes it for the sender, -3 gives it up."""
        wanted = (int(p[0]), int(p[1]))
        if wanted[0] >= 0 and wanted[1] >= 0:
            self._s.gimbal.configure(*wanted)
        elif wanted[0] == -3 and self._s.gimbal.owner == sender:
            self._s.gimbal.configure(0, 0)
        elif wanted[0] == -2:
            self._s.gimbal.configure(*sender)
        return ACCEPTED

    def _set_mode(self, message: Heard, _arrival_s: float) -> None:
        """The old message: no acknowledgement."""
        self._s.commander.request_mode(message.custom_mode, self._s.condition())

    def _gimbal_pitch(self, message: Heard, _arrival_s: float) -> None:
        """Radians, positive up. Silently without effect from anyone who did not take primary control (read)."""
        self._s.gimbal.command(message.sender, message.pitch, message.pitch_rate)
