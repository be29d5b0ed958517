"""When a landing is asked for: after a heartbeat of this instant, or a tenth of a second without one. When it is stuck."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from telemetry_values import changed

from uav_recon.autopilot.mavlink.telemetry import ModeReport, MotionEstimate, Telemetry
from uav_recon.autopilot.pilot.sequence.landing import Landing


def _link(heartbeat_s: float, asked_s: list[float], lands: bool = False) -> Any:
    telemetry = Telemetry(
        received_s=100.0,
        mode=ModeReport(heartbeat_s=heartbeat_s, armed=True),
        estimate=MotionEstimate(position_m=np.array([0.0, 0.0, 1.0])),
        on_ground_s=0.0,
    )
    firmware = SimpleNamespace(is_landing=lambda mode: lands, is_ours=lambda mode: True, land=(21, ()))
    return SimpleNamespace(telemetry=telemetry, firmware=firmware, command=lambda now_s, *order: asked_s.append(now_s))


@pytest.mark.parametrize(("age_s", "waits_s"), [(0.0, 0.0), (0.04, 0.0), (0.06, 0.1), (0.9, 0.1)])
def test_a_landing_waits_for_a_mode_that_is_current_but_not_for_long(age_s: float, waits_s: float) -> None:
    landing, asked_s = Landing(seen=False), list[float]()
    link = _link(100.0 - age_s, asked_s)
    for n in range(60):
        landing.step(link, 100.0 + 0.01 * n)
    assert asked_s == [pytest.approx(100.0 + waits_s, abs=0.011)]


def test_a_mode_from_before_a_silence_is_not_asked_away_however_long_it_waits() -> None:
    landing, asked_s = Landing(seen=False), list[float]()
    link = _link(100.0, asked_s)
    for n in range(300):
        now_s = 100.6 + 0.01 * n
        received_s = 100.0 if n < 50 else now_s  # it hears again, of all but the mode
        link.telemetry = changed(link.telemetry, received_s=received_s, heartbeat_s=100.0 if n < 200 else 102.6)
        landing.step(link, now_s)
    assert asked_s == [pytest.approx(102.6, abs=0.011)]


def _alert_s(height_m: Callable[[float], float], until_s: float) -> float:
    """When a landing is said not to end, whose height is this function of time; infinity for never."""
    landing, link = Landing(seen=True), _link(0.0, [], lands=True)
    for n in range(round(until_s / 0.01)):
        now_s = 0.01 * n
        link.telemetry = changed(link.telemetry, position_m=np.array([0.0, 0.0, height_m(now_s)]))
        landing.step(link, now_s)
        if landing.alert:
            return now_s
    return math.inf


@pytest.mark.parametrize("rest_m", [-0.012, -0.004, 0.0, 0.03])
@pytest.mark.parametrize("sinks_mps", [0.0, 0.005, -0.005])
def test_a_landing_at_rest_is_told_of_ten_seconds_later_wherever_its_estimate_wanders(rest_m: float, sinks_mps: float) -> None:
    """The last height on the way down was 0.047 m, and the estimate crept to 0.05 m below it 8 s later: that began again."""

    def height_m(now_s: float) -> float:
        return max(1.247 - 0.3 * now_s, rest_m) - sinks_mps * max(now_s - 4.0, 0.0) + 0.006 * math.sin(2.0 * now_s)

    assert 13.5 <= _alert_s(height_m, 30.0) <= 14.8


@pytest.mark.parametrize("sinks_mps", [0.1, 0.2, 0.3])
def test_a_landing_that_still_comes_down_is_not_stuck(sinks_mps: float) -> None:
    assert _alert_s(lambda now_s: 6.0 - sinks_mps * now_s, 30.0) == math.inf
