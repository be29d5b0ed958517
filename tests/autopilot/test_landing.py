"""When a landing is asked for: after a heartbeat of this instant, or a tenth of a second without one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uav_recon.autopilot.landing import Landing


def _link(heartbeat_s: float, asked_s: list[float]) -> Any:
    telemetry = SimpleNamespace(
        armed=True, on_ground_s=0.0, custom_mode=0, position_m=np.array([0.0, 0.0, 1.0]), heartbeat_s=heartbeat_s
    )
    firmware = SimpleNamespace(is_landing=lambda mode: False, is_ours=lambda mode: True, land=(21, ()))
    return SimpleNamespace(telemetry=telemetry, firmware=firmware, command=lambda now_s, *order: asked_s.append(now_s))


@pytest.mark.parametrize(("age_s", "waits_s"), [(0.0, 0.0), (0.04, 0.0), (0.06, 0.1), (0.9, 0.1)])
def test_a_landing_waits_for_a_mode_that_is_current_but_not_for_long(age_s: float, waits_s: float) -> None:
    landing, asked_s = Landing(seen=False), list[float]()
    link = _link(100.0 - age_s, asked_s)
    for n in range(60):
        landing.step(link, 100.0 + 0.01 * n)
    assert asked_s == [pytest.approx(100.0 + waits_s, abs=0.011)]
