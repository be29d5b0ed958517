"""Handlers of the simulated ArduCopter for received messages."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.ardupilot.mode_controllers import ControllerTarget
from sitl.autopilots.ardupilot.modes import ArduPilotMode
from sitl.autopilots.ardupilot.state import ArduPilotState
from sitl.autopilots.base_commands import ACCEPTED, DENIED, FAILED, FORCE, FORCE_SET, NO_YAW, NO_YAW_RATE, BaseCommands
from sitl.autopilots.ekf import ExternalPose
from sitl.autopilots.mavlink_codec import ReceivedMessage, packet
from sitl.autopilots.mavlink_server import MavlinkServer
from sitl.geometry.quaternion import Quat, Vec3, from_euler

_NO_POSITION = 0b111
_NO_VELOCITY = 0b111000
_NO_ACCELERATION = 0b111000000
_STILL: Vec3 = (0.0, 0.0, 0.0)


class ArduPilotCommands(BaseCommands):
    """Handlers of ArduCopter: targets, poses, TIMESYNC, modes, arming, take-off and the origin."""

    def __init__(self, state: ArduPilotState, server: MavlinkServer) -> None:
        super().__init__(state, server)
        self._s = state
        self._handlers |= {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._target,
            mavlink.MAVLINK_MSG_ID_ODOMETRY: self._odometry,
            mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE: self._vision,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._timesync,
            mavlink.MAVLINK_MSG_ID_SET_MODE: self._set_mode,
            mavlink.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: self._origin,
        }

    # -- streams --------------------------------------------------------------------------------------------------

    def _heartbeat(self, message: ReceivedMessage, _arrival_s: float) -> None:
        self._s.commander.heartbeat_from(message.sender, message.type, self._s.now_s)

    def _target(self, m: ReceivedMessage, arrival_s: float) -> None:
        """Follow a target in GUIDED; ignored in other modes.

        An unusable mask or number makes the vehicle hold its position. A position outside the fence is ignored silently.
        """
        s, mask = self._s, m.type_mask
        if s.commander.mode is not ArduPilotMode.GUIDED:
            return
        if s.commander.armed:
            self.setpoint_arrivals_s.append(arrival_s)
        position = None if mask & _NO_POSITION else (m.x, m.y, m.z)
        velocity = _STILL if mask & _NO_VELOCITY else (m.vx, m.vy, m.vz)
        acceleration = _STILL if mask & _NO_ACCELERATION else (m.afx, m.afy, m.afz)
        if not _flyable(m, (*(position or _STILL), *velocity, *acceleration)):
            s.flight.stop(s.estimator.position, s.estimator.yaw)
            return
        if position is not None and not self._inside(position):
            return
        yaw, yaw_rate = (math.nan if mask & NO_YAW else m.yaw), (math.nan if mask & NO_YAW_RATE else m.yaw_rate)
        s.flight.follow(ControllerTarget(position, velocity, acceleration, yaw, yaw_rate))

    def _inside(self, position: Vec3) -> bool:
        home = self._s.home
        if home is None:
            return True
        return self._s.commander.admits(math.hypot(position[0] - home[0], position[1] - home[1]), home[2] - position[2])

    def _odometry(self, message: ReceivedMessage, arrival_s: float) -> None:
        """Process an external pose; poses in other frames are dropped silently (from the sources)."""
        if message.frame_id != mavlink.MAV_FRAME_LOCAL_FRD or message.child_frame_id != mavlink.MAV_FRAME_BODY_FRD:
            return
        q = message.q
        self._fuse(message, arrival_s, message.time_usec, message.pose_covariance, (q[0], q[1], q[2], q[3]), message.quality)

    def _vision(self, message: ReceivedMessage, arrival_s: float) -> None:
        """Process a VISION_POSITION_ESTIMATE; it has no quality, so VISO_QUAL_MIN must be 0."""
        attitude = from_euler(message.roll, message.pitch, message.yaw)
        self._fuse(message, arrival_s, message.usec, message.covariance, attitude, 0)

    def _fuse(
        self, message: ReceivedMessage, arrival_s: float, stamp_us: int, covariance: tuple[float, ...], quat: Quat, quality: int
    ) -> None:
        """Pass a pose to the estimator once that is active.

        covariance: upper triangle, x 0, y 6, z 11, roll 15, pitch 18, yaw 20.
        """
        s = self._s
        local_us = s.jitter.local_us(stamp_us, round((arrival_s - s.boot_s) * 1e6))
        if not s.ekf_active:
            return
        known = math.isfinite(covariance[0])
        s.estimator.take(
            ExternalPose(
                local_us * 1e-6,
                (message.x, message.y, message.z),
                quat,
                max(covariance[0], covariance[6], covariance[11]) if known else math.nan,
                covariance[20] if known else math.nan,
                quality,
                message.reset_counter,
            )
        )

    def _timesync(self, message: ReceivedMessage, _arrival_s: float) -> None:
        """Answer requests; answers to its own requests are logged only (from the sources)."""
        if message.tc1 == 0:
            self._answer_timesync(message)

    # -- origin ---------------------------------------------------------------------------------------------------

    def _origin(self, message: ReceivedMessage, _arrival_s: float) -> None:
        """Set the origin, once per boot.

        An origin received before the position is valid is accepted, but home is then never set (measured).
        """
        s = self._s
        if s.origin is not None:
            return
        s.origin = (message.latitude, message.longitude, message.altitude)
        s.home_follows = s.estimator.horizontal_valid
        self._server.request(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        s.settle_home()
        self._server.request(mavlink.MAVLINK_MSG_ID_HOME_POSITION)

    # -- commands -------------------------------------------------------------------------------------------------

    def _carry_out(self, command: int, p: tuple[float, ...]) -> int | None:
        s = self._s
        if command == mavlink.MAV_CMD_DO_SET_MODE:
            if not int(p[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
                return DENIED
            return s.commander.request_mode(int(p[1]), s.condition())
        if command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            return s.commander.request_arming(p[0] > 0.5, p[1] == FORCE, s.condition())
        if command == mavlink.MAV_CMD_NAV_TAKEOFF:
            return self._take_off(p[6])
        if command == mavlink.MAV_CMD_NAV_LAND:
            return s.commander.request_mode(ArduPilotMode.LAND, s.condition())
        return None

    def _take_off(self, height_m: float) -> int:
        s = self._s
        if not s.commander.may_take_off(s.condition()) or not height_m > 0.0:
            return FAILED
        s.flight.take_off(height_m)
        return ACCEPTED

    def _set_mode(self, message: ReceivedMessage, _arrival_s: float) -> None:
        """Handle SET_MODE, the old message; COMMAND_ACK carries its message id (from the sources)."""
        result = self._s.commander.request_mode(message.custom_mode, self._s.condition())
        self._server.send(packet(mavlink.MAVLink_command_ack_message, mavlink.MAVLINK_MSG_ID_SET_MODE, result))


def _flyable(m: ReceivedMessage, numbers: tuple[float, ...]) -> bool:
    """Return True for a finite target in LOCAL_NED with a velocity or with a position alone.

    A velocity may come with a position. Acceleration alone is not simulated.
    """
    mask = m.type_mask
    has_place, moves, pushes = not mask & _NO_POSITION, not mask & _NO_VELOCITY, not mask & _NO_ACCELERATION
    if m.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED or (mask & FORCE_SET and pushes):
        return False
    return all(math.isfinite(x) for x in numbers) and (moves or (has_place and not pushes))
