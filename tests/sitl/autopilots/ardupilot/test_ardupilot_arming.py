"""AUTOPILOTS.md: origin, arming, take-off and landing of the simulated ArduCopter."""

from __future__ import annotations

import pytest
from ardupilot_rig import ARM, FOLLOWING, GUIDED, LAND, STABILIZE, copter, flying, mode_of, ready, seconds_until

BOOT_TO_START_S = 12.5


def test_prearm_comes_about_25_s_after_boot() -> None:
    c = copter()
    assert c.run(3.0, lambda: c.last.get("EKF_STATUS_REPORT") is not None and c.flags == FOLLOWING)
    c.send_origin()
    took = seconds_until(c, lambda: "SYS_STATUS" in c.last and c.prearm, 20.0)
    assert BOOT_TO_START_S + c.now_s - 500.0 == pytest.approx(25.0, abs=0.5)
    assert took > 8.0
    assert c.last["GPS_GLOBAL_ORIGIN"].latitude == 473977000
    assert abs(c.last["HOME_POSITION"].z) < 0.1


def test_an_origin_before_the_estimator_follows_never_sets_a_home() -> None:
    c = copter()
    c.pose_on = False
    c.run(0.5)
    c.send_origin()
    c.run(0.2)
    assert "GPS_GLOBAL_ORIGIN" in c.last
    c.pose_on = True
    c.run(2.0)
    assert c.flags == FOLLOWING
    c.send_origin()  # only one origin is accepted per boot
    c.run(32.0)
    assert "HOME_POSITION" not in c.last
    assert not c.prearm
    assert "PreArm: Fence requires position" in c.texts


def test_a_second_origin_is_not_accepted() -> None:
    c = ready()
    c.send(type(c.last["GPS_GLOBAL_ORIGIN"])(1, 2, 3))  # a GPS_GLOBAL_ORIGIN message, which is no command
    before = c.last["GPS_GLOBAL_ORIGIN"].latitude
    c.send_origin()
    c.run(1.0)
    assert c.last["GPS_GLOBAL_ORIGIN"].latitude == before


def test_the_height_at_the_time_of_the_origin_stays_in_the_local_height() -> None:
    c = copter()
    c.pose_offset = (0.0, 0.0, -0.4)
    c.take_off(0.5)
    c.run(1.0)
    assert c.last["LOCAL_POSITION_NED"].z - c.ned[2] == pytest.approx(-0.4, abs=0.05)


def test_guided_needs_a_position() -> None:
    c = copter()
    c.pose_on = False
    c.run(1.0)
    assert c.set_mode(GUIDED) == 4
    assert "Mode change to GUIDED failed: requires position" in c.texts


def test_the_sequence_mode_arm_take_off_works() -> None:
    c = ready()
    assert c.set_mode(GUIDED) == 0
    assert c.arm() == 0
    assert c.climb(1.2) == 0
    assert 3.5 < seconds_until(c, lambda: c.ned[2] < -1.12, 8.0) < 6.0
    c.run(2.0)
    assert c.away_from(0.0, 0.0, -1.2) < 0.1


def test_take_off_needs_an_armed_vehicle_on_the_ground() -> None:
    c = ready()
    c.set_mode(GUIDED)
    assert c.climb(1.2) == 4
    c.arm()
    assert c.climb(1.2) == 0
    c.run(6.0)
    assert c.climb(2.0) == 4
    assert c.ask(ARM, 0) == 4
    assert c.armed


def test_take_off_needs_guided() -> None:
    c = ready()
    assert c.mode == STABILIZE
    assert c.arm() == 0
    assert c.climb(1.2) == 4


@pytest.mark.parametrize("stream", ["place", "speed", "both"])
def test_setpoints_on_the_ground_do_nothing(stream: str) -> None:
    c = ready(DISARM_DELAY=60)
    c.set_mode(GUIDED)
    c.arm()
    c.run(3.0)
    {"place": lambda: c.stay(0.0, 0.0, -1.0), "speed": lambda: c.move(0.0, 0.0, -0.5), "both": lambda: c.go_to(0.0, 0.0, -1.0)}[
        stream
    ]()
    c.run(4.0)
    assert c.vehicle.position[2] < 0.01


def test_setpoints_on_the_ground_end_a_take_off() -> None:
    """This is the reason why a companion must not stream before it flies."""
    c = ready(DISARM_DELAY=60)
    c.set_mode(GUIDED)
    c.arm()
    c.climb(1.2)
    c.go_to(0.0, 0.0, -1.2)
    c.run(8.0)
    assert c.vehicle.position[2] < 0.01


def test_land_disarms_automatically_and_the_mode_stays() -> None:
    c = flying()
    assert c.set_mode(LAND) == 0
    assert 2.4 < seconds_until(c, lambda: not c.armed, 15.0) < 6.0  # 1.2 m at LAND_SPD_MS, and the time to detect the landing
    assert c.vehicle.on_ground
    c.run(1.1)
    assert c.mode == LAND
    assert c.arm() == 4
    assert "Arm: LAND mode not armable" in c.texts


def test_it_can_fly_again_after_landing() -> None:
    c = flying()
    c.set_mode(LAND)
    assert c.run(15.0, lambda: not c.armed)
    assert c.set_mode(GUIDED) == 0
    assert c.arm() == 0
    assert c.climb(1.0) == 0
    assert c.run(12.0, lambda: c.away_from(0.0, 0.0, -1.0) < 0.08)


def test_an_armed_vehicle_on_the_ground_disarms_after_the_delay() -> None:
    c = ready()
    assert c.arm() == 0
    assert 4.0 < seconds_until(c, lambda: not c.copter.truth().armed, 8.0) < 5.5


def test_forced_disarming_in_flight_drops_the_vehicle() -> None:
    c = flying()
    assert c.ask(ARM, 0, 21196.0) == 0
    c.run(2.0)
    assert c.vehicle.on_ground
    assert c.vehicle.touchdowns[0] > 3.0


def test_a_low_battery_and_a_silent_transmitter_forbid_arming() -> None:
    c = ready()
    c.copter.set_battery(0.25)
    assert c.arm() == 4
    c.copter.set_battery(1.0)
    c.copter.transmitter(heard=False)
    c.run(1.0)
    assert c.arm() == 4
    assert "Arm: RC not found" in c.texts
    c.copter.transmitter(heard=True)
    assert c.arm() == 0


def test_return_and_missions_are_not_flown() -> None:
    c = flying()
    assert c.set_mode(6) == 4
    assert c.set_mode(3) == 4
    assert c.set_mode(77) == 4
    assert mode_of(c) == "GUIDED"
