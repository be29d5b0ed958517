"""Requests for messages of the autopilot: streams, single messages, and polled ones."""

from __future__ import annotations

from uav_recon.autopilot.link.message_sender import MessageSender
from uav_recon.clock import RateKeeper

_SET_MESSAGE_INTERVAL = 511  # ids of commands
_REQUEST_MESSAGE = 512


class MessageRequests:
    """Requests messages by their id.

    polled_hz: messages (id, rate) that the autopilot does not send often enough by itself. streams_hz: messages that are
    requested with every set of streams.
    """

    def __init__(
        self,
        sender: MessageSender,
        start_s: float,
        polled_hz: tuple[tuple[int, float], ...],
        streams_hz: tuple[tuple[int, float], ...],
    ) -> None:
        self._sender = sender
        self._polled = [(identifier, RateKeeper(rate_hz, start_s)) for identifier, rate_hz in polled_hz]
        self._streams_hz = streams_hz

    def request_streams(self, now_s: float, rates_hz: tuple[tuple[int, float], ...]) -> None:
        """Request messages (id, rate) at a rate."""
        for identifier, rate_hz in (*rates_hz, *self._streams_hz):
            self._sender.command(now_s, _SET_MESSAGE_INTERVAL, float(identifier), 1e6 / rate_hz)

    def request(self, now_s: float, identifier: int) -> None:
        """Request a message once."""
        self._sender.command(now_s, _REQUEST_MESSAGE, float(identifier))

    def poll(self, now_s: float) -> None:
        """Request the polled messages that are due; none before the autopilot's first heartbeat."""
        for identifier, keeper in self._polled:
            if self._sender.target and keeper.due(now_s):
                self.request(now_s, identifier)
