"""Faults of vehicle and autopilot that the fault campaign relies on: HAZARDS D7, E7 and E9."""

from __future__ import annotations

import math
from typing import Any

import ardupilot_rig
import px4_rig
import pytest
from scripted_companion import LAND, OFFBOARD


@pytest.mark.parametrize(("flying", "ready_s"), [(px4_rig.flying, 2.0), (ardupilot_rig.flying, 12.0)])
def test_after_a_reboot_poses_are_fused_again_and_the_vehicle_stays_in_place(flying: Any, ready_s: float) -> None:
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


@pytest.mark.parametrize(("flying", "land"), [(px4_rig.flying, LAND), (ardupilot_rig.flying, ardupilot_rig.LAND)])
def test_a_failed_land_detector_leaves_the_motors_on(flying: Any, land: int) -> None:
    c = flying()
    c.autopilot.disable_land_detector()
    c.set_mode(land)
    c.run(12.0)
    assert c.vehicle.on_ground
    assert c.armed


@pytest.mark.parametrize("share", [1.0, 1.0 / 3.0])
def test_weak_rotors_do_not_lift_the_vehicle_and_affect_no_sensor(share: float) -> None:
    c = px4_rig.companion()
    c.ready()
    c.vehicle.set_thrust_ratio(share)
    c.go_to(0.0, 0.0, -1.0)
    c.run(1.5)
    assert c.set_mode(OFFBOARD) == 0
    assert c.arm() == 0
    c.run(4.5)
    assert c.vehicle.on_ground == (share < 1.0)
    assert abs(c.autopilot.estimator.position[2] + c.vehicle.position[2]) < 0.1
