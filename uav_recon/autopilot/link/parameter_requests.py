"""Requests to read and to set parameters of the autopilot."""

from __future__ import annotations

from uav_recon.autopilot.link.message_sender import MessageSender
from uav_recon.autopilot.mavlink.messages import ParameterValue


class ParameterRequests:
    """Remembers which parameters were requested: values of others are not kept."""

    def __init__(self, sender: MessageSender) -> None:
        self._sender = sender
        self._names: set[str] = set()

    def read(self, now_s: float, name: str) -> None:
        """Send PARAM_REQUEST_READ.

        From now on telemetry holds the newest reported value of this parameter.
        """
        self._names.add(name)
        self._sender.send(self._sender.encoder.parameter_request(self._sender.target, name), now_s)

    def set(self, now_s: float, value: ParameterValue) -> None:
        """Send PARAM_SET. Only a person's own command may cause it."""
        self._sender.send(self._sender.encoder.parameter_set(self._sender.target, value), now_s)

    def includes(self, name: str) -> bool:
        """Return True if this parameter was requested."""
        return name in self._names
