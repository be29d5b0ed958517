"""The link to one autopilot: turns received bytes into telemetry, and sends our messages."""

from __future__ import annotations

import math
from dataclasses import replace

from uav_recon.autopilot.firmware.profile import FirmwareProfile
from uav_recon.autopilot.link.autopilot_measurements import AutopilotMeasurements
from uav_recon.autopilot.link.duplicate_autopilot import resolved
from uav_recon.autopilot.link.flow_measurements import FlowMeasurements
from uav_recon.autopilot.link.frame_admission import FrameAdmission, FrameVerdict
from uav_recon.autopilot.link.frame_exchange import FrameExchange
from uav_recon.autopilot.link.gimbal_commands import GimbalCommands
from uav_recon.autopilot.link.link_alerts import LinkAlerts
from uav_recon.autopilot.link.link_clock import LinkClock
from uav_recon.autopilot.link.local_frame import in_odom, moved
from uav_recon.autopilot.link.message_requests import MessageRequests
from uav_recon.autopilot.link.message_sender import MessageSender
from uav_recon.autopilot.link.navigation import CompanionNavigation, Navigation
from uav_recon.autopilot.link.own_heartbeat import OwnHeartbeat
from uav_recon.autopilot.link.parameter_requests import ParameterRequests
from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.mavlink.link_status import LinkStatus
from uav_recon.autopilot.mavlink.messages import (
    Attitude,
    DownwardRange,
    Firmware,
    FlowAngle,
    FlowRate,
    GimbalAttitude,
    Heartbeat,
    LocalPosition,
    Message,
    OdometryMessage,
    ParameterValue,
    Received,
    TimesyncMessage,
    UpwardRange,
)
from uav_recon.autopilot.mavlink.telemetry import Telemetry, rebooted, updated
from uav_recon.safety.guard import ClearedSetpoint
from uav_recon.types.pose import StampedPose
from uav_recon.types.reason import Reason

_AUTOPILOT_VERSION = 148
_NS = 1_000_000_000


class VehicleLink:
    """Exchanges MAVLink messages with one autopilot over one byte link.

    Methods never block and never raise on received data.

    frames: signed with the key of the allow list. firmware: profile of the firmware on the other end. start_s: from which on
    heartbeats, requests and clock count. navigation: who tells the autopilot where it is. ``telemetry``: what the autopilot
    reported, its positions and attitudes in odom if its local frame is known.
    """

    def __init__(
        self,
        frames: FrameExchange,
        allow_list: AllowListFilter,
        firmware: FirmwareProfile,
        start_s: float,
        navigation: Navigation | None = None,
    ) -> None:
        self.firmware = firmware
        self.telemetry = Telemetry()
        self._frames = frames
        self._sender = MessageSender(frames)
        self._admission = FrameAdmission(allow_list)
        self._clock = LinkClock(start_s)
        self._navigation = navigation or CompanionNavigation()
        self._pose_fed_s = -math.inf
        self.measurements = AutopilotMeasurements(self._clock, self._navigation)
        self.flow = FlowMeasurements(self._clock)
        self.requests = MessageRequests(self._sender, start_s, firmware.polled_hz, self._navigation.streams_hz)
        self.parameters = ParameterRequests(self._sender)
        self.heartbeat = OwnHeartbeat(start_s)
        self.gimbal = GimbalCommands(self._sender, start_s)

    @property
    def status(self) -> LinkStatus:
        """Observations of the link itself until now."""
        admission, clock = self._admission, self._clock
        return LinkStatus(
            time_known=clock.known,
            reboots=clock.restarts,
            clock_answers=clock.answers,
            pose_fed_s=self._pose_fed_s,
            stale_frames=admission.stale_frames,
            slow=clock.slow,
            own_id_in_use=admission.own_id_in_use,
            identity_fault=admission.identity.fault,
            duplicate_autopilot=admission.duplicate,
            failure=self._frames.failure,
        )

    @property
    def alerts(self) -> LinkAlerts:
        """Messages for people about other senders and faults on the link."""
        return self._admission.alerts

    def receive(self, now_s: float) -> None:
        """Process the received bytes."""
        frames = self._frames.read(now_s)
        if frames is None:
            return
        for received in frames:
            self._on_frame(received, now_s)
        slow = self._clock.update(now_s)
        if slow is not None:
            self.alerts.note(slow)
        self._admission.update(now_s, self._frames.mavlink1_frames)

    def wait(self, timeout_s: float) -> None:
        """Block until bytes are available or the timeout ends."""
        self._frames.wait(timeout_s)

    def keep_alive(self, now_s: float) -> None:
        """Send our heartbeat and the requests that are due: for clock, messages and uid."""
        encoder = self._sender.encoder
        if self.heartbeat.due(now_s, self.telemetry.received_s):
            self._sender.send(encoder.heartbeat(), now_s)
        if self.telemetry.system and self._clock.request_due(now_s):
            self._sender.send(encoder.timesync(0, int(now_s * _NS)), now_s)
        self.requests.poll(now_s)
        if self._admission.identity.request_due(now_s):
            self.requests.request(now_s, _AUTOPILOT_VERSION)

    def feed_pose(self, pose: StampedPose, now_s: float) -> None:
        """Send ODOMETRY on the autopilot's clock, unless it navigates by itself.

        Its own pose must not come back to it.
        Nothing is sent before that clock is known, while it is doubtful, or to another autopilot.
        """
        if not self._clock.known or self._admission.identity.fault:
            return
        self._navigation.add_odometry(pose)
        if self._navigation.local_from_odom is None:
            return
        if self._navigation.feeds:
            time_us = self._clock.autopilot_ns(pose.stamp_s) // 1000
            self._sender.send(self._sender.encoder.odometry(pose, time_us, self.firmware.pose_frame), now_s)
        self._pose_fed_s = now_s

    def estimate_s(self, now_s: float) -> float:
        """Return the instant, on our clock, of the newest position that the autopilot estimated.

        NaN while it is not known.
        """
        stamp_s = self._clock.stamp_s(self.telemetry.estimate.boot_ms, now_s)
        return math.nan if stamp_s is None else stamp_s

    def stream(self, cleared: ClearedSetpoint, now_s: float, gimbal: bool) -> None:
        """Send a cleared setpoint in the autopilot's local frame, and its camera pitch.

        Nothing is sent while that frame is not known.
        """
        local_from_odom = self._navigation.local_from_odom
        if local_from_odom is None:
            return
        boot_ms = self._clock.autopilot_ns(now_s) // 1_000_000
        setpoint, encoder = moved(cleared.setpoint, local_from_odom), self._sender.encoder
        self._sender.send(encoder.setpoint(self._sender.target, setpoint, boot_ms, self.firmware.setpoint_mask), now_s)
        if gimbal:
            self.gimbal.turn(cleared.setpoint.camera_pitch_down_rad, now_s)

    def command(self, now_s: float, command: int, *parameters: float) -> None:
        """Send COMMAND_LONG to the autopilot."""
        self._sender.command(now_s, command, *parameters)

    def say(self, now_s: float, reason: Reason) -> None:
        """Send STATUSTEXT to the people at a ground station."""
        self._sender.send(self._sender.encoder.text(reason.short()), now_s)

    def send_origin(self, now_s: float, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        """Send the geographic origin to the autopilot."""
        self._sender.send(self._sender.encoder.origin(self._sender.target, lat_deg, lon_deg, alt_m), now_s)

    def _on_frame(self, received: Received, now_s: float) -> None:
        """Process a received frame, if it is admitted."""
        message, verdict = received.message, self._admission.judge(received, now_s, self._clock.lost)
        if message is None:
            return
        if verdict is FrameVerdict.AUTOPILOT:
            self._sender.target = received.system
            self.telemetry = replace(self.telemetry, system=received.system, received_s=now_s)
            self._on_message(message, now_s)
        elif verdict is FrameVerdict.GIMBAL and isinstance(message, GimbalAttitude):
            self.telemetry = updated(self.telemetry, message, now_s)

    def _on_message(self, message: Message, now_s: float) -> None:
        """Update the telemetry, and the parts of the link that need it, with a message."""
        match message:
            case Heartbeat():
                heartbeat = resolved(message, self._admission.recent_states(now_s), self._admission.duplicate, self.firmware)
                if heartbeat is None:
                    return
                message = heartbeat
            case TimesyncMessage():
                self._synchronise(message, now_s)
            case Attitude() | LocalPosition() | OdometryMessage():
                self.measurements.update(message, now_s, self._admission.duplicate)
                if isinstance(message, LocalPosition | Attitude):
                    message = in_odom(message, self._navigation.local_from_odom)
            case GimbalAttitude() | UpwardRange():
                measured_s = self._clock.measured_s(message.boot_ms, now_s)
                now_s = now_s if measured_s is None else measured_s
            case FlowAngle() | FlowRate() | DownwardRange() if not self._admission.duplicate:
                self.flow.update(message, now_s)
            case Firmware():
                self._admission.identity.check_uid(message.uid)
            case ParameterValue() if not self.parameters.includes(message.name):
                return
        self.telemetry = updated(self.telemetry, message, now_s)

    def _synchronise(self, message: TimesyncMessage, now_s: float) -> None:
        """Answer a request for our clock, or learn from the answer to one of ours."""
        if message.tc1_ns == 0:
            answer_ns = self._clock.answer_ns(message, now_s)
            if answer_ns is not None:
                self._sender.send(self._sender.encoder.timesync(answer_ns, message.ts1_ns), now_s)
        elif self._clock.observe(message, now_s):
            self._admission.restart()
            self.telemetry = rebooted(self.telemetry)
