"""Each message replaces the values that it reports, and no other; an earlier telemetry value stays what it was."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from telemetry_values import changed

from uav_recon.autopilot.mavlink.messages import (
    Ack,
    Attitude,
    EstimatorStatus,
    Firmware,
    GimbalAttitude,
    Heartbeat,
    LandedState,
    LocalPosition,
    Message,
    OriginSet,
    ParameterValue,
    StatusText,
    SystemStatus,
    TimesyncMessage,
)
from uav_recon.autopilot.mavlink.telemetry import ArmingReadiness, BatteryReport, ModeReport, Telemetry, rebooted, updated

PLACE, SPEED, TURN = np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3]), np.array([0.0, 1.0, 0.0, 0.0])
VALUE, OTHER = ParameterValue("A", 1.0, 9), ParameterValue("B", 2.0, 9)
KNOWN = changed(
    Telemetry(system=1, on_ground_s=1.0, warning="before"),
    heartbeat_s=1.0,
    armed=True,
    prearm_good=True,
    parameters={"A": VALUE},
)


@pytest.mark.parametrize(
    ("message", "reported"),
    [
        (Heartbeat(2, 12, False, 7), {"mode": ModeReport(5.0, 12, False, 7)}),
        (EstimatorStatus(True), {"readiness": ArmingReadiness(estimator_good=True, prearm_good=True)}),
        (OriginSet(), {"readiness": ArmingReadiness(prearm_good=True, origin_known=True)}),
        (SystemStatus(False, 0.4), {"readiness": ArmingReadiness(), "battery": BatteryReport(0.4, 5.0)}),
        (LandedState(True), {"on_ground_s": 5.0}),
        (LandedState(False), {"on_ground_s": -math.inf}),
        (Firmware((1, 17, 0), "a0"), {"version": (1, 17, 0)}),
        (StatusText(4, "no RC"), {"warning": "no RC"}),
        (GimbalAttitude(0.2), {"camera_pitch_down_rad": 0.2, "camera_pitch_s": 5.0}),
        (OTHER, {"parameters": {"A": VALUE, "B": OTHER}}),
    ],
)
def test_a_message_replaces_what_it_reports(message: Message, reported: dict[str, Any]) -> None:
    new = updated(KNOWN, message, 5.0)
    expected = dataclasses.replace(KNOWN, **reported)
    assert repr(new) == repr(expected)
    assert repr(new) != repr(KNOWN)


def test_position_and_attitude_replace_each_their_part_of_the_estimate() -> None:
    first = updated(KNOWN, LocalPosition(7, PLACE, SPEED), 5.0)
    both = updated(first, Attitude(TURN), 5.0).estimate
    assert both.position_m is PLACE
    assert both.velocity_mps is SPEED
    assert both.quat_wxyz is TURN
    assert first.estimate.quat_wxyz.tolist() == [1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("message", [Ack(400, 2), TimesyncMessage(0, 1), StatusText(5, "a notice")])
def test_a_message_that_reports_no_state_replaces_nothing(message: Message) -> None:
    assert updated(KNOWN, message, 5.0) is KNOWN


def test_a_reboot_makes_readiness_and_parameters_unknown() -> None:
    after = rebooted(KNOWN)
    assert repr(after) == repr(dataclasses.replace(KNOWN, readiness=ArmingReadiness(), parameters={}))
    assert KNOWN.parameters == {"A": VALUE}


def test_no_reader_can_change_telemetry() -> None:
    for value, name in ((KNOWN, "system"), (KNOWN.mode, "armed"), (KNOWN.estimate, "position_m")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(value, name, None)
    assert not KNOWN.estimate.position_m.flags.writeable
