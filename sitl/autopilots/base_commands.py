"""Handlers of received messages common to both autopilots: commands, gimbal, parameters."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.autopilot_state import AutopilotState
from sitl.autopilots.mavlink_codec import ReceivedMessage, packet
from sitl.autopilots.mavlink_server import MavlinkServer

ACCEPTED = 0
TEMPORARILY_REJECTED = 1
DENIED = 2
UNSUPPORTED = 3
FAILED = 4
FORCE = 21196.0  # second parameter of MAV_CMD_COMPONENT_ARM_DISARM that overrides all checks
FORCE_SET = 512  # bit of a setpoint's type mask: its accelerations are forces
# bits of a setpoint's type mask
NO_YAW = 1024
NO_YAW_RATE = 2048


class BaseCommands(ABC):
    """Dispatcher of received messages by id; unknown ones are ignored."""

    def __init__(self, board: AutopilotState, server: MavlinkServer) -> None:
        self._board = board
        self._server = server
        self.setpoint_arrivals_s: list[float] = []
        self._handlers: dict[int, Callable[[ReceivedMessage, float], None]] = {
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG: self._command_long,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT: self._command_int,
            mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_PITCHYAW: self._gimbal_pitch,
        }

    def take(self, message: ReceivedMessage, arrival_s: float) -> None:
        """Handle one message that arrived at arrival_s (world clock)."""
        handler = self._handlers.get(message.kind)
        if handler is not None:
            handler(message, arrival_s)
        else:
            self._server.take_parameter_message(message)

    def _answer_timesync(self, message: ReceivedMessage) -> None:
        """Answer a TIMESYNC request with the autopilot's clock."""
        self._server.send(packet(mavlink.MAVLink_timesync_message, self._board.boot_us * 1000, message.ts1))

    # -- commands -------------------------------------------------------------------------------------------------

    def _command_long(self, m: ReceivedMessage, _arrival_s: float) -> None:
        parameters = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
        self._command(m.command, parameters, m.sender)

    def _command_int(self, m: ReceivedMessage, _arrival_s: float) -> None:
        parameters = (m.param1, m.param2, m.param3, m.param4, float(m.x), float(m.y), m.z)
        self._command(m.command, parameters, m.sender)

    def _command(self, command: int, p: tuple[float, ...], sender: tuple[int, int]) -> int:
        result = self._carry_out(command, p)
        if result is None:
            result = self._carry_out_shared(command, p, sender)
        self._server.acknowledge(command, result, sender)
        return result

    @abstractmethod
    def _carry_out(self, command: int, p: tuple[float, ...]) -> int | None:
        """Execute a command of this firmware only; return its MAV_RESULT, None for other commands."""

    def _carry_out_shared(self, command: int, p: tuple[float, ...], sender: tuple[int, int]) -> int:
        if command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return ACCEPTED if self._server.set_interval(int(p[0]), p[1], self._board.now_s) else DENIED
        if command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            return ACCEPTED if self._server.request(int(p[0])) else DENIED
        if command == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            return ACCEPTED if self._server.request(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION) else DENIED
        if command == mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE:
            return self._gimbal_owner(p, sender)
        if command == mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW:  # degrees; the message of that name has radians
            moved = self._board.gimbal.command(sender, math.radians(p[0]), math.radians(p[2]))
            return ACCEPTED if moved else DENIED
        return UNSUPPORTED

    # -- gimbal ---------------------------------------------------------------------------------------------------

    def _gimbal_owner(self, p: tuple[float, ...], sender: tuple[int, int]) -> int:
        """Change the gimbal's primary controller.

        Ids of 0 or more name the new owner; -1 leaves the owner, -2 makes the sender the owner, -3 releases the control.
        """
        gimbal, wanted = self._board.gimbal, (int(p[0]), int(p[1]))
        if wanted[0] >= 0 and wanted[1] >= 0:
            gimbal.configure(*wanted)
        elif wanted[0] == -3 and gimbal.owner == sender:
            gimbal.configure(0, 0)
        elif wanted[0] == -2:
            gimbal.configure(*sender)
        return ACCEPTED

    def _gimbal_pitch(self, message: ReceivedMessage, _arrival_s: float) -> None:
        """Set the gimbal pitch: rad, positive up.

        Ignored without an answer unless the sender has primary control (from the firmware's sources).
        """
        self._board.gimbal.command(message.sender, message.pitch, message.pitch_rate)
