"""Setpoint stream: one setpoint to the autopilot at a fixed rate, while the vehicle is ours."""

from __future__ import annotations

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.pilot.sequence.flight_sequence import FlightSequence
from uav_recon.autopilot.pilot.setpoints.setpoint_selection import SetpointSelector
from uav_recon.clock import RateKeeper


class SetpointStream:
    """Sends what the guard clears: the selected motion, or its hold.

    gimbal: True if the camera's pitch is sent too.
    """

    def __init__(
        self, link: VehicleLink, sequence: FlightSequence, selector: SetpointSelector, rate: RateKeeper, *, gimbal: bool
    ) -> None:
        self._link = link
        self._sequence = sequence
        self._selector = selector
        self._rate = rate
        self._gimbal = gimbal

    def due(self, now_s: float) -> bool:
        """Return True once in each period."""
        return self._rate.due(now_s)

    def next_s(self) -> float:
        """Return the instant of the next period."""
        return self._rate.next_s()

    def send(self, now_s: float) -> None:
        """Send one setpoint, if the flight sequence permits any."""
        action = self._sequence.setpoint_action(now_s)
        if action is None:
            return
        cleared, refusal = self._selector.select(action, now_s)
        self._sequence.record_setpoint(cleared, refusal, now_s)
        self._link.stream(cleared, now_s, self._gimbal)
