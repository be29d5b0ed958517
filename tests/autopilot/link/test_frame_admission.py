"""One verdict for each received frame: its sender, and whether its message is used."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from uav_recon.autopilot.firmware.px4 import PX4
from uav_recon.autopilot.link.duplicate_autopilot import resolved
from uav_recon.autopilot.link.frame_admission import FrameAdmission, FrameVerdict
from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.mavlink.codec import Decoder
from uav_recon.autopilot.mavlink.messages import Heartbeat, Received
from uav_recon.types.reason_code import ReasonCode

AUTOPILOT, GIMBAL, OWN, CAMERA, OTHER_SYSTEM = (1, 1), (1, 154), (233, 191), (1, 100), (7, 1)
BEAT = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
COMPANION_BEAT = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
ROUTER_BEAT = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
PLACE = mavlink.MAVLink_local_position_ned_message(7, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NO_PLACE = mavlink.MAVLink_local_position_ned_message(7, float("nan"), 0.0, 0.0, 0.0, 0.0, 0.0)
SETPOINT = mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0, 0.0, 0.0, 0.0, *[0.0] * 8)
ANGLE = mavlink.MAVLink_gimbal_device_attitude_status_message(0, 0, 7, 0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0)
ANSWER = mavlink.MAVLink_timesync_message(38_000_000_000, 1_000_000_000)
REQUEST = mavlink.MAVLink_timesync_message(0, 38_000_000_000)
V = FrameVerdict


def received(message: Any, sender: tuple[int, int], number: int) -> Received:
    wire = mavlink.MAVLink(None, *sender)
    wire.seq = number
    data = bytes(message.pack(wire))
    (frame,) = Decoder().feed(data)
    return frame


@pytest.fixture
def admission() -> FrameAdmission:
    """The admission of a link whose autopilot sent a heartbeat and a position, numbers 10 and 11."""
    admission = FrameAdmission(AllowListFilter())
    for number, message in ((10, BEAT), (11, PLACE)):
        assert admission.judge(received(message, AUTOPILOT, number), 0.0, False) is V.AUTOPILOT
    return admission


@pytest.mark.parametrize(
    ("message", "sender", "number", "verdict", "alert"),
    [
        (PLACE, AUTOPILOT, 12, V.AUTOPILOT, None),
        (PLACE, AUTOPILOT, 11, V.STALE, None),
        (PLACE, AUTOPILOT, 5, V.STALE, None),
        (ANSWER, AUTOPILOT, 12, V.AUTOPILOT, None),
        (NO_PLACE, AUTOPILOT, 12, V.NO_CONTENT, None),
        (ROUTER_BEAT, AUTOPILOT, 100, V.OTHER_PROGRAM, ReasonCode.INTRUDER_HEARTBEAT),
        (ANGLE, GIMBAL, 0, V.GIMBAL, None),
        (COMPANION_BEAT, OWN, 0, V.OWN_COPY, ReasonCode.INTRUDER_OWN_ID),
        (SETPOINT, OWN, 0, V.OWN_COPY, ReasonCode.INTRUDER_OWN_ID),
        (ROUTER_BEAT, OWN, 0, V.OWN_IDS, ReasonCode.INTRUDER_OWN_ID),
        (PLACE, CAMERA, 12, V.STRANGER, ReasonCode.INTRUDER_STATE),
        (PLACE, OTHER_SYSTEM, 12, V.STRANGER, ReasonCode.INTRUDER_STATE),
        (ROUTER_BEAT, (255, 190), 12, V.STRANGER, None),
    ],
)
def test_each_frame_gets_one_verdict(
    admission: FrameAdmission,
    message: Any,
    sender: tuple[int, int],
    number: int,
    verdict: FrameVerdict,
    alert: ReasonCode | None,
) -> None:
    assert admission.judge(received(message, sender, number), 0.1, False) is verdict
    assert [reason.code for reason in admission.alerts.news()] == ([] if alert is None else [alert])
    assert admission.own_id_in_use == (verdict is V.OWN_COPY)
    assert admission.stale_frames == (verdict is V.STALE)


def test_nothing_is_used_before_the_first_heartbeat() -> None:
    admission = FrameAdmission(AllowListFilter())
    early = [(PLACE, AUTOPILOT), (ANGLE, GIMBAL), (NO_PLACE, AUTOPILOT)]
    verdicts = [admission.judge(received(message, sender, n), 0.0, False) for n, (message, sender) in enumerate(early)]
    assert verdicts == [V.TOO_EARLY] * 3
    assert admission.judge(received(BEAT, AUTOPILOT, 3), 0.0, False) is V.AUTOPILOT
    assert admission.judge(received(ANGLE, GIMBAL, 3), 0.0, False) is V.GIMBAL


@pytest.mark.parametrize(("message", "verdict"), [(ANSWER, V.AUTOPILOT), (REQUEST, V.STALE)])
def test_a_late_answer_to_timesync_is_used_and_a_late_request_is_not(
    admission: FrameAdmission, message: Any, verdict: FrameVerdict
) -> None:
    assert admission.judge(received(message, AUTOPILOT, 12), 0.0, False) is V.AUTOPILOT
    assert admission.judge(received(message, AUTOPILOT, 12), 0.1, False) is verdict


def test_frame_numbers_begin_again_after_a_restart(admission: FrameAdmission) -> None:
    assert admission.judge(received(PLACE, AUTOPILOT, 2), 0.1, False) is V.STALE
    admission.restart()
    assert admission.judge(received(PLACE, AUTOPILOT, 3), 0.1, False) is V.AUTOPILOT


def test_new_frames_of_mavlink_1_are_counted_and_reported(caplog: pytest.LogCaptureFixture) -> None:
    allow_list = AllowListFilter()
    admission = FrameAdmission(allow_list)
    for total in (0, 2, 2, 5):
        admission.update(0.0, total)
    assert allow_list.refused == 5
    assert [reason.code for reason in admission.alerts.news()] == [ReasonCode.INTRUDER_MAVLINK1]
    assert len(caplog.records) == 1


OFFBOARD, LAND, MANUAL = 6 << 16, 6 << 24 | 4 << 16, 1 << 16


@pytest.mark.parametrize(
    ("armed", "mode", "states", "duplicate", "used"),
    [
        (True, OFFBOARD, [(True, OFFBOARD)], False, (True, OFFBOARD)),
        (False, OFFBOARD, [(True, OFFBOARD), (False, OFFBOARD)], False, None),
        (False, OFFBOARD, [(False, OFFBOARD)], False, (False, OFFBOARD)),
        (True, OFFBOARD, [(True, MANUAL), (True, OFFBOARD)], False, (True, OFFBOARD)),
        (True, OFFBOARD, [(True, MANUAL), (True, OFFBOARD)], True, (True, MANUAL)),
        (True, LAND, [(True, LAND), (True, OFFBOARD)], True, (True, OFFBOARD)),
        (True, LAND, [(True, LAND), (False, MANUAL)], True, (True, LAND)),
    ],
)
def test_the_safest_of_contradicting_heartbeats_is_used(
    armed: bool, mode: int, states: list[tuple[bool, int]], duplicate: bool, used: tuple[bool, int] | None
) -> None:
    message = received(mavlink.MAVLink_heartbeat_message(2, 12, 0x80 if armed else 0, mode, 4, 3), AUTOPILOT, 0).message
    assert isinstance(message, Heartbeat)
    found = resolved(message, states, duplicate, PX4)
    assert (None if found is None else (found.armed, found.custom_mode)) == used
