"""Pilot: the loop that feeds poses, requests modes, and sends what the guard clears."""

from __future__ import annotations

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.pilot.reports.vehicle_publisher import VehiclePublisher
from uav_recon.autopilot.pilot.sequence.flight_sequence import FlightSequence
from uav_recon.autopilot.pilot.sequence.operator_requests import OperatorRequests
from uav_recon.autopilot.pilot.setpoint_stream import SetpointStream
from uav_recon.interfaces import Clock
from uav_recon.types.vehicle import FlightPhase

_TICK_S = 0.01  # max. wait for a frame within a control step


class Pilot:
    """The pilot's control loop. It never blocks.

    Its owner calls step() about a hundred times a second, or whenever bytes arrive. It never raises on data from the
    autopilot, perception or the mission. Poses, heartbeats and TIMESYNC continue after control was yielded, because a human who
    flies by position needs them.
    """

    def __init__(
        self, clock: Clock, link: VehicleLink, sequence: FlightSequence, stream: SetpointStream, publisher: VehiclePublisher
    ) -> None:
        self._clock = clock
        self._link = link
        self._sequence = sequence
        self._stream = stream
        self._publisher = publisher

    def step(self) -> None:
        """Run one step: receive, feed poses, check, act, send a setpoint, report."""
        now_s = self._clock.now_s()
        self._link.receive(now_s)
        self._publisher.publish_measurements()
        self._sequence.step(now_s)
        if self._stream.due(now_s):
            self._stream.send(now_s)
            self._publisher.publish_state(now_s, self.phase, self._sequence.reporter.note, self.operator.received_s)
        self._sequence.reporter.step(self.phase, now_s)
        self._link.keep_alive(now_s)

    def wait(self) -> None:
        """Block until bytes arrive or the next step is due (returns at once on a link in memory)."""
        now_s = self._clock.now_s()
        self._link.wait(min(self._stream.next_s() - now_s, _TICK_S))

    @property
    def phase(self) -> FlightPhase:
        """Phase of the flight."""
        return self._sequence.phase

    @property
    def operator(self) -> OperatorRequests:
        """Requests of the operator, for the process that hears him."""
        return self._sequence.operator

    @property
    def in_flight(self) -> bool:
        """True if the vehicle is, or may be, flying because of us, or may still start its motors."""
        return self._sequence.may_fly(self._clock.now_s())
