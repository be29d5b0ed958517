"""Assembly of the pilot from its parts."""

from __future__ import annotations

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.parameters.preflight_check import NoParameterCheck, ParameterCheck
from uav_recon.autopilot.pilot.hull_geometry import HullGeometry
from uav_recon.autopilot.pilot.pilot import Pilot
from uav_recon.autopilot.pilot.pilot_channels import PilotChannels
from uav_recon.autopilot.pilot.reports.vehicle_publisher import VehiclePublisher
from uav_recon.autopilot.pilot.sequence.failsafe_monitor import FailsafeMonitor
from uav_recon.autopilot.pilot.sequence.flight_sequence import FlightSequence
from uav_recon.autopilot.pilot.sequence.operator_requests import OperatorRequests
from uav_recon.autopilot.pilot.sequence.preflight import Origin, PreflightSetup
from uav_recon.autopilot.pilot.setpoint_stream import SetpointStream
from uav_recon.autopilot.pilot.setpoints.setpoint_selection import SetpointSelector
from uav_recon.autopilot.pilot.situation.situation import Situation
from uav_recon.autopilot.pilot.situation.upward_range_finder import RangeFinderModel
from uav_recon.clock import RateKeeper
from uav_recon.interfaces import Clock
from uav_recon.safety.failsafe_precedence import FailsafeTimeouts
from uav_recon.safety.guard import Guard


def make_pilot(
    link: VehicleLink,
    guard: Guard,
    timeouts: FailsafeTimeouts,
    channels: PilotChannels,
    clock: Clock,
    origin: Origin,
    hull: HullGeometry,
    *,
    setpoint_rate_hz: float = 30.0,
    parameters: ParameterCheck | None = None,
    range_finder: RangeFinderModel | None = None,
) -> Pilot:
    """Build a pilot on a link.

    range_finder: one that looks up, if the vehicle has it; the link's firmware must request its stream.
    """
    situation = Situation(link, guard, channels, hull, range_finder)
    selector = SetpointSelector(guard, situation, hull)
    preflight = PreflightSetup(link, origin, hull.gimbal, parameters or NoParameterCheck())
    failsafe = FailsafeMonitor(timeouts, guard.refusals)
    sequence = FlightSequence(link, situation, selector, preflight, failsafe, OperatorRequests(clock))
    stream = SetpointStream(link, sequence, selector, RateKeeper(setpoint_rate_hz, clock.now_s()), gimbal=hull.gimbal)
    publisher = VehiclePublisher(channels, link, situation, selector, gimbal=hull.gimbal)
    return Pilot(clock, link, sequence, stream, publisher)
