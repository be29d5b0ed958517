"""Queue of requests to a running firmware; each is repeated until it is answered."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.mavlink_codec import Packet, ReceivedMessage, packet

# default ids of both firmwares
SYSTEM = 1
COMPONENT = 1
_LATER = (mavlink.MAV_RESULT_TEMPORARILY_REJECTED, mavlink.MAV_RESULT_IN_PROGRESS)


class RequestQueue:
    """Commands, answered by COMMAND_ACK, and parameter values, answered by PARAM_VALUE.

    Requests sent before the firmware is ready are lost, so the first one remains due until it is answered.
    """

    def __init__(self) -> None:
        self._todo: deque[tuple[int | str, Packet]] = deque()

    def stream(self, kind: int, rate_hz: float) -> None:
        """Request a message at a rate."""
        self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, kind, 1e6 / rate_hz)

    def message(self, kind: int) -> None:
        """Request a message once."""
        self._command(mavlink.MAV_CMD_REQUEST_MESSAGE, kind, 0.0)

    def parameters(self, values: Iterable[tuple[str, float, int]]) -> None:
        """Set parameters, given as on the wire: name, value, MAV_PARAM_TYPE."""
        for name, value, kind in values:
            wish = packet(mavlink.MAVLink_param_set_message, SYSTEM, COMPONENT, name.encode(), value, kind)
            self._todo.append((name, wish))

    def due(self) -> Packet | None:
        """Return the request to send now; None if all are answered."""
        return self._todo[0][1] if self._todo else None

    def answered(self, message: ReceivedMessage) -> bool:
        """Return True if a message answers the request that is due; the next one is then due."""
        if message.kind == mavlink.MAVLINK_MSG_ID_COMMAND_ACK and message.result not in _LATER:
            what: int | str = message.command
        elif message.kind == mavlink.MAVLINK_MSG_ID_PARAM_VALUE:
            what = message.param_id
        else:
            return False
        if not self._todo or self._todo[0][0] != what:
            return False
        self._todo.popleft()
        return True

    def _command(self, command: int, *numbers: float) -> None:
        padded = (*numbers, *[0.0] * (7 - len(numbers)))
        wish = packet(mavlink.MAVLink_command_long_message, SYSTEM, COMPONENT, command, 0, *padded)
        self._todo.append((command, wish))
