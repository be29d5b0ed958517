"""HAZARDS D7: a simulated autopilot that begins anew in the air knows nothing of before, and a pilot catches it."""

from __future__ import annotations

import math
from typing import Any

import ardupilot_rig
import px4_rig
import pytest


@pytest.mark.parametrize(("flying", "ready_s"), [(px4_rig.flying, 2.0), (ardupilot_rig.flying, 12.0)])
def test_poses_are_looked_at_anew_and_the_vehicle_stays_where_it_is(flying: Any, ready_s: float) -> None:
    c = flying()
    before, place = c.autopilot.estimator, c.vehicle.position
    c.autopilot.reboot()
    c.run(0.3)
    after = c.autopilot.estimator
    assert not after.horizontal_valid
    assert after is not before
    assert c.autopilot.boot_s == pytest.approx(c.now_s - 0.3, abs=0.02)
    c.setpoint = None
    c.run(ready_s)
    assert after.horizontal_valid, "by poses of its new clock, or of the arrival where it has not learned ours"
    assert math.hypot(after.position[0] - c.ned[0], after.position[1] - c.ned[1]) < 0.2
    assert math.dist(c.vehicle.position, place) < 0.5
    assert c.armed, "the motors ran on"
