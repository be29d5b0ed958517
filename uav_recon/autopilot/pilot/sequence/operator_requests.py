"""Operator requests: land, hold, and the operator's heartbeats, regardless of the mission."""

from __future__ import annotations

import math

from uav_recon.interfaces import Clock
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_STOP_REQUESTED = Reason(ReasonCode.STOP_REQUESTED)


class OperatorRequests:
    """The operator's wishes, until they are carried out.

    ``land_reason``: why the flight must end, None while it may continue. ``holds``: True while the vehicle must hold its
    position. ``received_s``: the newest heartbeat, -infinity before the first.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.land_reason: Reason | None = None
        self.holds = False
        self.received_s = -math.inf

    def request_land(self, why: Reason = _STOP_REQUESTED) -> None:
        """End the flight here and now, regardless of the mission. On the ground: start no flight."""
        self.land_reason = self.land_reason or why

    def request_hold(self, hold: bool) -> None:
        """Hold position regardless of the mission, or follow it again.

        Every reason to end a flight still ends it. The hold ends when the mission reports that the operator is lost.
        """
        self.holds = hold

    def hear_operator(self) -> None:
        """Record an operator heartbeat.

        It comes through a channel that no one else can use, never as a HEARTBEAT, which anybody can forge.
        """
        self.received_s = self._clock.now_s()
