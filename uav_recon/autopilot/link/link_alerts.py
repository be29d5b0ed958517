"""Alerts about other senders and faults on the link, each reported once per kind and flight."""

from __future__ import annotations

from uav_recon.autopilot.mavlink.address import MavlinkAddress
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
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_STATE_KINDS = (EstimatorStatus, LandedState, SystemStatus, LocalPosition, Attitude, OriginSet)
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

    address: our own. Messages of a ground station, a camera or a radio about itself are no intrusion.
    """

    def __init__(self, address: MavlinkAddress) -> None:
        self._address = address
        self._alarms: dict[ReasonCode, Reason] = {}  # the first of each code, until it is reported
        self._reported: set[ReasonCode] = set()

    def update(self, received: Received) -> None:
        """Check a frame that was not admitted."""
        who = (received.system, received.component)
        if who == self._address:
            self.note(Reason(ReasonCode.INTRUDER_OWN_ID))
        elif kind_of(received.frame) in _COMMAND:
            if _COMMAND[kind_of(received.frame)].read(received.frame)[0] in (0, self._address.system):
                self.note(Reason(ReasonCode.INTRUDER_COMMANDS, who))
        elif is_vehicle_state(received):
            self.note(Reason(ReasonCode.INTRUDER_STATE, who))

    def note(self, alarm: Reason) -> None:
        """Record an alert, unless one of its kind was reported in this flight."""
        if alarm.code not in self._reported:
            self._alarms.setdefault(alarm.code, alarm)

    def begin(self) -> None:
        """Start a flight: earlier alerts are dropped, and each kind may be reported again."""
        self._alarms.clear()
        self._reported.clear()

    def news(self) -> list[Reason]:
        """Return the alerts to report now; they are not reported again in this flight."""
        news = list(self._alarms.values())
        self._reported |= set(self._alarms)
        self._alarms.clear()
        return news


def is_vehicle_state(received: Received) -> bool:
    """Return True if the message reports the state of a vehicle, as an autopilot's does."""
    message = received.message
    return isinstance(message, _STATE_KINDS) or (isinstance(message, Heartbeat) and message.from_autopilot)
