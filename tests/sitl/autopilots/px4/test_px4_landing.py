"""AUTOPILOTS.md: landing and disarming of the simulated PX4."""

from __future__ import annotations

import math

import pytest
from px4_rig import ARM, FORCE, companion, flying, seconds_until, truth_mode
from pymavlink.dialects.v20 import common as mavlink
from scripted_companion import LAND, LOITER, OFFBOARD

from sitl.autopilots.land_detector import LandDetector


def test_disarming_in_flight_is_refused() -> None:
    c = flying()
    assert c.ask(ARM, 0) == 1
    assert c.armed
    assert any("Disarming denied" in text for text in c.texts)


def test_forced_disarming_in_flight_drops_the_vehicle() -> None:
    c = flying()
    assert c.ask(ARM, 0, FORCE) == 0
    c.run(2.0)
    assert c.vehicle.on_ground
    assert c.vehicle.touchdowns[0] > 3.0


def test_land_descends_disarms_automatically_and_the_mode_reverts() -> None:
    c = flying()
    c.go_to(0.0, 0.0, -1.2)
    assert c.set_mode(LAND) == 0
    c.run(1.1)
    assert c.mode == LAND
    assert c.last["EXTENDED_SYS_STATE"].landed_state == mavlink.MAV_LANDED_STATE_LANDING
    took = seconds_until(c, lambda: not c.armed, 15.0)
    assert 3.0 < took < 9.0
    c.run(1.1)
    assert c.mode == OFFBOARD
    assert c.last["EXTENDED_SYS_STATE"].landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND


@pytest.mark.parametrize("level_known", [False, True])
def test_an_unknown_speed_does_not_prevent_the_landing_detection(level_known: bool) -> None:
    """On the floor, an estimate without poses drifts away."""
    detector = LandDetector(0.6)
    detector.lifted()
    landed = [detector.touched_down(0.02, (0.0, 0.0, 0.0), (15.0, 0.0, 0.0), level_known) for _ in range(50)]
    assert any(landed) is not level_known


@pytest.mark.parametrize("speed", [0.5, 0.9])
@pytest.mark.parametrize("seed", range(2))
def test_a_landing_in_motion_brakes_gently_to_a_point_ahead(speed: float, seed: int) -> None:
    """Navigator::preproject_stop_point(): v^2 / 2 a and 0.6 s.

    The trajectory to that point keeps MPC_ACC_HOR.
    """
    c = flying(seed)
    start = c.now_s
    c.setpoint = lambda t: (speed * (t - start), 0.0, -1.2, speed, *[0.0] * 5, 0.3, 0.0)
    c.run(4.0)
    assert c.set_mode(LAND) == 0
    begun, entered = c.ned, math.hypot(*c.vehicle.velocity[:2])
    strongest, before = 0.0, entered
    for _ in range(150):
        c.run(0.02)
        now = math.hypot(*c.vehicle.velocity[:2])
        strongest, before = max(strongest, (before - now) / 0.02), now
    way = math.hypot(c.ned[0] - begun[0], c.ned[1] - begun[1])
    assert way == pytest.approx(entered**2 / 4.0 + 0.6 * entered, rel=0.2)
    assert 0.3 < strongest < 2.3


def test_it_can_fly_again_after_landing() -> None:
    c = flying()
    c.set_mode(LAND)
    assert c.run(15.0, lambda: not c.armed)
    c.go_to(0.0, 0.0, -1.0)
    c.run(1.5)
    c.set_mode(OFFBOARD)
    c.run(1.1)
    assert c.arm() == 0
    assert c.run(12.0, lambda: c.away_from(0.0, 0.0, -1.0) < 0.06)


def test_takeoff_mode_climbs_to_its_height_and_holds() -> None:
    c = companion()
    c.ready()
    assert c.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 2) == 0
    assert c.arm() == 0
    assert c.run(12.0, lambda: truth_mode(c) == "LOITER")
    c.run(2.0)
    assert c.away_from(0.0, 0.0, -1.2) < 0.12


def test_hold_needs_an_origin_in_flight() -> None:
    c = companion()
    assert c.run(5.0, lambda: "ESTIMATOR_STATUS" in c.last and bool(c.flags & 8))
    c.go_to(0.0, 0.0, -1.0, 1.27)
    c.run(1.2)
    c.set_mode(OFFBOARD)
    c.run(1.1)
    assert c.arm() == 0
    c.run(8.0)
    assert c.set_mode(LOITER) == 1
    assert truth_mode(c) == "OFFBOARD"


def test_return_is_not_flown() -> None:
    c = flying()
    assert c.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 5) == 1
    assert truth_mode(c) == "OFFBOARD"
