"""The pilot: the one loop that feeds poses, asks for modes, and streams what the guard clears."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.autopilot.handover import Handover
from uav_recon.autopilot.link import Link
from uav_recon.autopilot.personality import ARM, Arming, Outcome, Personality
from uav_recon.autopilot.tlog import FrameLog, NoLog
from uav_recon.clock import RateKeeper
from uav_recon.protocols import ByteLink, Channel, Clock
from uav_recon.safety.guard import ClearedSetpoint, Guard, Proposal, Situation, fault_of
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.trajectory import Goal, Intent, Refusal, Setpoint, Trajectory
from uav_recon.types.vehicle import FlightPhase, VehicleState

_POSE_MAX_AGE_S = 0.15  # older odometry is never fed: the estimator would drop it, or take it for new
_POSE_FUTURE_S = 0.05
_ASK_AGAIN_S = 2.0
_LAND_AGAIN_S = 1.5  # longer than the heartbeat's period, so a human's mode is seen before we ask again
_MODE_FRESH_S, _MODE_WAIT_S = 0.02, 0.25
_LATE_ARM_S = 5.0
_LINK_HOLD_S, _LINK_LOST_S = 1.0, 3.0
_LONGEST_NOTE = 200
_IN_THE_AIR = (FlightPhase.FLYING, FlightPhase.LANDING)
_TICK_S = 0.01


@dataclass(frozen=True, slots=True)
class Origin:
    """The place on the globe that the autopilot is told; indoors any will do."""

    lat_deg: float
    lon_deg: float
    alt_m: float


@dataclass(frozen=True, slots=True)
class PilotChannels:
    """Where the pilot meets perception and mission."""

    odom: Channel[StampedPose]
    intent: Channel[Intent]
    vehicle: Channel[VehicleState]


class Pilot:
    """Owner calls step() about a hundred times a second, or whenever bytes arrive; it never blocks and never raises
    on what the autopilot, perception or the mission say.

    YIELDED means: no setpoint, mode or arm command any more, until the process is started anew. Poses, heartbeats and
    TIMESYNC go on, because a human flying by position needs them.
    """

    def __init__(
        self,
        link: Link,
        guard: Guard,
        channels: PilotChannels,
        clock: Clock,
        origin: Origin,
        setpoint_rate_hz: float = 30.0,
        gimbal: bool = False,
    ) -> None:
        self._link, self._guard, self._channels, self._clock = link, guard, channels, clock
        self._firmware = link.firmware
        self._origin, self._gimbal = origin, gimbal
        start_s = clock.now_s()
        self._tick = RateKeeper(setpoint_rate_hz, start_s)
        self.phase = FlightPhase.CONNECTING
        self._note = ""
        self._pose: StampedPose | None = None  # the newest one fit to be believed
        self._odom_sequence = -1
        self._intent: Intent | None = None
        self._trajectory: Trajectory | None = None
        self._handover: Handover | None = None
        self._flown: Setpoint | None = None  # the newest setpoint on the wire
        self._forsaken: tuple[int, float] | None = None  # malformed, or made in an odom that is no more
        self._malformed_count = 0
        self._arming: Arming | None = None
        self._may_arm = True  # a refused arming is not tried again before the mission has withdrawn FLY
        self._arm_asked_s = -math.inf
        self._land_asked_s = -math.inf
        self._land_wait_s = math.inf
        self._land_seen = False
        self._land_wanted = ""
        self._asked_s = -math.inf
        self._reboots = 0

    def step(self) -> None:
        """One turn: listen, feed, judge, act, stream, tell."""
        now_s = self._clock.now_s()
        self._link.receive(now_s)
        self._feed_pose(now_s)
        self._hear_mission(now_s)
        self._watch_authority(now_s)
        self._advance(now_s)
        if self._tick.due(now_s):
            self._stream(now_s)
            self._publish(now_s)
        self._link.keep_alive(now_s)

    def wait(self) -> None:
        """Block until bytes arrive or the next turn is due (at once on a link in memory)."""
        now_s = self._clock.now_s()
        self._link.wait(min(self._tick.next_s() - now_s, _TICK_S))

    def request_land(self, why: str = "asked to end") -> None:
        """End the flight here and now, whatever the mission says. On the ground: no flight is begun any more."""
        self._land_wanted = self._land_wanted or why

    @property
    def in_flight(self) -> bool:
        """Whether the vehicle is, or may be, in the air by our doing."""
        return self.phase in (FlightPhase.ARMING, *_IN_THE_AIR)

    # ---- listen -----------------------------------------------------------------------------------------------

    def _feed_pose(self, now_s: float) -> None:
        """Hand every new, good and young pose to the autopilot; anything else is silence, never a repetition."""
        sequence = self._channels.odom.sequence()
        if sequence == self._odom_sequence:
            return
        try:
            pose = self._channels.odom.latest()
        except ValueError:
            pose = None
        self._odom_sequence = sequence
        if pose is None or not self._is_good(pose, now_s):
            return
        jumped = self._pose is not None and pose.reset_counter != self._pose.reset_counter
        self._pose = pose
        if jumped:
            self._note = "pose source was reset: holding"
            self._guard.rebase(self._situation(now_s))
            self._forsaken, self._trajectory = _key(self._trajectory), None
        self._link.feed_pose(pose, now_s)

    def _is_good(self, pose: StampedPose, now_s: float) -> bool:
        newer = self._pose is None or pose.stamp_s > self._pose.stamp_s
        young = -_POSE_FUTURE_S <= now_s - pose.stamp_s <= _POSE_MAX_AGE_S
        shaped = pose.velocity_odom_mps.shape == (3,) and pose.covariance.shape == (6, 6)
        finite = shaped and bool(np.isfinite(pose.velocity_odom_mps).all() and np.isfinite(pose.covariance).all())
        return newer and young and finite and pose.quality > 0

    def _hear_mission(self, now_s: float) -> None:
        """Take over the newest intent; a trajectory that cannot be sampled is refused here, once."""
        try:
            intent = self._channels.intent.latest()
        except ValueError:
            intent = None
        if intent is None or intent is self._intent or not -0.1 <= now_s - intent.stamp_s <= self._guard.patience.intent_hold_s:
            return
        self._intent = intent
        self._may_arm = self._may_arm or intent.goal is not Goal.FLY
        trajectory = intent.trajectory if intent.goal is Goal.FLY else None
        if trajectory is None:
            self._trajectory = None
            return
        if _key(trajectory) in (_key(self._trajectory), self._forsaken):
            return
        fault = fault_of(trajectory)
        self._trajectory, self._handover = None if fault else trajectory, None
        if fault:
            self._forsaken, self._note = _key(trajectory), f"refused: {fault}"
            self._malformed_count += 1

    # ---- judge ------------------------------------------------------------------------------------------------

    def _watch_authority(self, now_s: float) -> None:
        """Whatever we did not ask for is somebody else's will: yield, or accept the autopilot's own landing."""
        t = self._link.telemetry
        rebooted, self._reboots = t.reboots != self._reboots, t.reboots
        if self.phase in (FlightPhase.CONNECTING, FlightPhase.READY) and t.armed:
            if self._firmware.is_ours(t.custom_mode) and now_s - self._arm_asked_s < _LATE_ARM_S:
                self.phase = FlightPhase.LANDING  # our own request, withdrawn before it took effect
            else:
                self._yield("armed by somebody else")
                if self._firmware.is_ours(t.custom_mode):  # by us before a restart: nobody flies it now
                    self._link.stop_heartbeats()
        elif self.phase in _IN_THE_AIR and rebooted:
            self._yield("the autopilot restarted in flight")
        elif self.phase in _IN_THE_AIR and now_s - t.heard_s > _LINK_LOST_S:
            self._yield("the autopilot is silent")
            self._link.stop_heartbeats()
        elif self.phase is FlightPhase.FLYING and not t.armed:
            self._land_finished("disarmed in flight")
        elif self.phase is FlightPhase.FLYING and self._firmware.is_landing(t.custom_mode):
            self.phase, self._land_seen, self._note = FlightPhase.LANDING, True, f"the autopilot lands: {t.warning}"
        elif self.phase is FlightPhase.FLYING and not self._firmware.is_ours(t.custom_mode):
            self._yield(f"mode changed to {self._firmware.mode_name(t.custom_mode)}")

    def _situation(self, now_s: float) -> Situation:
        pose, intent = self._pose, self._intent
        intent_age_s = math.inf if intent is None else now_s - intent.stamp_s
        if pose is None:
            return Situation(now_s, (0.0, 0.0, 0.0), 0.0, math.inf, intent_age_s, 0)
        x, y, z = pose.odom_from_body.translation_m.tolist()
        yaw_rad, age_s = pose.odom_from_body.yaw_rad(), now_s - pose.stamp_s
        return Situation(now_s, (x, y, z), yaw_rad, age_s, intent_age_s, pose.map_epoch)

    def _goal(self, now_s: float) -> Goal:
        """What a mission that is not silent wants, STANDBY otherwise."""
        if self._intent is None or now_s - self._intent.stamp_s > self._guard.patience.intent_hold_s:
            return Goal.STANDBY
        return self._intent.goal

    # ---- act --------------------------------------------------------------------------------------------------

    def _advance(self, now_s: float) -> None:
        """One step of the sequence for the phase we are in."""
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
        t = self._link.telemetry
        missing = self._firmware.missing_for_arming(t, self._link.time_known, now_s)
        if not missing:
            self.phase, self._note = FlightPhase.READY, ""
            return
        self._note = t.failure or missing
        if t.system == 0 or now_s - self._asked_s < _ASK_AGAIN_S:
            return
        self._asked_s = now_s
        self._link.request_streams(now_s, self._firmware.streams_hz, () if t.version else self._firmware.asked_once)
        if self._gimbal:
            self._link.claim_gimbal(now_s)
        if not t.origin_known and not self._firmware.missing_for_origin(t, self._link.time_known, now_s):
            self._link.send_origin(now_s, self._origin.lat_deg, self._origin.lon_deg, self._origin.alt_m)

    def _stand_ready(self, now_s: float) -> None:
        if self._firmware.missing_for_arming(self._link.telemetry, self._link.time_known, now_s):
            self.phase = FlightPhase.CONNECTING
        elif self._goal(now_s) is Goal.FLY and self._may_arm and not self._land_wanted:
            self.phase, self._note, self._arming = FlightPhase.ARMING, "", self._firmware.arming(now_s)
            self._guard.rebase(self._situation(now_s), rest_s=0.0)

    def _arm(self, now_s: float) -> None:
        arming, t = self._arming, self._link.telemetry
        if (
            arming is None
            or self._land_wanted
            or self._goal(now_s) is not Goal.FLY
            or self._guard.must_land(self._situation(now_s))
        ):
            self._abandon_arming(self._land_wanted or "arming withdrawn")
            return
        outcome, command = arming.step(now_s, t)
        if outcome is Outcome.ARMED:
            self.phase, self._note = FlightPhase.FLYING, ""
            if not arming.streams:
                self._guard.rebase(self._situation(now_s), rest_s=0.0)
        elif outcome is Outcome.GIVEN_UP:
            self._abandon_arming(arming.reason)
        elif command is not None:
            self._arm_asked_s = now_s if command == ARM else self._arm_asked_s
            self._link.command(now_s, command[0], *command[1])

    def _abandon_arming(self, why: str) -> None:
        """Back on the ground, or into a landing if the motors may have started in between."""
        self._arming, self._may_arm, self._note = None, False, why
        self.phase = FlightPhase.LANDING if self._link.telemetry.armed else FlightPhase.READY

    def _fly(self, now_s: float) -> None:
        wanted = "the mission asks to land" if self._goal(now_s) is Goal.LAND else ""
        why = self._land_wanted or self._guard.must_land(self._situation(now_s)) or wanted
        if why:
            self.phase, self._note = FlightPhase.LANDING, why
            self._land(now_s)

    def _land(self, now_s: float) -> None:
        """Ask for LAND until it is seen, then leave it alone until the motors stop. There is no way back up."""
        t = self._link.telemetry
        if not t.armed:
            self._land_finished("")
        elif self._firmware.is_landing(t.custom_mode):
            self._land_seen = True
        elif not self._firmware.is_ours(t.custom_mode):
            self._yield(f"mode changed to {self._firmware.mode_name(t.custom_mode)}")
        elif now_s - self._land_asked_s >= _LAND_AGAIN_S and self._mode_is_current(now_s):
            self._land_asked_s = now_s
            self._link.command(now_s, self._firmware.land[0], *self._firmware.land[1])

    def _mode_is_current(self, now_s: float) -> bool:
        """Whether no human can have taken over unseen: the mode was told this instant, or is not told often."""
        self._land_wait_s = min(self._land_wait_s, now_s)
        heartbeat_s = self._link.telemetry.heartbeat_s
        waited = now_s - self._land_wait_s >= _MODE_WAIT_S
        return heartbeat_s > self._land_asked_s and (waited or now_s - heartbeat_s < _MODE_FRESH_S)

    def _land_finished(self, why: str) -> None:
        self.phase, self._note, self._trajectory = FlightPhase.LANDED, why or self._note, None

    def _yield(self, why: str) -> None:
        self.phase, self._note, self._trajectory, self._arming = FlightPhase.YIELDED, f"yielded: {why}", None, None

    # ---- stream and tell --------------------------------------------------------------------------------------

    def _stream(self, now_s: float) -> None:
        """One setpoint, if the vehicle is ours: the guard's answer to the trajectory, or its hold."""
        arming = self.phase is FlightPhase.ARMING and self._arming is not None and self._arming.streams
        landing = self.phase is FlightPhase.LANDING and not self._land_seen
        if not (arming or landing or self.phase is FlightPhase.FLYING):
            return
        cleared, refusal = self._clear(now_s)
        if refusal is not None:
            self._note = f"refused: {refusal.reason}"
        self._flown = cleared.setpoint
        self._link.stream(cleared, now_s, self._gimbal)

    def _clear(self, now_s: float) -> tuple[ClearedSetpoint, Refusal | None]:
        linked = now_s - self._link.telemetry.heard_s <= _LINK_HOLD_S
        trajectory = self._trajectory if self.phase is FlightPhase.FLYING and linked else None
        if trajectory is None:
            return self._guard.clear(None, self._situation(now_s))
        if self._handover is None:
            self._handover = Handover(self._flown, trajectory, now_s) if self._flown else None
        sample = trajectory.setpoint_at(now_s)
        wanted = self._handover.apply(sample, now_s) if self._handover else sample
        return self._guard.clear(Proposal(wanted, trajectory.identifier, trajectory.map_epoch), self._situation(now_s))

    def _publish(self, now_s: float) -> None:
        t, pose = self._link.telemetry, self._pose
        if pose is not None:
            world_from_body, velocity = pose.odom_from_body, pose.velocity_odom_mps
        else:
            world_from_body, velocity = Pose(t.quat_wxyz, t.position_m), t.velocity_mps
        self._channels.vehicle.publish(
            VehicleState(
                stamp_s=now_s,
                world_from_body=world_from_body,
                velocity_world_mps=velocity,
                armed=t.armed,
                mode=self._firmware.mode_name(t.custom_mode),
                phase=self.phase,
                battery_fraction=t.battery_fraction,
                human_in_control=self.phase is FlightPhase.YIELDED,
                camera_pitch_down_rad=t.camera_pitch_down_rad if self._gimbal else math.nan,
                trajectory_id=-1 if self._trajectory is None else self._trajectory.identifier,
                refusals=self._guard.refusals + self._malformed_count,
                note=self._note[:_LONGEST_NOTE],
            )
        )


def _key(trajectory: Trajectory | None) -> tuple[int, float] | None:
    """A restarted mission counts from zero again, so the start belongs to a trajectory's name."""
    return None if trajectory is None else (trajectory.identifier, trajectory.start_s)


def make_pilot(
    bytes_link: ByteLink,
    firmware: Personality,
    guard: Guard,
    channels: PilotChannels,
    clock: Clock,
    origin: Origin,
    setpoint_rate_hz: float = 30.0,
    gimbal: bool = False,
    log: FrameLog | None = None,
) -> Pilot:
    """Wire a pilot that flies a firmware over the given bytes."""
    link = Link(bytes_link, log or NoLog(), clock.now_s(), firmware)
    return Pilot(link, guard, channels, clock, origin, setpoint_rate_hz, gimbal)
