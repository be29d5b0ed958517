"""Handlers of the simulated PX4 for received messages."""

from __future__ import annotations

import math
import random

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.base_commands import DENIED, FAILED, FORCE, FORCE_SET, NO_YAW, NO_YAW_RATE, BaseCommands
from sitl.autopilots.ekf import ExternalPose
from sitl.autopilots.mavlink_codec import ReceivedMessage, packet
from sitl.autopilots.mavlink_server import MavlinkServer
from sitl.autopilots.position_controller import ControlSetpoint
from sitl.autopilots.px4.commander import Px4Mode
from sitl.autopilots.px4.state import Px4State

_DUPLICATE_ACKS = 0.5  # share of DO_SET_MODE commands that are acknowledged twice
_POSE_FRAMES = (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_LOCAL_NED)


class Px4Commands(BaseCommands):
    """Handlers of PX4: heartbeats, setpoints, poses, TIMESYNC, modes, arming and the origin."""

    def __init__(self, state: Px4State, server: MavlinkServer, seed: int) -> None:
        super().__init__(state, server)
        self._s = state
        self._random = random.Random(seed)
        self.poses_refused = 0
        self._handlers |= {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._setpoint,
            mavlink.MAVLINK_MSG_ID_ODOMETRY: self._odometry,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._timesync,
            mavlink.MAVLINK_MSG_ID_SET_MODE: self._set_mode,
            mavlink.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: self._origin,
        }

    # -- streams --------------------------------------------------------------------------------------------------

    def _heartbeat(self, message: ReceivedMessage, _arrival_s: float) -> None:
        if message.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER:
            self._s.commander.companion.heard(self._s.now_s)

    def _setpoint(self, message: ReceivedMessage, arrival_s: float) -> None:
        """Store a setpoint for OFFBOARD; masked fields become NaN.

        A setpoint without any field does not count for the stream (PX4 mavlink_receiver).
        """
        s = self._s
        mask = message.type_mask
        if message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED:
            self._server.say(mavlink.MAV_SEVERITY_CRITICAL, "SET_POSITION_TARGET_LOCAL_NED: frame not supported")
            return
        raw = (message.x, message.y, message.z, message.vx, message.vy, message.vz, message.afx, message.afy, message.afz)
        f = [math.nan if mask >> i & 1 or not math.isfinite(value) else value for i, value in enumerate(raw)]
        if mask & FORCE_SET or all(math.isnan(value) for value in f):
            return
        yaw = math.nan if mask & NO_YAW else message.yaw
        yaw_rate = math.nan if mask & NO_YAW_RATE else message.yaw_rate
        s.flight.offboard = ControlSetpoint((f[0], f[1], f[2]), (f[3], f[4], f[5]), (f[6], f[7], f[8]), yaw, yaw_rate)
        s.commander.stream.arrived(s.now_s)
        if s.commander.armed and s.commander.mode is Px4Mode.OFFBOARD:
            self.setpoint_arrivals_s.append(arrival_s)

    def _odometry(self, message: ReceivedMessage, arrival_s: float) -> None:
        """Pass an external pose to the estimator; poses in other frames are dropped silently."""
        s = self._s
        if message.frame_id not in _POSE_FRAMES or message.child_frame_id != mavlink.MAV_FRAME_BODY_FRD:
            self.poses_refused += 1
            return
        arrival_us = round((arrival_s - s.boot_s) * 1e6)
        stamp_us = s.timesync.local_us(message.time_usec, arrival_us)
        covariance = message.pose_covariance  # upper triangle: x 0, y 6, z 11, roll 15, pitch 18, yaw 20
        position_variance = max(covariance[0], covariance[6], covariance[11]) if math.isfinite(covariance[0]) else math.nan
        if not s.estimator.started:  # LOCAL_FRD is fused, too, but gives no global position (measured)
            s.commander.heading_known = message.frame_id == mavlink.MAV_FRAME_LOCAL_NED
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

    def _timesync(self, message: ReceivedMessage, arrival_s: float) -> None:
        s = self._s
        if message.tc1 == 0:  # a request
            self._answer_timesync(message)
        elif message.tc1 > 0:
            arrival_us = round((arrival_s - s.boot_s) * 1e6)
            s.timesync.answered(arrival_us, message.tc1, message.ts1)

    # -- origin ---------------------------------------------------------------------------------------------------

    def _origin(self, message: ReceivedMessage, _arrival_s: float) -> None:
        """Set the origin. Before the first fused pose it moves the local height to its altitude.

        Measured: z = 488 m.
        """
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

    def _command(self, command: int, p: tuple[float, ...], sender: tuple[int, int]) -> int:
        result = super()._command(command, p, sender)
        if command == mavlink.MAV_CMD_DO_SET_MODE and self._random.random() < _DUPLICATE_ACKS:
            self._server.acknowledge(command, result, sender)
        return result

    def _carry_out(self, command: int, p: tuple[float, ...]) -> int | None:
        s = self._s
        if command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL and p[0] == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return FAILED  # HEARTBEAT is sent at 1 Hz and on request only (measured)
        if command == mavlink.MAV_CMD_DO_SET_MODE:
            if not int(p[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
                return DENIED
            return s.commander.request_mode(int(p[1]) << 16 | int(p[2]) << 24, s.condition())
        if command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            return s.commander.request_arming(p[0] > 0.5, p[1] == FORCE, s.condition())
        if command == mavlink.MAV_CMD_NAV_LAND:
            return s.commander.request_mode(Px4Mode.LAND, s.condition())
        return None

    def _set_mode(self, message: ReceivedMessage, _arrival_s: float) -> None:
        """Handle SET_MODE, the deprecated message; it is not acknowledged."""
        self._s.commander.request_mode(message.custom_mode, self._s.condition())
