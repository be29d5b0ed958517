"""Our heartbeat, by which the autopilot knows that we fly it."""

from __future__ import annotations

import math

from uav_recon.clock import RateKeeper

_RATE_HZ = 5.0  # one lost heartbeat ends no flight
_DEAF_S = 1.7  #: release: after a longer silence of the autopilot our heartbeats stop, so that its failsafe lands


class OwnHeartbeat:
    """Tells when a heartbeat is due.

    None is sent after a silence of the autopilot: one that lands only when our heartbeats stop (ArduPilot, two seconds later)
    has to land before the vehicle is given up as lost. ``stopped``: none is sent any more.
    """

    def __init__(self, start_s: float) -> None:
        self._keeper = RateKeeper(_RATE_HZ, start_s)
        self.stopped = False

    def stop(self) -> None:
        """Stop our heartbeats, so that an autopilot that is still in our mode lands by failsafe."""
        self.stopped = True

    def due(self, now_s: float, received_s: float) -> bool:
        """Return True if a heartbeat has to be sent now.

        received_s: time of the autopilot's newest message.
        """
        deaf = -math.inf < received_s < now_s - _DEAF_S
        return self._keeper.due(now_s) and not (self.stopped or deaf)
