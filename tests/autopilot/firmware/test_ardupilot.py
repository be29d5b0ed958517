"""ArduCopter's rules on constructed telemetry: what is missing, and how it is brought into the air."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from telemetry_values import changed

from uav_recon.autopilot.firmware import ardupilot
from uav_recon.autopilot.firmware.ardupilot import CLIMB_M, TAKE_OFF, ArduPilotArmingSequence
from uav_recon.autopilot.firmware.profile import ARM_DISARM, DO_SET_MODE, ArmingOutcome
from uav_recon.autopilot.mavlink.link_status import LinkStatus
from uav_recon.autopilot.mavlink.telemetry import ArmingReadiness, ModeReport, Telemetry
from uav_recon.types.reason import Reason, autopilot_text
from uav_recon.types.reason_code import ReasonCode

STABILIZE, GUIDED, LOITER, RTL, LAND, BRAKE = 0, 4, 5, 6, 9, 17


READY = Telemetry(
    system=1,
    received_s=10.0,
    mode=ModeReport(heartbeat_s=10.0, firmware_family=3),
    readiness=ArmingReadiness(estimator_good=True, prearm_good=True, origin_known=True),
    version=(4, 8, 0),
)


def test_modes() -> None:
    modes = (STABILIZE, GUIDED, LOITER, RTL, LAND, BRAKE)
    assert [ardupilot.mode_name(m) for m in (*modes, 99)] == [
        "STABILIZE", "GUIDED", "LOITER", "RTL", "LAND", "BRAKE", "MODE99",
    ]  # fmt: skip
    assert [m for m in modes if ardupilot.is_ours(m)] == [GUIDED]
    assert [m for m in modes if ardupilot.is_landing(m)] == [LAND]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({}, None),
        ({"heartbeat_s": 6.9}, ReasonCode.NO_HEARTBEAT),
        ({"firmware_family": 12}, ReasonCode.WRONG_FIRMWARE),
        ({"version": (4, 5, 1)}, ReasonCode.FIRMWARE_TOO_OLD),
        ({"estimator_good": False}, ReasonCode.ESTIMATOR_NOT_FOLLOWING),
        ({"origin_known": False}, ReasonCode.NO_ORIGIN),
        ({"prearm_good": False, "warning": "PreArm: Fence requires position"}, ReasonCode.PREARM_FAILED),
    ],
)
def test_what_is_missing_is_named(changes: dict[str, Any], code: ReasonCode | None) -> None:
    missing = ardupilot.missing_for_arming(changed(READY, **changes), LinkStatus(time_known=True, pose_fed_s=10.0), 10.0)
    assert missing is None or missing.details == autopilot_text(changes.get("warning", ""))
    assert (missing and missing.code) is code


def test_it_is_not_ready_before_a_pose_was_fed() -> None:
    assert ardupilot.missing_for_arming(READY, LinkStatus(time_known=True), 10.0) == Reason(ReasonCode.NO_POSE_FED)


class Bench:
    """Steps a take-off at 100 Hz under telemetry that the test sets."""

    def __init__(self, **telemetry: Any) -> None:
        self.t = changed(READY, **telemetry)
        self.take_off = ArduPilotArmingSequence(0.0)
        self.tick = 0
        self.asked: list[tuple[float, int]] = []
        self.outcome = ArmingOutcome.PENDING

    def tell(self, **changes: Any) -> None:
        """Change the telemetry."""
        self.t = changed(self.t, **changes)

    def run(self, until_s: float) -> None:
        while self.tick < until_s * 100 and self.outcome is ArmingOutcome.PENDING:
            now = self.tick / 100
            self.tell(heartbeat_s=math.floor(now * 5) / 5)
            self.outcome, command = self.take_off.step(now, self.t)
            if command is not None:
                self.asked.append((now, command[0]))
            self.tick += 1


def test_no_setpoint_may_run_before_it_flies() -> None:
    assert not ArduPilotArmingSequence(0.0).streams


def test_mode_then_motors_then_one_climb() -> None:
    b = Bench(custom_mode=STABILIZE)
    b.run(1.0)
    b.tell(custom_mode=GUIDED)
    b.run(2.0)
    b.tell(armed=True)
    b.run(5.0)
    assert [command for _, command in b.asked] == [DO_SET_MODE, ARM_DISARM, TAKE_OFF]
    b.tell(position_m=np.array([0.0, 0.0, CLIMB_M - 0.05]))
    b.run(6.0)
    assert b.outcome is ArmingOutcome.ARMED


def test_an_old_heartbeat_is_no_proof_of_the_mode() -> None:
    b = Bench(custom_mode=GUIDED)
    b.run(0.1)
    assert [command for _, command in b.asked] == [DO_SET_MODE]


def test_a_climb_that_does_not_come_is_given_up_and_not_asked_for_again() -> None:
    b = Bench(custom_mode=GUIDED, armed=True)
    b.run(20.0)
    assert [command for _, command in b.asked] == [DO_SET_MODE, TAKE_OFF]
    assert b.outcome is ArmingOutcome.GIVEN_UP
    slow = Reason(ReasonCode.CLIMB_TOO_SLOW, (0.0, 5.0))
    assert b.take_off.reason == Reason(ReasonCode.TAKEOFF_GIVEN_UP, details=(slow,))


def test_a_mode_changed_in_the_climb_gives_up() -> None:
    b = Bench(custom_mode=GUIDED, armed=True)
    b.run(2.0)
    b.tell(custom_mode=LOITER)
    b.run(3.0)
    assert b.outcome is ArmingOutcome.GIVEN_UP
    changed = Reason(ReasonCode.MODE_CHANGED, ("LOITER",))
    assert b.take_off.reason == Reason(ReasonCode.TAKEOFF_GIVEN_UP, details=(changed,))


def test_motors_that_stop_before_it_flew_give_up() -> None:
    b = Bench(custom_mode=GUIDED, armed=True)
    b.run(2.0)
    b.tell(armed=False)
    b.run(3.0)
    assert b.outcome is ArmingOutcome.GIVEN_UP


def test_motors_that_stay_off_are_asked_three_times() -> None:
    b = Bench(custom_mode=GUIDED, warning="Arm: RC not found")
    b.run(30.0)
    assert [command for _, command in b.asked] == [DO_SET_MODE] + [ARM_DISARM] * 3
    off = Reason(ReasonCode.MOTORS_STAY_OFF)
    assert b.take_off.reason == Reason(ReasonCode.ARMING_GIVEN_UP, details=(off, *autopilot_text("Arm: RC not found")))
