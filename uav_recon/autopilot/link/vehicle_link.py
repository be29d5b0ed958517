"""The link to one autopilot: decodes received bytes into telemetry, and sends all messages."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from uav_recon.autopilot.firmware.profile import FirmwareProfile
from uav_recon.autopilot.link.autopilot_identity import AutopilotIdentity
from uav_recon.autopilot.link.duplicate_autopilot import DuplicateAutopilotDetector
from uav_recon.autopilot.link.link_alerts import LinkAlerts
from uav_recon.autopilot.link.local_frame import moved
from uav_recon.autopilot.link.navigation import CompanionNavigation, Navigation
from uav_recon.autopilot.link.other_program import OtherProgramFilter
from uav_recon.autopilot.link.stale_frame_filter import StaleFrameFilter
from uav_recon.autopilot.link.timesync import TimeSyncFilter
from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.mavlink.codec import Decoder, Encoder
from uav_recon.autopilot.mavlink.framing import kind_of
from uav_recon.autopilot.mavlink.link_status import DUPLICATE_AUTOPILOT, LinkStatus
from uav_recon.autopilot.mavlink.messages import (
    Attitude,
    Firmware,
    GimbalAttitude,
    Heartbeat,
    LocalPosition,
    Message,
    Odometry,
    ParameterValue,
    Received,
    TimesyncMessage,
    UpwardRange,
)
from uav_recon.autopilot.mavlink.telemetry import Telemetry, rebooted, updated
from uav_recon.autopilot.mavlink.tlog import FrameLog
from uav_recon.clock import RateKeeper
from uav_recon.interfaces import ByteLink
from uav_recon.safety.guard import ClearedSetpoint
from uav_recon.types.frames import FloatArray, frozen
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import ReportedPoses, TurnRates

SYSTEM = 233  # our system id: no common program uses it by default; MAV_GCS_SYSID of ArduPilot has to name it
COMPONENT = 191  # our component id: MAV_COMP_ID_ONBOARD_COMPUTER; the parameter UVR_COMP_ID of our script names it
_FLYING_KINDS = (84, 331)  #: refuse: SET_POSITION_TARGET_LOCAL_NED or ODOMETRY with our ids: another program flies with them
_DEAF_S = 1.7  #: release: after a longer silence of the autopilot our heartbeats stop, so that its failsafe lands
_SLOW_TRIP_S = 0.2  #: brake: retreat_speed_mps at a longer round trip: with 0.1 s each way, at 0.8 m/s, it lags by 0.08 m more
_SLOW_FOR_S = 10.0  #: brake: a link counts as slow this long after it was: each change of the speed limit costs a stop
_SET_MESSAGE_INTERVAL = 511  # ids of commands
_REQUEST_MESSAGE = 512
_NS = 1_000_000_000
#: refuse: a later answer does not count towards CLOCK_ANSWERS, without which PX4 is not armed: it learns nothing from it
_PROMPT_NS = 25_000_000
# Heartbeat (one lost ends no flight); TIMESYNC, and that while its clock is lost; gimbal, maximum.
_CHATTER_HZ = (5.0, 10.0, 50.0, 10.0)
_AUTOPILOT_VERSION = 148.0
_RATES = 32  #: internal: turn rates that are published together: a second
_OLD_RATE_S = 1.0  #: reject: a turn rate of the autopilot that is older
_OLD_POSE_S = 1.0  #: reject: a pose of the autopilot whose stamp is farther from now, past or future


class VehicleLink:
    """Exchanges MAVLink messages with one autopilot over one byte link.

    Methods never block and never raise on received data.

    firmware: profile of the firmware on the other end. gate: filter for senders. navigation: who tells the autopilot where it
    is. ``telemetry`` and ``status`` are the values of this moment: what the autopilot reported, its positions in odom if its
    local frame is known, and what the link itself observed.
    """

    def __init__(
        self,
        bytes_link: ByteLink,
        log: FrameLog,
        start_s: float,
        firmware: FirmwareProfile,
        gate: AllowListFilter,
        system: int = SYSTEM,
        component: int = COMPONENT,
        navigation: Navigation | None = None,
    ) -> None:
        self._bytes = bytes_link
        self._log = log
        self._gate = gate
        self._navigation = navigation or CompanionNavigation()
        self.firmware = firmware
        self.mute = False  # True: send no heartbeats any more
        self._own = (system, component)
        self._decoder = Decoder()
        self._encoder = Encoder(system, component)
        self._timesync = TimeSyncFilter()
        self._stale_filter = StaleFrameFilter()
        self._others = OtherProgramFilter()
        self._duplicates = DuplicateAutopilotDetector()
        self._identity = AutopilotIdentity(gate.uid)
        self._slow_s = -math.inf
        self._slow: Reason | None = None
        keepers = (RateKeeper(rate, start_s) for rate in _CHATTER_HZ)
        self._heartbeat, self._sync, self._resync, self._gimbal = keepers
        self._polled = [(identifier, RateKeeper(rate_hz, start_s)) for identifier, rate_hz in firmware.polled_hz]
        self._asked_parameters: set[str] = set()
        self._rates: deque[tuple[float, FloatArray]] = deque(maxlen=_RATES)
        self._rates_s = -math.inf  # stamp of the newest that was returned
        self.telemetry = Telemetry()
        self.status = LinkStatus()
        self.alerts = LinkAlerts(self._own)

    def receive(self, now_s: float) -> None:
        """Process the received bytes."""
        try:
            data = self._bytes.read()
        except OSError as error:
            self._note_failure(error)
            return
        if self.status.failure:
            self.status = replace(self.status, failure=None)
        old_frames = self._decoder.mavlink1_frames
        for received in self._decoder.feed(data):
            self._log.record(now_s, received.frame)
            self._on_frame(received, now_s)
        self._update_status(now_s)
        if self._decoder.mavlink1_frames > old_frames:
            self.alerts.note(Reason(ReasonCode.INTRUDER_MAVLINK1))
        self._gate.refuse("MAVLink 1", self._decoder.mavlink1_frames - old_frames)

    def _update_status(self, now_s: float) -> None:
        """Update whether the clock is known, the link slow, and the autopilot the only one.

        A link counts as slow until it has been quick for a while: each change of the speed limit costs a stop.
        """
        trip_s = self._timesync.usual_trip_s
        if trip_s > _SLOW_TRIP_S:
            self._slow_s = now_s
            self._slow = Reason(ReasonCode.LINK_SLOW, (trip_s,))
            self.alerts.note(self._slow)
        duplicate = self._duplicates.detected(now_s)
        if duplicate:
            self.alerts.note(DUPLICATE_AUTOPILOT)
        slow = self._slow if now_s - self._slow_s < _SLOW_FOR_S else None
        known, status = self._timesync.converged, self.status
        if (known, slow, duplicate) != (status.time_known, status.slow, status.duplicate_autopilot):
            self.status = replace(status, time_known=known, slow=slow, duplicate_autopilot=duplicate)

    def keep_alive(self, now_s: float) -> None:
        """Send our heartbeat, and the request for the autopilot's clock.

        No heartbeat is sent after a silence of the autopilot: one that lands only when our heartbeats stop (ArduPilot, two
        seconds later) has to land before the vehicle is given up as lost.
        """
        deaf = -math.inf < self.telemetry.received_s < now_s - _DEAF_S
        if self._heartbeat.due(now_s) and not (self.mute or deaf):
            self._send(self._encoder.heartbeat(), now_s)
        if self.telemetry.system and (self._resync if self._timesync.lost else self._sync).due(now_s):
            self._send(self._encoder.timesync(0, int(now_s * _NS)), now_s)
        self.poll(now_s)
        if self._identity.request_due(now_s):
            self.command(now_s, _REQUEST_MESSAGE, _AUTOPILOT_VERSION)

    def poll(self, now_s: float) -> None:
        """Request messages that the autopilot does not send often enough by itself."""
        for identifier, keeper in self._polled:
            if self.telemetry.system and keeper.due(now_s):
                self.command(now_s, _REQUEST_MESSAGE, float(identifier))

    def stop_heartbeats(self) -> None:
        """Stop our heartbeats, so that an autopilot that is still in our mode lands by failsafe."""
        self.mute = True

    def feed_pose(self, pose: StampedPose, now_s: float) -> None:
        """Send ODOMETRY on the autopilot's clock, unless it navigates by itself.

        Its own pose must not come back to it.
        Nothing is sent before that clock is known, while it is doubtful, or to another autopilot.
        """
        if not self.status.time_known or self.status.identity_fault:
            return
        self._navigation.add_odometry(pose)
        if self._navigation.local_from_odom is None:
            return
        if self._navigation.feeds:
            time_us = self._timesync.autopilot_ns(pose.stamp_s) // 1000
            self._send(self._encoder.odometry(pose, time_us, self.firmware.pose_frame), now_s)
        self.status = replace(self.status, pose_fed_s=now_s)

    def estimate_s(self, now_s: float) -> float:
        """Return the instant, on our clock, of the newest position that the autopilot estimated.

        NaN while it is not known.
        """
        boot_ms = self.telemetry.estimate.boot_ms
        return self._timesync.ours_s(boot_ms, now_s) if self.status.time_known and boot_ms >= 0 else math.nan

    def turn_rates(self) -> TurnRates | None:
        """Return the newest turn rates of the autopilot on our clock, None if nothing is new.

        Each value also holds those before it, because its reader may miss one.
        """
        if not self._rates or self._rates[-1][0] == self._rates_s:
            return None
        self._rates_s = self._rates[-1][0]
        return TurnRates(np.array([stamp_s for stamp_s, _ in self._rates]), np.array([rate for _, rate in self._rates]))

    def reported_poses(self) -> ReportedPoses | None:
        """Return the newest poses of an autopilot that navigates by itself, None if nothing is new."""
        return self._navigation.reported()

    def stream(self, cleared: ClearedSetpoint, now_s: float, gimbal: bool) -> None:
        """Send a cleared setpoint in the autopilot's local frame, and its camera pitch.

        The pitch is sent at most ten times a second. Nothing is sent while that frame is not known.
        """
        local_from_odom = self._navigation.local_from_odom
        if local_from_odom is None:
            return
        boot_ms = self._timesync.autopilot_ns(now_s) // 1_000_000
        setpoint = moved(cleared.setpoint, local_from_odom)
        self._send(self._encoder.setpoint(self.telemetry.system, setpoint, boot_ms, self.firmware.setpoint_mask), now_s)
        if gimbal and self._gimbal.due(now_s):
            pitch_rad = min(max(cleared.setpoint.camera_pitch_down_rad, -math.pi / 2), math.pi / 2)
            self._send(self._encoder.gimbal_pitch(self.telemetry.system, pitch_rad), now_s)

    def command(self, now_s: float, command: int, *parameters: float) -> None:
        """Send COMMAND_LONG to the autopilot."""
        self._send(self._encoder.command(self.telemetry.system, command, *parameters), now_s)

    def say(self, now_s: float, reason: Reason) -> None:
        """Send STATUSTEXT to the people at a ground station."""
        self._send(self._encoder.text(reason.short()), now_s)

    def request_streams(self, now_s: float, rates_hz: tuple[tuple[int, float], ...], once: tuple[int, ...]) -> None:
        """Request messages (id, rate) at a rate, and others once."""
        for identifier, rate_hz in (*rates_hz, *self._navigation.streams_hz):
            self.command(now_s, _SET_MESSAGE_INTERVAL, float(identifier), 1e6 / rate_hz)
        for identifier in once:
            self.command(now_s, _REQUEST_MESSAGE, float(identifier))

    def claim_gimbal(self, now_s: float) -> None:
        """Send DO_GIMBAL_MANAGER_CONFIGURE: we have primary control, secondary control is unused."""
        self.command(now_s, 1001, float(self._own[0]), float(self._own[1]), -1.0, -1.0)

    def send_origin(self, now_s: float, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        """Send the geographic origin to the autopilot."""
        self._send(self._encoder.origin(self.telemetry.system, lat_deg, lon_deg, alt_m), now_s)

    def ask_parameter(self, now_s: float, name: str) -> None:
        """Send PARAM_REQUEST_READ.

        From now on telemetry holds the newest reported value of this parameter.
        """
        self._asked_parameters.add(name)
        self._send(self._encoder.parameter_request(self.telemetry.system, name), now_s)

    def set_parameter(self, now_s: float, value: ParameterValue) -> None:
        """Send PARAM_SET. Only a person's own command may cause it."""
        self._send(self._encoder.parameter_set(self.telemetry.system, value), now_s)

    def wait(self, timeout_s: float) -> None:
        """Block until bytes are available or the timeout ends."""
        self._bytes.wait(timeout_s)

    def _send(self, frame: bytes, now_s: float) -> None:
        frame = self._gate.seal.put(frame, now_s)
        try:
            self._bytes.write(frame)
        except OSError as error:
            self._note_failure(error)
            return
        self._log.record(now_s, frame)

    def _note_failure(self, error: OSError) -> None:
        self.status = replace(self.status, failure=Reason(ReasonCode.LINK_ERROR, (error.strerror or str(error),)))

    def _on_frame(self, received: Received, now_s: float) -> None:
        """Process a frame that the gate admits, after the vehicle's first heartbeat.

        Of the autopilot's frames, only those are processed that are not stale.
        """
        message = received.message
        if (received.system, received.component) == self._own:
            self._on_own_ids(received)
            return
        if not self._gate.admits(received):
            self.alerts.update(received)
            return
        from_autopilot = self._gate.is_autopilot(received)
        if from_autopilot and self._others.is_other(received):
            self._on_other_program(received)
            return
        if isinstance(message, Heartbeat) and from_autopilot:
            self.telemetry = replace(self.telemetry, system=received.system)
        if self.telemetry.system == 0 or message is None:
            return
        if from_autopilot:
            self._on_autopilot_frame(received, message, now_s)
        elif isinstance(message, GimbalAttitude):
            self.telemetry = updated(self.telemetry, message, now_s)

    def _on_own_ids(self, received: Received) -> None:
        """Process a frame with our ids.

        A second copy of this program forbids arming; any other program is only reported.
        A copy is known by its heartbeat, which is that of a companion, and by its setpoints and poses.
        """
        message = received.message
        copy = isinstance(message, Heartbeat) and message.from_companion
        if copy or kind_of(received.frame) in _FLYING_KINDS:
            self.status = replace(self.status, own_id_in_use=True)
        self._gate.refuse(f"system {received.system}, component {received.component}, our own ids{_sender(message)}")
        self.alerts.update(received)

    def _on_other_program(self, received: Received) -> None:
        """Report a program that sends with the autopilot's ids, once, and use nothing of it."""
        message = received.message
        if isinstance(message, Heartbeat):
            self._gate.refuse(f"system {received.system}, component {received.component}{_sender(message)}")
            self.alerts.note(Reason(ReasonCode.INTRUDER_HEARTBEAT, (message.vehicle, message.autopilot)))

    def _on_autopilot_frame(self, received: Received, message: Message, now_s: float) -> None:
        self._duplicates.update(received, now_s)
        dated = isinstance(message, TimesyncMessage) and message.tc1_ns != 0  # its round trip shows how late it is
        newest = self._stale_filter.is_newest(received.frame, now_s)
        if not (newest or dated or self.status.duplicate_autopilot):  # of two autopilots, neither message is older
            self.status = replace(self.status, stale_frames=self.status.stale_frames + 1)
            return
        self.telemetry = replace(self.telemetry, received_s=now_s)
        self._identity.update(now_s, self._timesync.lost)
        self._on_message(message, now_s)

    def _on_message(self, message: Message, now_s: float) -> None:
        """Update the telemetry with a message, and the parts of the link that need it."""
        match message:
            case Heartbeat():
                self._on_heartbeat(message, now_s)
                return
            case TimesyncMessage():
                self._synchronise(message, now_s)
            case Attitude():
                self._keep_rate(message, now_s)
                self._navigate(message, message.boot_ms, now_s)
            case LocalPosition():
                self._navigate(message, message.boot_ms, now_s)
                message = self._in_odom(message)
            case Odometry() if self.status.time_known:
                self._add_own(message, self._timesync.ours_from_us(message.boot_us, now_s), now_s)
            case GimbalAttitude() | UpwardRange():
                now_s = self._measured_s(message.boot_ms, now_s)
            case Firmware():
                self._identity.told(message.uid)
                self.status = replace(self.status, identity_fault=self._identity.fault)
            case ParameterValue() if message.name not in self._asked_parameters:
                return
        self.telemetry = updated(self.telemetry, message, now_s)

    def _navigate(self, message: Message, boot_ms: int, now_s: float) -> None:
        """Give the navigation a message with a stamp in milliseconds, if that clock is known."""
        if boot_ms >= 0 and self.status.time_known:
            self._add_own(message, self._timesync.ours_s(boot_ms, now_s), now_s)

    def _measured_s(self, boot_ms: int, now_s: float) -> float:
        """Return when the autopilot measured something, on our clock; now_s if that is not known."""
        if boot_ms < 0 or not self.status.time_known:
            return now_s
        stamp_s = self._timesync.ours_s(boot_ms, now_s)
        return min(stamp_s, now_s) if now_s - stamp_s <= _OLD_RATE_S else now_s

    def _add_own(self, message: Message, stamp_s: float, now_s: float) -> None:
        if abs(now_s - stamp_s) <= _OLD_POSE_S and not self.status.duplicate_autopilot:
            self._navigation.add_message(message, min(stamp_s, now_s))

    def _in_odom(self, message: LocalPosition) -> LocalPosition:
        """Return a position of the local frame in odom, as far as that is known."""
        odom_from_local = (self._navigation.local_from_odom or Pose.identity()).inverse()
        position_m, velocity_mps = odom_from_local.apply(message.position_m), odom_from_local.rotation() @ message.velocity_mps
        return replace(message, position_m=frozen(position_m), velocity_mps=frozen(velocity_mps))

    def _keep_rate(self, message: Attitude, now_s: float) -> None:
        """Keep a turn rate with its stamp on our clock, if that clock is known."""
        if message.rate_radps is None or message.boot_ms < 0 or not self.status.time_known:
            return
        stamp_s = min(self._timesync.ours_s(message.boot_ms, now_s), now_s)
        if now_s - stamp_s <= _OLD_RATE_S and (not self._rates or stamp_s > self._rates[-1][0]):
            self._rates.append((stamp_s, message.rate_radps))

    def _on_heartbeat(self, message: Heartbeat, now_s: float) -> None:
        """Update armed state and mode.

        The motors count as off only when no current heartbeat reports them running. With two autopilots, a mode that is not
        ours has precedence over ours, so that a human pilot always wins, and ours over a landing, so that no sender can keep us
        from requesting one.
        """
        armed = [mode for runs, mode in self._duplicates.told(now_s) if runs]
        if armed and not message.armed:
            return
        if self.status.duplicate_autopilot:
            rules, modes = self.firmware, armed or [message.custom_mode]
            mode = min(modes, key=lambda mode: rules.is_ours(mode) + 2 * rules.is_landing(mode))
            message = replace(message, custom_mode=mode)
        self.telemetry = updated(self.telemetry, message, now_s)

    def _synchronise(self, message: TimesyncMessage, now_s: float) -> None:
        """Learn from answers; answer requests in the autopilot's OWN clock, once it is known.

        Pose stamps are on that clock too, so an autopilot that corrects stamps by what it learns from our answers finds
        an offset of zero, and one that uses stamps unchanged is right as well.
        """
        if message.tc1_ns == 0:
            if self._timesync.converged:
                self._answer(message.ts1_ns, now_s)
            return
        self._timesync.observe(message.ts1_ns, message.tc1_ns, int(now_s * _NS))
        if self._timesync.restarts > self.status.reboots:
            self.status = replace(self.status, reboots=self._timesync.restarts)
            self._stale_filter = StaleFrameFilter()
            self.telemetry = rebooted(self.telemetry)

    def _answer(self, asked_ns: int, now_s: float) -> None:
        """Send our answer to a request of the autopilot; it learns nothing from a late copy."""
        clock_ns = self._timesync.autopilot_ns(now_s)
        self._send(self._encoder.timesync(clock_ns, asked_ns), now_s)
        prompt = abs(clock_ns - asked_ns) <= _PROMPT_NS
        self.status = replace(self.status, clock_answers=self.status.clock_answers + prompt)


def _sender(message: Message | None) -> str:
    """Return what a heartbeat tells of its sender, '' for any other message."""
    return f" (MAV_TYPE {message.vehicle}, MAV_AUTOPILOT {message.autopilot})" if isinstance(message, Heartbeat) else ""
