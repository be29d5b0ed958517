"""PX4's rules on constructed telemetry: what is missing, and how arming is asked for."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import pytest
from telemetry_values import changed

from uav_recon.autopilot.firmware import px4
from uav_recon.autopilot.firmware.profile import ARM_DISARM, DO_SET_MODE, ArmingOutcome
from uav_recon.autopilot.firmware.px4 import Px4ArmingSequence
from uav_recon.autopilot.mavlink.link_status import LinkStatus
from uav_recon.autopilot.mavlink.telemetry import ArmingReadiness, ModeReport, Telemetry
from uav_recon.types.reason import Reason, autopilot_text
from uav_recon.types.reason_code import ReasonCode

OFFBOARD, LAND, LOITER, POSCTL, RTL = 393216, 100925440, 50593792, 196608, 84148224  # the first three as measured
CHANGED = Reason(ReasonCode.AUTOPILOT_CHANGED, ("b1", "a0"))


READY = Telemetry(
    system=1,
    received_s=10.0,
    mode=ModeReport(heartbeat_s=10.0, firmware_family=12, custom_mode=LOITER),
    readiness=ArmingReadiness(estimator_good=True, prearm_good=True, origin_known=True),
    version=(1, 17, 0),
)
LINKED = LinkStatus(time_known=True, pose_fed_s=10.0)


def missing(changes: dict[str, Any]) -> Reason | None:
    """What is missing before arming if these values differ from those of a vehicle that is ready."""
    of_link = {name: value for name, value in changes.items() if name in LinkStatus.__slots__}
    told = changed(READY, **{name: value for name, value in changes.items() if name not in of_link})
    return px4.missing_for_arming(told, dataclasses.replace(LINKED, **of_link), 10.0)


def given_up(*why: Reason) -> Reason:
    return Reason(ReasonCode.ARMING_GIVEN_UP, details=why)


def test_modes_as_measured() -> None:
    assert [px4.mode_name(m) for m in (OFFBOARD, LAND, LOITER, POSCTL, RTL)] == [
        "OFFBOARD", "AUTO.LAND", "AUTO.LOITER", "POSCTL", "AUTO.RTL",
    ]  # fmt: skip
    assert px4.mode_name(99 << 16) == "MODE99"
    assert [px4.is_ours(m) for m in (OFFBOARD, LAND, LOITER, POSCTL, RTL)] == [True, False, False, False, False]
    assert [px4.is_landing(m) for m in (OFFBOARD, LAND, LOITER, POSCTL, RTL)] == [False, True, False, False, False]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({}, None),
        ({"heartbeat_s": 6.9}, ReasonCode.NO_HEARTBEAT),
        ({"firmware_family": 3}, ReasonCode.WRONG_FIRMWARE),
        ({"own_id_in_use": True}, ReasonCode.OUR_ID_IN_USE),
        ({"duplicate_autopilot": True}, ReasonCode.TWO_AUTOPILOTS),
        ({"identity_fault": CHANGED, "duplicate_autopilot": True}, ReasonCode.AUTOPILOT_CHANGED),
        ({"version": None}, ReasonCode.FIRMWARE_UNKNOWN),
        ({"version": (1, 15, 3)}, ReasonCode.FIRMWARE_TOO_OLD),
        ({"version": (1, 18, 0)}, ReasonCode.FIRMWARE_TOO_NEW),
        ({"version": (1, 15, 4)}, None),
        ({"pose_fed_s": 9.4}, ReasonCode.NO_POSE_FED),
        ({"pose_fed_s": -math.inf}, ReasonCode.NO_POSE_FED),
        ({"estimator_good": False}, ReasonCode.ESTIMATOR_NOT_FOLLOWING),
        ({"origin_known": False}, ReasonCode.NO_ORIGIN),
        ({"stale_frames": 1, "clock_answers": 499}, ReasonCode.WAITING_FOR_TIMESYNC),
        ({"stale_frames": 1, "clock_answers": 500}, None),
        ({"stale_frames": 0, "clock_answers": 0}, None),
        ({"prearm_good": False, "warning": "Battery low"}, ReasonCode.PREARM_FAILED),
    ],
)
def test_what_is_missing_is_named(changes: dict[str, Any], code: ReasonCode | None) -> None:
    found = missing(changes)
    assert (found and found.code) is code


def test_what_is_missing_has_its_figures() -> None:
    for changes, expected in (
        ({"time_known": False}, Reason(ReasonCode.CLOCKS_NOT_SYNCHRONISED)),
        ({"version": (1, 15, 3)}, Reason(ReasonCode.FIRMWARE_TOO_OLD, ("PX4", "1.15.3", "1.15.4"))),
        ({"version": (1, 18, 0)}, Reason(ReasonCode.FIRMWARE_TOO_NEW, ("PX4", "1.18.0", "1.18.0"))),
        ({"stale_frames": 1, "clock_answers": 499}, Reason(ReasonCode.WAITING_FOR_TIMESYNC, (499, 500))),
        ({"prearm_good": False, "warning": "Battery low"}, Reason(ReasonCode.PREARM_FAILED, (), autopilot_text("Battery low"))),
    ):
        assert missing(changes) == expected


def drive(
    arming: Px4ArmingSequence, telemetry: Telemetry, until_s: float, start_s: float = 0.0
) -> tuple[list[tuple[float, int]], ArmingOutcome]:
    """Step at 100 Hz under telemetry that never changes, with a heartbeat every 0.2 s."""
    asked, outcome, tick = [], ArmingOutcome.PENDING, round(start_s * 100)
    while tick < until_s * 100 and outcome is ArmingOutcome.PENDING:
        now = tick / 100
        outcome, command = arming.step(now, changed(telemetry, heartbeat_s=math.floor(now * 5) / 5))
        if command is not None:
            assert command[1][1:2] != (21196.0,), "never forced"
            asked.append((now, command[0]))
        tick += 1
    return asked, outcome


def test_a_mode_that_never_shows_is_asked_for_three_times() -> None:
    arming = Px4ArmingSequence(0.0)
    asked, outcome = drive(arming, changed(READY, warning="no RC"), 20.0)
    assert [command for _, command in asked] == [DO_SET_MODE] * 3
    assert asked[0][0] >= 1.0
    assert outcome is ArmingOutcome.GIVEN_UP
    assert arming.reason == given_up(Reason(ReasonCode.MODE_UNCHANGED, ("AUTO.LOITER",)), *autopilot_text("no RC"))


def test_motors_that_stay_off_are_asked_three_times_five_seconds_apart() -> None:
    arming = Px4ArmingSequence(0.0)
    asked, outcome = drive(arming, changed(READY, custom_mode=OFFBOARD, warning="Arming denied: compass"), 30.0)
    arms = [at for at, command in asked if command == ARM_DISARM]
    assert len(arms) == 3
    assert [b - a for a, b in itertools.pairwise(arms)] == pytest.approx([5.0, 5.0], abs=0.02)
    assert outcome is ArmingOutcome.GIVEN_UP
    assert arming.reason == given_up(Reason(ReasonCode.MOTORS_STAY_OFF), *autopilot_text("Arming denied: compass"))


def test_offboard_left_over_from_before_is_no_proof() -> None:
    """The mode is asked for even if an old heartbeat shows it already."""
    asked, _ = drive(Px4ArmingSequence(0.0), changed(READY, custom_mode=OFFBOARD), 1.5)
    assert asked[0][1] == DO_SET_MODE


def test_a_mode_changed_before_arming_gives_up() -> None:
    arming = Px4ArmingSequence(0.0)
    drive(arming, changed(READY, custom_mode=OFFBOARD), 2.0)
    asked, outcome = drive(arming, changed(READY, custom_mode=POSCTL), 4.0, start_s=2.0)
    assert (asked, outcome) == ([], ArmingOutcome.GIVEN_UP)
    assert arming.reason == given_up(Reason(ReasonCode.MODE_CHANGED, ("POSCTL",)))


def test_armed_in_our_mode_is_the_end_of_it() -> None:
    _, outcome = drive(Px4ArmingSequence(0.0), changed(READY, custom_mode=OFFBOARD, armed=True), 5.0)
    assert outcome is ArmingOutcome.ARMED
