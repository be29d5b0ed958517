"""Flight sequence: the phases of a flight, and what leads from each to the next."""

from __future__ import annotations

import math

from uav_recon.autopilot.firmware.profile import ArmingOutcome
from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.pilot.reports.flight_reporter import FlightReporter
from uav_recon.autopilot.pilot.sequence.control_authority import ControlAuthority, ControlLoss
from uav_recon.autopilot.pilot.sequence.failsafe_monitor import FailsafeMonitor
from uav_recon.autopilot.pilot.sequence.landing import Landing
from uav_recon.autopilot.pilot.sequence.operator_requests import OperatorRequests
from uav_recon.autopilot.pilot.sequence.preflight import PreflightSetup
from uav_recon.autopilot.pilot.sequence.takeoff_sequence import TakeoffSequence
from uav_recon.autopilot.pilot.setpoints.setpoint_selection import SetpointSelector
from uav_recon.autopilot.pilot.situation.situation import Situation
from uav_recon.safety.failsafe_precedence import FailsafeAction, FailsafeInputs
from uav_recon.safety.guard import ClearedSetpoint
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal, Refusal
from uav_recon.types.vehicle import IN_THE_AIR, FlightPhase

_LINK_HOLD_S = 0.5  #: hold: autopilot silent for longer: it may no longer follow the setpoints
#: land: a failsafe landing waits until the autopilot's level speed is below this: when the setpoints of a brake have come to
#: rest, the vehicle is ahead of them and comes back, an ArduCopter at up to 0.6 m/s
_STILL_MPS = 0.15
_SWINGS_S = 1.0  #: land: it waits for at most this time after that setpoint; without poses the speed itself drifts
_RESET_REST_S = 1.0  #: land: this long after odometry restarted in flight; until then it holds, as the map may no longer fit
_ODOMETRY_RESTARTED = Reason(ReasonCode.ODOMETRY_RESTARTED)  # the mission cannot know which part of the map still fits


class FlightSequence:
    """Checks whether the vehicle is ours and may fly on, and runs one step of its phase.

    YIELDED means: no setpoint, mode or arm command any more, until the process is restarted.
    """

    def __init__(
        self,
        link: VehicleLink,
        situation: Situation,
        selector: SetpointSelector,
        preflight: PreflightSetup,
        failsafe: FailsafeMonitor,
        operator: OperatorRequests,
    ) -> None:
        self._link = link
        self._situation = situation
        self._selector = selector
        self._preflight = preflight
        self._failsafe = failsafe
        self._authority = ControlAuthority(link.firmware)
        self._takeoff = TakeoffSequence(link, self._authority)
        self._landing: Landing | None = None
        self._rest_s = math.inf  # since when the setpoints have been at rest
        self._restarted_s = math.inf  # since when the flight has been in another odom than at its start
        self.operator = operator
        self.reporter = FlightReporter(link, situation)
        self.phase = FlightPhase.CONNECTING

    def step(self, now_s: float) -> None:
        """Read the situation, check, and act."""
        self._observe(now_s)
        self._read_mission(now_s)
        self._check_authority(now_s)
        if self.phase in (FlightPhase.ARMING, FlightPhase.FLYING):
            self._takeoff.watch_climb(now_s)
        if self.phase is FlightPhase.FLYING:
            self._check_failsafe(now_s)
        self._advance(now_s)

    def may_fly(self, now_s: float) -> bool:
        """Return True if the vehicle may be flying because of us, or may still start its motors."""
        over = self.phase in (FlightPhase.LANDED, FlightPhase.YIELDED)
        motors = not over and self._authority.motors_may_start(now_s)
        return motors or self.phase in (FlightPhase.ARMING, *IN_THE_AIR)

    def setpoint_action(self, now_s: float) -> FailsafeAction | None:
        """Return the action that the next setpoint serves, None if no setpoint may be sent."""
        arming = self.phase is FlightPhase.ARMING and self._takeoff.streams
        landing = self.phase is FlightPhase.LANDING and self._landing is not None and not self._landing.seen
        if not (arming or landing or self.phase is FlightPhase.FLYING):
            return None
        linked = now_s - self._link.telemetry.received_s <= _LINK_HOLD_S
        steered = linked and not self.operator.holds and self.phase is FlightPhase.FLYING
        return self._failsafe.action if steered else FailsafeAction.HOLD

    def record_setpoint(self, cleared: ClearedSetpoint, refusal: Refusal | None, now_s: float) -> None:
        """Record the guard's answer: a refusal, or a setpoint that begins the climb."""
        self._failsafe.refusals.update(self._selector.moves, now_s)
        if refusal is not None:
            self.reporter.note = _refused(refusal.reason)
        if self.phase is FlightPhase.FLYING and cleared.setpoint.velocity_mps[2] > 0.0:
            self._takeoff.begin_climb(now_s)

    # ---- read and check ----------------------------------------------------------------------------------------

    def _observe(self, now_s: float) -> None:
        """Read poses and sensors; after a restart of odom everything that was known before is void."""
        if self._situation.read_pose(now_s):
            self.reporter.note = Reason(ReasonCode.POSE_SOURCE_RESET)
            self._selector.rebase(now_s, _RESET_REST_S)
            self._situation.forget()
            self._restarted_s = min(self._restarted_s, now_s) if self.may_fly(now_s) else math.inf
        self._situation.read_sensors(now_s)
        if self.phase in IN_THE_AIR:  # while it arms it stands, and does not evade
            self._selector.update_evasion()

    def _read_mission(self, now_s: float) -> None:
        """Read the mission's intent, and what it ends: a hold, or the ban on another take-off."""
        mission = self._situation.mission
        fault = mission.update(now_s)
        if fault:
            self.reporter.note = _refused(fault)
        self.operator.holds = self.operator.holds and not mission.operator_lost(now_s)
        if mission.goal(now_s) is not Goal.FLY:
            self._takeoff.withdraw()

    def _check_authority(self, now_s: float) -> None:
        """Check whether the vehicle is still ours."""
        t, status = self._link.telemetry, self._link.status
        loss = self._authority.watch(self.phase, t, status, now_s)
        if self.phase is FlightPhase.YIELDED and not self._link.heartbeat.stopped:
            loss = self._authority.operator_lost(t.mode, status, now_s)
            self.reporter.note = self._authority.reselected_message(t.mode, now_s) or self.reporter.note
        if loss is not None:
            self._lose(loss, now_s)

    def _check_failsafe(self, now_s: float) -> None:
        """Update the failsafe action in flight; before a retreat, record the positions for it."""
        self._situation.estimate.update_setpoint(self._selector.newest_setpoint, now_s)
        uncertain = None if self._link.status.time_known else Reason(ReasonCode.CLOCK_UNCERTAIN)
        if self._failsafe.update(self._failsafe_inputs(now_s), uncertain):
            self.reporter.note = self._failsafe.reason
        pose = self._situation.poses.pose
        if pose is not None and self._failsafe.action < FailsafeAction.RETREAT:
            self._selector.was_at(pose.odom_from_body)

    def _failsafe_inputs(self, now_s: float) -> FailsafeInputs:
        return self._situation.failsafe_inputs(
            now_s, self._failsafe.refusals, self._preflight.parameter_changed, has_views=self._selector.has_views
        )

    # ---- act --------------------------------------------------------------------------------------------------

    def _enter(self, phase: FlightPhase, why: Reason | None, now_s: float, *, landing_seen: bool = False) -> None:
        """Change the phase, except in an undisturbed flight.

        Its reason is sent at once, because a later note may replace it.
        """
        self.phase = phase
        if why is not None:
            self.reporter.note = why
            self.reporter.say(why, now_s)
        if phase is FlightPhase.LANDING:
            lifted = self._takeoff.lifted or self._situation.poses.misleads  # wrong axes tell no height
            self._landing = Landing(landing_seen, lifted=lifted)
        if phase in (FlightPhase.LANDED, FlightPhase.YIELDED):
            self._situation.mission.reject_trajectory()
            self._situation.estimate.land()

    def _lose(self, loss: ControlLoss, now_s: float) -> None:
        landing_seen = self._link.firmware.is_landing(self._link.telemetry.mode.custom_mode)
        self._enter(loss.phase, loss.why, now_s, landing_seen=landing_seen)
        if loss.stop_heartbeats:
            self._link.heartbeat.stop()

    def _advance(self, now_s: float) -> None:
        """Run one step of the sequence of the present phase."""
        if self.phase is FlightPhase.CONNECTING:
            self.reporter.note = self._ground_fault(now_s)
            self.phase = FlightPhase.CONNECTING if self.reporter.note else FlightPhase.READY
        elif self.phase is FlightPhase.READY:
            self._stand_ready(now_s)
        elif self.phase is FlightPhase.ARMING:
            self._arm(now_s)
        elif self.phase is FlightPhase.FLYING:
            self._fly(now_s)
        elif self.phase is FlightPhase.LANDING:
            self._land(now_s)

    def _ground_fault(self, now_s: float) -> Reason | None:
        """Return why the vehicle may not be armed, None if it may."""
        return self._situation.poses.wrong or self._preflight.missing(now_s) or self._situation.estimate.ground_fault

    def _stand_ready(self, now_s: float) -> None:
        wanted = self._situation.mission.goal(now_s) is Goal.FLY and self._takeoff.allowed and not self.operator.land_reason
        if self._ground_fault(now_s):
            self.phase = FlightPhase.CONNECTING
        elif wanted:
            blocked = self._selector.takeoff_fault(now_s)
            if blocked:
                self._abandon_takeoff(Reason(ReasonCode.TAKEOFF_REFUSED, details=(blocked,)), now_s)
            else:
                self._begin_flight(now_s)

    def _begin_flight(self, now_s: float) -> None:
        """Start a take-off; nothing is remembered of the flight before."""
        self.phase = FlightPhase.ARMING
        self.reporter.note = None
        self._restarted_s = math.inf
        self._link.alerts.begin()
        self._takeoff.begin(now_s)
        self._situation.estimate.begin()
        self._failsafe.begin_flight()
        self._selector.rebase(now_s, rest_s=0.0)

    def _arm(self, now_s: float) -> None:
        unfit = self._failsafe.prevents_takeoff(self._failsafe_inputs(now_s))
        wanted = self._situation.mission.goal(now_s) is Goal.FLY and not unfit
        outcome = self._takeoff.arm(now_s, wanted, self.operator.land_reason)
        if outcome is ArmingOutcome.GIVEN_UP:
            self._abandon_takeoff(self._takeoff.abort_reason, now_s)
        elif outcome is ArmingOutcome.ARMED:
            self.phase = FlightPhase.FLYING
            self.reporter.note = None
            if not self._takeoff.streams:
                self._selector.rebase(now_s, rest_s=0.0)

    def _abandon_takeoff(self, why: Reason | None, now_s: float) -> None:
        """Return to READY, or start a landing if the motors may have started in between."""
        self._takeoff.forbid()
        self._situation.estimate.land()
        self._enter(FlightPhase.LANDING if self._link.telemetry.mode.armed else FlightPhase.READY, why, now_s)

    def _fly(self, now_s: float) -> None:
        why = self._landing_reason(now_s)
        self._rest_s = min(self._rest_s, now_s) if self._selector.at_rest else math.inf
        brakes = self._failsafe.action is FailsafeAction.LAND and not self.operator.land_reason and self._moves(now_s)
        if why and not brakes:  # a firmware that gets LAND in motion chooses its own stopping point, farther on
            self._enter(FlightPhase.LANDING, why, now_s)
            self._land(now_s)

    def _moves(self, now_s: float) -> bool:
        """Return True while setpoints still brake, or the vehicle still swings about the last one.

        An estimate that is wrong tells no speed, nor does an old one.
        """
        if not self._selector.at_rest:
            return True
        estimate, wrong = self._link.telemetry.estimate, self._situation.poses.wrong or self._situation.estimate.land_reason
        fresh = now_s - self._link.estimate_s(now_s) <= _LINK_HOLD_S  # False for NaN
        speed_mps = math.hypot(*estimate.velocity_mps[:2].tolist())
        return fresh and not wrong and speed_mps > _STILL_MPS and now_s - self._rest_s <= _SWINGS_S

    def _landing_reason(self, now_s: float) -> Reason | None:
        """Return why the flight must end, by importance; None while it may continue."""
        blocked, low = self._selector.blocked, self._failsafe.reason
        return (
            self.operator.land_reason
            or self._failsafe.landing_reason
            or (low.with_detail(blocked) if low is not None and blocked is not None else blocked)
            or self._takeoff.climb_fault
            or (_ODOMETRY_RESTARTED if now_s - self._restarted_s >= _RESET_REST_S else None)
            or (Reason(ReasonCode.MISSION_LAND) if self._situation.mission.goal(now_s) is Goal.LAND else None)
        )

    def _land(self, now_s: float) -> None:
        landing = self._landing = self._landing or Landing(seen=False)
        loss = landing.step(self._link, now_s)
        self.reporter.note = landing.alert or self.reporter.note
        if loss is not None:
            self._lose(loss, now_s)


def _refused(why: Reason) -> Reason:
    return Reason(ReasonCode.REFUSED, details=(why,))
