"""A take-off has to show within its time, and level; afterwards nobody asks any more."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.autopilot.firmware.takeoff_monitor import TakeoffMonitor
from uav_recon.autopilot.mavlink.telemetry import MotionEstimate, Telemetry
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


def at(height_m: float, tilt_deg: float = 0.0) -> Telemetry:
    half = math.radians(tilt_deg) / 2.0
    quat = np.array([math.cos(half), math.sin(half) * 0.6, math.sin(half) * 0.8, 0.0])
    return Telemetry(estimate=MotionEstimate(position_m=np.array([5.0, 6.0, height_m]), quat_wxyz=quat))


def begun(ground_m: float = 0.0) -> TakeoffMonitor:
    lift_off = TakeoffMonitor(ground_m)
    lift_off.begin(10.0)
    lift_off.begin(12.0)
    return lift_off


@pytest.mark.parametrize("ground_m", [0.0, -3.0])
def test_it_has_four_seconds_for_two_decimetres_from_the_first_word(ground_m: float) -> None:
    lift_off = begun(ground_m)
    assert lift_off.fault(13.99, at(ground_m + 0.19)) is None
    assert lift_off.fault(14.01, at(ground_m + 0.19)) == Reason(ReasonCode.CLIMB_TOO_SLOW, (0.19, 4.0))
    assert not lift_off.lifted


def test_once_up_it_is_asked_no_more() -> None:
    lift_off = begun()
    assert lift_off.fault(12.0, at(0.21)) is None
    assert lift_off.lifted
    assert lift_off.fault(99.0, at(0.0, tilt_deg=40.0)) is None


@pytest.mark.parametrize(("tilt_deg", "fit"), [(14.9, True), (15.1, False), (170.0, False)])
def test_it_is_level_until_then(tilt_deg: float, fit: bool) -> None:
    assert (begun().fault(10.1, at(0.05, tilt_deg)) is None) == fit


def test_before_it_is_told_to_climb_it_may_stand_for_ever() -> None:
    assert TakeoffMonitor(0.0).fault(1e6, at(0.0, tilt_deg=20.0)) is None
