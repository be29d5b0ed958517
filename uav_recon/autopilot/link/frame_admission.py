"""Admission of received frames: those of the autopilot and the gimbal that are flown."""

from __future__ import annotations

from enum import Enum

from uav_recon.autopilot.link.autopilot_identity import AutopilotIdentity
from uav_recon.autopilot.link.duplicate_autopilot import DuplicateAutopilotDetector
from uav_recon.autopilot.link.link_alerts import LinkAlerts
from uav_recon.autopilot.link.other_program import OtherProgramFilter
from uav_recon.autopilot.link.second_copy import from_second_copy
from uav_recon.autopilot.link.stale_frame_filter import StaleFrameFilter
from uav_recon.autopilot.mavlink.address import COMPANION_ADDRESS, MavlinkAddress
from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.mavlink.link_status import DUPLICATE_AUTOPILOT
from uav_recon.autopilot.mavlink.messages import Heartbeat, Message, Received, TimesyncMessage
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


class FrameVerdict(Enum):
    """Sender of a received frame; only messages of AUTOPILOT and GIMBAL are used."""

    AUTOPILOT = "the newest of its kind from the vehicle's autopilot"
    GIMBAL = "from the vehicle's gimbal"
    OWN_COPY = "our own ids: a second copy of this program, which forbids arming"
    OWN_IDS = "our own ids: any other program"
    STRANGER = "not on the allow list, or without a true and new signature"
    OTHER_PROGRAM = "the autopilot's ids: another program"
    TOO_EARLY = "before the first heartbeat of the autopilot"
    NO_CONTENT = "of a kind that is not used, or with values that cannot be"
    STALE = "repeated, or overtaken by a newer frame of the autopilot"


class FrameAdmission:
    """Judges each frame once, in the order of arrival; counts and reports the others.

    address: our own. ``alerts``: what people have to know of other senders. ``identity``:
    the autopilot's uid. ``duplicate``: two autopilots used its ids at the newest reading. ``own_id_in_use``: a second copy of
    this program was received. ``stale_frames``: number of STALE.
    """

    def __init__(self, allow_list: AllowListFilter, address: MavlinkAddress = COMPANION_ADDRESS) -> None:
        self._allow_list = allow_list
        self._address = address
        self._others = OtherProgramFilter()
        self._duplicates = DuplicateAutopilotDetector()
        self._stale_filter = StaleFrameFilter()
        self._received_heartbeat = False
        self._mavlink1_frames = 0
        self.alerts = LinkAlerts(address)
        self.identity = AutopilotIdentity(allow_list.uid)
        self.duplicate = False
        self.own_id_in_use = False
        self.stale_frames = 0

    def judge(self, received: Received, now_s: float, clock_lost: bool) -> FrameVerdict:
        """Return the verdict of a frame.

        clock_lost: another autopilot may have replaced the one before.
        """
        if (received.system, received.component) == self._address:
            return self._judge_own_ids(received)
        if not self._allow_list.admits(received):
            self.alerts.update(received)
            return FrameVerdict.STRANGER
        from_autopilot = self._allow_list.is_autopilot(received)
        if from_autopilot and self._others.is_other(received):
            self._report_other_program(received)
            return FrameVerdict.OTHER_PROGRAM
        if from_autopilot and isinstance(received.message, Heartbeat):
            self._received_heartbeat = True
        if not self._received_heartbeat:
            return FrameVerdict.TOO_EARLY
        if received.message is None:
            return FrameVerdict.NO_CONTENT
        return self._judge_autopilot(received, now_s, clock_lost) if from_autopilot else FrameVerdict.GIMBAL

    def update(self, now_s: float, mavlink1_frames: int) -> None:
        """Conclude a reading: update whether the autopilot is the only one.

        mavlink1_frames: number of them since the start.
        """
        self.duplicate = self._duplicates.detected(now_s)
        if self.duplicate:
            self.alerts.note(DUPLICATE_AUTOPILOT)
        new_frames = mavlink1_frames - self._mavlink1_frames
        self._mavlink1_frames = mavlink1_frames
        if new_frames:
            self.alerts.note(Reason(ReasonCode.INTRUDER_MAVLINK1))
            self._allow_list.refuse("MAVLink 1", new_frames)

    def restart(self) -> None:
        """Start the numbers of frames again: the autopilot restarted."""
        self._stale_filter = StaleFrameFilter()

    def recent_states(self, now_s: float) -> list[tuple[bool, int]]:
        """Return (armed, mode) of the autopilot's heartbeats of the last quarter second."""
        return self._duplicates.recent_states(now_s)

    def _judge_own_ids(self, received: Received) -> FrameVerdict:
        """Return the verdict of a frame with our ids.

        A second copy of this program forbids arming; any other program is only reported.
        """
        copy = from_second_copy(received)
        self.own_id_in_use = self.own_id_in_use or copy
        self._allow_list.refuse(
            f"system {received.system}, component {received.component}, our own ids{_sender(received.message)}"
        )
        self.alerts.update(received)
        return FrameVerdict.OWN_COPY if copy else FrameVerdict.OWN_IDS

    def _report_other_program(self, received: Received) -> None:
        """Report a program that sends with the autopilot's ids, once."""
        message = received.message
        if isinstance(message, Heartbeat):
            self._allow_list.refuse(f"system {received.system}, component {received.component}{_sender(message)}")
            self.alerts.note(Reason(ReasonCode.INTRUDER_HEARTBEAT, (message.vehicle, message.autopilot)))

    def _judge_autopilot(self, received: Received, now_s: float, clock_lost: bool) -> FrameVerdict:
        """Return whether a frame of the autopilot is stale.

        The round trip of an answer to TIMESYNC shows how late it is. Of two autopilots, neither's message is older.
        """
        self._duplicates.update(received, now_s)
        dated = isinstance(received.message, TimesyncMessage) and received.message.tc1_ns != 0
        newest = self._stale_filter.is_newest(received.frame, now_s)
        if not (newest or dated or self.duplicate):
            self.stale_frames += 1
            return FrameVerdict.STALE
        self.identity.update(now_s, clock_lost)
        return FrameVerdict.AUTOPILOT


def _sender(message: Message | None) -> str:
    """Return what a heartbeat tells of its sender, '' for any other message."""
    return f" (MAV_TYPE {message.vehicle}, MAV_AUTOPILOT {message.autopilot})" if isinstance(message, Heartbeat) else ""
