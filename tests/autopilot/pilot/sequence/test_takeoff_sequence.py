"""A take-off: what is sent, what aborts it, and when another may begin."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from telemetry_values import changed

from uav_recon.autopilot.firmware.profile import ARM, ArmingOutcome, Command
from uav_recon.autopilot.mavlink.link_status import LinkStatus
from uav_recon.autopilot.mavlink.telemetry import Telemetry
from uav_recon.autopilot.pilot.sequence.takeoff_sequence import TakeoffSequence
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

MODE: Command = (176, (1.0, 6.0))
OFF = Reason(ReasonCode.MOTORS_STAY_OFF)
ASKED = Reason(ReasonCode.STOP_REQUESTED)
DUPLICATE = Reason(ReasonCode.TWO_AUTOPILOTS)
WITHDRAWN = Reason(ReasonCode.ARMING_WITHDRAWN)


class Bench:
    """A take-off whose firmware gives the answers of the test, one a step."""

    streams = True
    reason: Reason | None = None

    def __init__(self, *answers: tuple[ArmingOutcome, Command | None]) -> None:
        self._answers = list(answers)
        self.sent: list[int] = []
        self.armed_s: list[float] = []
        self.telemetry, self.status = Telemetry(), LinkStatus()
        self.firmware = SimpleNamespace(arming=lambda now_s: self)
        authority: Any = SimpleNamespace(asked_to_arm=self.armed_s.append)
        link: Any = self
        self.takeoff = TakeoffSequence(link, authority)

    def step(self, now_s: float, t: Telemetry) -> tuple[ArmingOutcome, Command | None]:
        return self._answers.pop(0)

    def command(self, now_s: float, command: int, *parameters: float) -> None:
        self.sent.append(command)

    def climb_to(self, height_m: float) -> None:
        self.telemetry = changed(self.telemetry, position_m=np.array([0.0, 0.0, height_m]))


def test_commands_are_sent_and_only_the_one_to_arm_makes_motors_ours() -> None:
    bench = Bench(
        (ArmingOutcome.PENDING, MODE), (ArmingOutcome.PENDING, None), (ArmingOutcome.PENDING, ARM), (ArmingOutcome.ARMED, None)
    )
    bench.takeoff.begin(0.0)
    outcomes = [bench.takeoff.arm(float(n), True, None) for n in range(4)]
    assert outcomes == [ArmingOutcome.PENDING] * 3 + [ArmingOutcome.ARMED]
    assert bench.sent == [MODE[0], ARM[0]]
    assert bench.armed_s == [2.0]


@pytest.mark.parametrize(
    ("wanted", "land_wanted", "duplicate", "why"),
    [
        (False, None, False, WITHDRAWN),
        (True, ASKED, False, ASKED),
        (True, None, True, DUPLICATE),
        (False, ASKED, True, ASKED),
        (False, None, True, DUPLICATE),
    ],
)
def test_it_is_aborted_without_another_command(wanted: bool, land_wanted: Reason | None, duplicate: bool, why: Reason) -> None:
    bench = Bench((ArmingOutcome.PENDING, ARM))
    bench.takeoff.begin(0.0)
    bench.status = dataclasses.replace(bench.status, duplicate_autopilot=duplicate)
    assert bench.takeoff.arm(0.0, wanted, land_wanted) is ArmingOutcome.GIVEN_UP
    assert bench.takeoff.abort_reason == why
    assert bench.sent == []


def test_the_firmwares_reason_is_kept() -> None:
    bench = Bench((ArmingOutcome.GIVEN_UP, None))
    bench.reason = OFF
    bench.takeoff.begin(0.0)
    assert bench.takeoff.arm(0.0, True, None) is ArmingOutcome.GIVEN_UP
    assert bench.takeoff.abort_reason == OFF


def test_a_climb_that_does_not_come_is_a_fault_until_the_next_takeoff() -> None:
    bench = Bench()
    bench.climb_to(2.0)
    bench.takeoff.begin(0.0)
    bench.takeoff.begin_climb(10.0)
    bench.climb_to(2.1)
    bench.takeoff.watch_climb(13.9)
    assert (bench.takeoff.climb_fault, bench.takeoff.lifted) == (None, False)
    bench.takeoff.watch_climb(14.1)
    slow = Reason(ReasonCode.CLIMB_TOO_SLOW, (0.1, 4.1))
    assert bench.takeoff.climb_fault == Reason(ReasonCode.TAKEOFF_GIVEN_UP, details=(slow,))
    bench.takeoff.begin(20.0)
    assert bench.takeoff.climb_fault is None


def test_it_has_lifted_two_decimetres_above_where_it_began() -> None:
    bench = Bench()
    lifted = [bench.takeoff.lifted]  # what never took off here may be anywhere
    bench.climb_to(-1.0)
    bench.takeoff.begin(0.0)
    for height_m in (-1.0, -0.81, -0.79, -1.0):
        bench.climb_to(height_m)
        bench.takeoff.watch_climb(1.0)
        lifted.append(bench.takeoff.lifted)
    assert lifted == [True, False, False, True, True]


def test_no_setpoint_streams_before_a_takeoff() -> None:
    bench = Bench()
    assert not bench.takeoff.streams
    bench.takeoff.begin(0.0)
    assert bench.takeoff.streams


def test_after_a_failure_the_mission_must_request_again() -> None:
    takeoff = Bench().takeoff
    allowed = [takeoff.allowed]
    for request in (takeoff.forbid, takeoff.withdraw):
        request()
        allowed.append(takeoff.allowed)
    assert allowed == [True, False, True]
