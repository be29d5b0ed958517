"""Pilot: the loop that feeds poses, requests modes, and sends what the guard clears."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_recon.autopilot.firmware.profile import ArmingOutcome, FirmwareProfile
from uav_recon.autopilot.link.navigation import Navigation
from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.mavlink.tlog import FrameLog, NoLog
from uav_recon.autopilot.parameters.preflight_check import NoParameterCheck, ParameterCheck
from uav_recon.autopilot.pilot.pilot_channels import PilotChannels
from uav_recon.autopilot.pilot.reports.reduced_speed_reporter import ReducedSpeedReporter
from uav_recon.autopilot.pilot.reports.statustext_reporter import StatusTextReporter
from uav_recon.autopilot.pilot.sequence.control_authority import IN_THE_AIR, ControlAuthority, ControlLoss
from uav_recon.autopilot.pilot.sequence.failsafe_monitor import FailsafeMonitor
from uav_recon.autopilot.pilot.sequence.landing import Landing
from uav_recon.autopilot.pilot.sequence.preflight import Origin, PreflightSetup
from uav_recon.autopilot.pilot.sequence.takeoff_sequence import TakeoffSequence
from uav_recon.autopilot.pilot.setpoints.setpoint_selection import SetpointSelector
from uav_recon.autopilot.pilot.situation.estimate_monitor import EstimateMonitor
from uav_recon.autopilot.pilot.situation.mission_input import MissionInput
from uav_recon.autopilot.pilot.situation.pose_feed import PoseFeed
from uav_recon.autopilot.pilot.situation.situation import SituationBuilder
from uav_recon.autopilot.pilot.situation.surroundings import Surroundings
from uav_recon.autopilot.pilot.situation.upward_range_finder import STREAM, NoRangeFinder, RangeFinderModel, UpwardRangeFinder
from uav_recon.clock import RateKeeper
from uav_recon.interfaces import ByteLink, Clock
from uav_recon.safety.failsafe_precedence import FailsafeAction, FailsafeTimeouts
from uav_recon.safety.guard import Guard, GuardInputs
from uav_recon.safety.pose_gate import PoseGate
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase

_LINK_HOLD_S = 0.5  #: hold: autopilot silent for longer: it may no longer follow the setpoints
_TICK_S = 0.01  # max. wait for a frame within a control step
_ASKED = Reason(ReasonCode.STOP_REQUESTED)
_RESET_REST_S = 1.0  #: land: this long after odometry restarted in flight; until then it holds, as the map may no longer fit
_ODOMETRY_RESTARTED = Reason(ReasonCode.ODOMETRY_RESTARTED)  # the mission cannot know which part of the map still fits


@dataclass(frozen=True, slots=True, kw_only=True)
class HullGeometry:
    """Geometry of the vehicle and its flight: hull (m), hover height over the pad (m), gimbal."""

    vehicle_radius_m: float
    vehicle_height_m: float
    hover_height_m: float
    gimbal: bool = False


class Pilot:
    """The pilot's control loop. It never blocks.

    Its owner calls step() about a hundred times a second, or whenever bytes arrive. It never raises on data from the
    autopilot, perception or the mission.

    YIELDED means: no setpoint, mode or arm command any more, until the process is restarted. Poses, heartbeats and
    TIMESYNC continue, because a human who flies by position needs them.
    """

    def __init__(
        self,
        link: VehicleLink,
        guard: Guard,
        sight: RecentlySeenSpace,
        patience: FailsafeTimeouts,
        channels: PilotChannels,
        clock: Clock,
        origin: Origin,
        airframe: HullGeometry,
        setpoint_rate_hz: float = 30.0,
        parameters: ParameterCheck | NoParameterCheck | None = None,
        range_finder: RangeFinderModel | None = None,
    ) -> None:
        self._link = link
        self._guard = guard
        self._patience = patience
        self._clock = clock
        self._firmware = link.firmware
        self._airframe = airframe
        self._vehicle = channels.vehicle
        self._rates = channels.rates
        self._reported = channels.reported
        parameters = parameters or NoParameterCheck()
        self._preflight = PreflightSetup(link, origin, airframe.gimbal, parameters)
        self._tick = RateKeeper(setpoint_rate_hz, clock.now_s())
        self._poses = PoseFeed(channels.odom, link, PoseGate(guard.envelope.max_yaw_rate_radps))
        self._mission_input = MissionInput(channels.intent, patience.intent_timeout_s, guard.refusals)
        hull = (airframe.vehicle_radius_m, airframe.vehicle_height_m)
        self._surroundings = Surroundings(channels.free, channels.nearby, sight, *hull)
        self._range_finder = (
            NoRangeFinder() if range_finder is None else UpwardRangeFinder(range_finder, link, sight, channels.cones)
        )
        self._authority = ControlAuthority(link.firmware)
        self._selector = SetpointSelector(
            guard, self._mission_input, airframe.hover_height_m, vehicle_radius_m=airframe.vehicle_radius_m
        )
        self._estimate = EstimateMonitor(link)
        self._situation = SituationBuilder(
            link, guard, self._poses, self._mission_input, self._surroundings, self._selector, parameters, self._estimate
        )
        self._takeoff = TakeoffSequence(link, self._authority)
        self._failsafe = FailsafeMonitor(patience, guard.refusals)
        self.phase = FlightPhase.CONNECTING
        self._note: Reason | None = None
        self._reporter = StatusTextReporter(link)
        self._speed_reporter = ReducedSpeedReporter()
        self._landing: Landing | None = None
        self._land_wanted: Reason | None = None
        self._held = False
        self._operator_s = -math.inf
        self._again_s = math.inf  # since when the flight has been in another odom than at its start

    def step(self) -> None:
        """Run one step: receive, feed poses, check, act, send a setpoint, report."""
        now_s = self._clock.now_s()
        self._link.receive(now_s)
        self._publish_measurements()
        self._feed_poses(now_s)
        self._read_mission(now_s)
        self._check_authority(now_s)
        self._check_takeoff(now_s)
        self._check_failsafe(now_s)
        self._advance(now_s)
        if self._tick.due(now_s):
            self._stream(now_s)
            self._publish(now_s)
        self._tell(now_s)
        self._link.keep_alive(now_s)

    def wait(self) -> None:
        """Block until bytes arrive or the next step is due (returns at once on a link in memory)."""
        now_s = self._clock.now_s()
        self._link.wait(min(self._tick.next_s() - now_s, _TICK_S))

    def request_land(self, why: Reason = _ASKED) -> None:
        """End the flight here and now, regardless of the mission. On the ground: start no flight."""
        self._land_wanted = self._land_wanted or why

    def request_hold(self, hold: bool) -> None:
        """Hold position regardless of the mission, or follow it again.

        Every reason to end a flight still ends it. The hold ends when the mission reports that the operator is lost.
        """
        self._held = hold

    def hear_operator(self) -> None:
        """Record an operator heartbeat.

        It comes through a channel that no one else can use, never as a HEARTBEAT, which anybody can forge.
        """
        self._operator_s = self._clock.now_s()

    @property
    def in_flight(self) -> bool:
        """True if the vehicle is, or may be, flying because of us, or may still start its motors."""
        over = self.phase in (FlightPhase.LANDED, FlightPhase.YIELDED)
        motors = not over and self._authority.motors_may_start(self._clock.now_s())
        return motors or self.phase in (FlightPhase.ARMING, *IN_THE_AIR)

    # ---- receive and check -------------------------------------------------------------------------------------

    def _feed_poses(self, now_s: float) -> None:
        """Feed new poses to the autopilot, and update what is seen from them."""
        if self._poses.step(now_s):
            self._note = Reason(ReasonCode.POSE_SOURCE_RESET)
            self._selector.rebase(self._situation.situation(now_s), _RESET_REST_S)
            self._surroundings.forget()
            self._range_finder.forget()
            self._estimate.forget()
            self._again_s = min(self._again_s, now_s) if self.in_flight else math.inf
        self._estimate.update(self._poses.pose, now_s)
        self._surroundings.step(self._poses.pose, now_s)
        self._range_finder.step(self._poses.pose, now_s)
        if self.phase in IN_THE_AIR:  # while it arms it stands, and does not evade
            self._selector.evasion.update(self._surroundings.sudden_obstacle, self._surroundings.ghost_s)

    def _read_mission(self, now_s: float) -> None:
        """Read the mission's intent, and what it ends: a hold, or the ban on another take-off."""
        fault = self._mission_input.update(now_s)
        if fault:
            self._note = _refused(fault)
        self._held = self._held and not self._mission_input.operator_lost(now_s)
        if self._mission_input.goal(now_s) is not Goal.FLY:
            self._takeoff.withdraw()

    def _check_authority(self, now_s: float) -> None:
        """Check whether the vehicle is still ours."""
        t, status = self._link.telemetry, self._link.status
        loss = self._authority.watch(self.phase, t, status, now_s)
        if self.phase is FlightPhase.YIELDED and not self._link.heartbeat.stopped:
            loss = self._authority.operator_lost(t.mode, status, now_s)
            self._note = self._authority.reselected_message(t.mode, now_s) or self._note
        if loss is not None:
            self._lose(loss)

    def _check_takeoff(self, now_s: float) -> None:
        """Check whether the vehicle lifts itself, and stays level."""
        if self.phase in (FlightPhase.ARMING, FlightPhase.FLYING):
            self._takeoff.watch_climb(now_s)

    def _check_failsafe(self, now_s: float) -> None:
        """Update the failsafe action in flight; before a retreat, record the positions for it."""
        if self.phase is not FlightPhase.FLYING:
            return
        self._estimate.update_height(self._selector.newest_setpoint, now_s)
        uncertain = None if self._link.status.time_known else Reason(ReasonCode.CLOCK_UNCERTAIN)
        if self._failsafe.update(self._situation.health(now_s, self._failsafe.refusals), uncertain):
            self._note = self._failsafe.reason
        if self._poses.pose is not None and self._failsafe.action < FailsafeAction.RETREAT:
            self._selector.was_at(self._poses.pose.odom_from_body)

    # ---- act --------------------------------------------------------------------------------------------------

    def _enter(self, phase: FlightPhase, why: Reason | None, landing_seen: bool = False) -> None:
        """Change the phase, except in an undisturbed flight.

        Its reason is sent at once, because a later note may replace it.
        """
        self.phase = phase
        self._note = why or self._note
        if why is not None:
            self._reporter.say(why, self._clock.now_s())
        if phase is FlightPhase.LANDING:
            lifted = self._takeoff.lifted or self._poses.misleads  # wrong axes tell no height
            self._landing = Landing(landing_seen, lifted=lifted)
        if phase in (FlightPhase.LANDED, FlightPhase.YIELDED):
            self._mission_input.reject_trajectory()
            self._estimate.land()

    def _lose(self, loss: ControlLoss) -> None:
        self._enter(loss.phase, loss.why, landing_seen=self._firmware.is_landing(self._link.telemetry.mode.custom_mode))
        if loss.stop_heartbeats:
            self._link.heartbeat.stop()

    def _advance(self, now_s: float) -> None:
        """Run one step of the sequence of the present phase."""
        if self.phase is FlightPhase.CONNECTING:
            self._connect(now_s)
        elif self.phase is FlightPhase.READY:
            self._stand_ready(now_s)
        elif self.phase is FlightPhase.ARMING:
            self._arm(now_s)
        elif self.phase is FlightPhase.FLYING:
            self._fly(now_s)
        elif self.phase is FlightPhase.LANDING:
            self._land(now_s)

    def _connect(self, now_s: float) -> None:
        self._note = self._ground_fault(now_s)
        self.phase = FlightPhase.CONNECTING if self._note else FlightPhase.READY

    def _ground_fault(self, now_s: float) -> Reason | None:
        """Return why the vehicle may not be armed, None if it may."""
        return self._poses.wrong or self._preflight.missing(now_s) or self._estimate.ground_fault

    def _stand_ready(self, now_s: float) -> None:
        if self._ground_fault(now_s):
            self.phase = FlightPhase.CONNECTING
        elif self._mission_input.goal(now_s) is Goal.FLY and self._takeoff.allowed and not self._land_wanted:
            here = self._situation.situation(now_s)
            blocked = self._guard.takeoff_fault(here, self._airframe.hover_height_m)
            if blocked:
                self._abandon_takeoff(Reason(ReasonCode.TAKEOFF_REFUSED, details=(blocked,)))
            else:
                self._begin_flight(here)

    def _begin_flight(self, here: GuardInputs) -> None:
        """Start a take-off; nothing is remembered of the flight before."""
        self.phase = FlightPhase.ARMING
        self._note = None
        self._again_s = math.inf
        self._link.alerts.begin()
        self._takeoff.begin(here.now_s)
        self._estimate.begin()
        self._failsafe = FailsafeMonitor(self._patience, self._guard.refusals)
        self._selector.rebase(here, rest_s=0.0)

    def _arm(self, now_s: float) -> None:
        unfit = self._failsafe.prevents_takeoff(self._situation.health(now_s, self._failsafe.refusals))
        wanted = self._mission_input.goal(now_s) is Goal.FLY and not unfit
        outcome = self._takeoff.arm(now_s, wanted, self._land_wanted)
        if outcome is ArmingOutcome.GIVEN_UP:
            self._abandon_takeoff(self._takeoff.abort_reason)
        elif outcome is ArmingOutcome.ARMED:
            self.phase = FlightPhase.FLYING
            self._note = None
            if not self._takeoff.streams:
                self._selector.rebase(self._situation.situation(now_s), rest_s=0.0)

    def _abandon_takeoff(self, why: Reason | None) -> None:
        """Return to READY, or start a landing if the motors may have started in between."""
        self._takeoff.forbid()
        self._estimate.land()
        self._enter(FlightPhase.LANDING if self._link.telemetry.mode.armed else FlightPhase.READY, why)

    def _fly(self, now_s: float) -> None:
        why = self._landing_reason(now_s)
        brakes = self._failsafe.action is FailsafeAction.LAND and not self._land_wanted and not self._selector.at_rest
        if why and not brakes:  # a firmware that gets LAND in motion chooses its own stopping point, farther on
            self._enter(FlightPhase.LANDING, why)
            self._land(now_s)

    def _landing_reason(self, now_s: float) -> Reason | None:
        """Return why the flight must end, by importance; None while it may continue."""
        blocked, low = self._selector.blocked, self._failsafe.reason
        return (
            self._land_wanted
            or self._failsafe.landing_reason
            or (low.with_detail(blocked) if low is not None and blocked is not None else blocked)
            or self._takeoff.climb_fault
            or (_ODOMETRY_RESTARTED if now_s - self._again_s >= _RESET_REST_S else None)
            or (Reason(ReasonCode.MISSION_LAND) if self._mission_input.goal(now_s) is Goal.LAND else None)
        )

    def _land(self, now_s: float) -> None:
        landing = self._landing = self._landing or Landing(seen=False)
        loss = landing.step(self._link, now_s)
        self._note = landing.alert or self._note
        if loss is not None:
            self._lose(loss)

    # ---- send and report --------------------------------------------------------------------------------------

    def _stream(self, now_s: float) -> None:
        """Send one setpoint if the vehicle is ours.

        It is the guard's answer to the trajectory, or its hold.
        """
        arming = self.phase is FlightPhase.ARMING and self._takeoff.streams
        landing = self.phase is FlightPhase.LANDING and self._landing is not None and not self._landing.seen
        if not (arming or landing or self.phase is FlightPhase.FLYING):
            return
        linked = now_s - self._link.telemetry.received_s <= _LINK_HOLD_S
        steered = linked and not self._held and self.phase is FlightPhase.FLYING
        cleared, refusal = self._selector.select(
            self._failsafe.action if steered else FailsafeAction.HOLD,
            self._situation.situation(now_s),
            unsure=self._poses.unsure is not None,
        )
        self._failsafe.refusals.update(self._selector.moves, now_s)
        if refusal is not None:
            self._note = _refused(refusal.reason)
        if self.phase is FlightPhase.FLYING and cleared.setpoint.velocity_mps[2] > 0.0:
            self._takeoff.begin_climb(now_s)
        self._link.stream(cleared, now_s, self._airframe.gimbal)

    def _tell(self, now_s: float) -> None:
        if self.phase is FlightPhase.CONNECTING:
            return
        lost = self._poses.lost or self._poses.wrong  # the failsafe reports these itself
        speed = None if lost else self._speed_reporter.update(self._situation.slow_reason, now_s)
        if speed is not None:
            self._reporter.say(speed, now_s)
        if self.phase is FlightPhase.READY:
            return
        airborne = self.phase in IN_THE_AIR
        news = [*self._link.alerts.news(), *([self._mission_input.news] if airborne and self._mission_input.news else [])]
        for reason in news:
            self._reporter.say(reason, now_s)
        if airborne and news:
            self._note = news[-1]
        self._reporter.step(self._note, now_s)

    def _publish_measurements(self) -> None:
        """Publish the autopilot's turn rates and poses at once.

        They are worth less with each millisecond.
        """
        rates, poses = self._link.measurements.turn_rates(), self._link.measurements.reported_poses()
        if rates is not None:
            self._rates.publish(rates)
        if poses is not None:
            self._reported.publish(poses)

    def _publish(self, now_s: float) -> None:
        gimbal = self._airframe.gimbal
        self._vehicle.publish(self._situation.state(now_s, self.phase, self._note, self._operator_s, gimbal))


def _refused(why: Reason) -> Reason:
    return Reason(ReasonCode.REFUSED, details=(why,))


def make_pilot(
    bytes_link: ByteLink,
    firmware: FirmwareProfile,
    guard: Guard,
    sight: RecentlySeenSpace,
    patience: FailsafeTimeouts,
    channels: PilotChannels,
    clock: Clock,
    origin: Origin,
    airframe: HullGeometry,
    setpoint_rate_hz: float = 30.0,
    log: FrameLog | None = None,
    parameters: ParameterCheck | None = None,
    gate: AllowListFilter | None = None,
    navigation: Navigation | None = None,
    range_finder: RangeFinderModel | None = None,
) -> Pilot:
    """Build a pilot for a firmware on the given byte link.

    gate: filter for senders; None: system 1. navigation: who tells the autopilot where it is; None: the poses are fed to it.
    range_finder: one that looks up, if the vehicle has it.
    """
    firmware = firmware if range_finder is None else firmware.with_stream(*STREAM)
    link = VehicleLink(bytes_link, log or NoLog(), clock.now_s(), firmware, gate or AllowListFilter(), navigation=navigation)
    return Pilot(link, guard, sight, patience, channels, clock, origin, airframe, setpoint_rate_hz, parameters, range_finder)
