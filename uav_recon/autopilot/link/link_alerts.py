"""Alerts about other senders and faults on the link, each reported once per kind and flight."""

from __future__ import annotations

from uav_recon.autopilot.mavlink.allow_list import NOT_AN_AUTOPILOT
from uav_recon.autopilot.mavlink.framing import MessageLayout, kind_of, wire
from uav_recon.autopilot.mavlink.messages import (
    Attitude,
    EstimatorStatus,
    Heartbeat,
    LandedState,
    LocalPosition,
    OriginSet,
    Received,
    SystemStatus,
)

OWN_NAME = "intruder: somebody speaks with our own id"
OLD_FRAMES = "intruder: somebody speaks MAVLink 1"
TWO = "two autopilots speak with one id"

_TELL_STATE = (EstimatorStatus, LandedState, SystemStatus, LocalPosition, Attitude, OriginSet)
_COMMAND = {
    kind.id: MessageLayout(kind, "target_system")
    for kind in (
        wire.MAVLink_command_long_message, wire.MAVLink_command_int_message, wire.MAVLink_set_mode_message,
        wire.MAVLink_param_set_message, wire.MAVLink_rc_channels_override_message,
        wire.MAVLink_set_position_target_local_ned_message, wire.MAVLink_set_position_target_global_int_message,
        wire.MAVLink_set_attitude_target_message, wire.MAVLink_setup_signing_message,
    )
}  # fmt: skip


class LinkAlerts:
    """Collects alerts.

    own: our system and component. Messages of a ground station, a camera or a radio about itself are no intrusion.
    """

    def __init__(self, own: tuple[int, int]) -> None:
        self._own = own
        self._alarms: dict[str, str] = {}  # by kind: the first alert, until it is reported
        self._told: set[str] = set()

    def update(self, received: Received) -> None:
        """Check a frame that was not admitted."""
        who = f"intruder: system {received.system}, component {received.component}"
        if (received.system, received.component) == self._own:
            self.note(OWN_NAME)
        elif kind_of(received.frame) in _COMMAND:
            if _COMMAND[kind_of(received.frame)].read(received.frame)[0] in (0, self._own[0]):
                self.note("commands", f"{who} commands us")
        elif tells_state(received):
            self.note("tells state", f"{who} tells state")

    def note(self, kind: str, alarm: str = "") -> None:
        """Record an alert, unless one of its kind was reported in this flight.

        alarm: its text; the kind if empty.
        """
        if kind not in self._told:
            self._alarms.setdefault(kind, alarm or kind)

    def begin(self) -> None:
        """Start a flight: earlier alerts are dropped, and each kind may be reported again."""
        self._alarms.clear()
        self._told.clear()

    def news(self) -> list[str]:
        """Return the alerts to report now; they are not reported again in this flight."""
        news = list(self._alarms.values())
        self._told |= set(self._alarms)
        self._alarms.clear()
        return news


def tells_state(received: Received) -> bool:
    """Return True if the message reports the state of a vehicle, as an autopilot's does."""
    message = received.message
    return isinstance(message, _TELL_STATE) or (isinstance(message, Heartbeat) and message.autopilot != NOT_AN_AUTOPILOT)
