"""AUTOPILOTS.md: pilot, companion, battery and transmitter of the simulated ArduCopter."""

from __future__ import annotations

import math
from typing import Any

import pytest
from ardupilot_rig import LAND, LOITER, Copilot, copter, flying, mode_of, seconds_until
from pymavlink.dialects.v20 import common as mavlink


def test_a_pilot_takes_over_and_setpoints_no_longer_move_it() -> None:
    c = flying()
    c.copter.pilot_takes_over()
    c.run(1.1)
    assert c.mode == LOITER
    place = c.ned
    c.go_to(2.0, 0.0, -1.2)
    c.run(3.0)
    assert math.dist(c.ned, place) < 0.3
    assert c.copter.failsafes == []


@pytest.mark.parametrize("timeout_s", [2.0, 3.0])
def test_a_silent_companion_leads_to_a_landing(timeout_s: float) -> None:
    c = flying(FS_GCS_TIMEOUT=timeout_s, SCR_ENABLE=0)
    c.run(1.0)
    c.heartbeats = False
    assert timeout_s - 1.05 < seconds_until(c, lambda: mode_of(c) == "LAND", 5.0) < timeout_s + 0.1
    assert c.copter.failsafes == ["GCS Failsafe: LAND"]
    assert c.run(15.0, lambda: not c.armed)


def test_only_a_failsafe_landing_hovers_for_four_seconds_first() -> None:
    """LAND_WITH_DELAY_MS, as in mode_land.cpp and in flights of the real firmware."""
    fallen = flying(SCR_ENABLE=0)
    fallen.heartbeats = False
    assert fallen.run(4.0, lambda: mode_of(fallen) == "LAND")
    height = fallen.vehicle.position[2]
    assert 4.0 < seconds_until(fallen, lambda: fallen.vehicle.position[2] < height - 0.1, 8.0) < 5.0
    asked = flying()
    assert asked.set_mode(LAND) == 0
    height = asked.vehicle.position[2]
    assert seconds_until(asked, lambda: asked.vehicle.position[2] < height - 0.1, 8.0) < 1.0


def test_the_script_on_the_card_lands_without_delay_when_the_companion_is_silent() -> None:
    """firmware_params/ardupilot_silence.lua acts in GUIDED only.

    The failsafe of the firmware remains active behind it.
    """
    c = flying()
    c.heartbeats = False
    height = c.vehicle.position[2]
    assert 0.45 < seconds_until(c, lambda: mode_of(c) == "LAND", 5.0) < 1.6  # the last heartbeat is up to a second old
    assert seconds_until(c, lambda: c.vehicle.position[2] < height - 0.1, 8.0) < 1.0
    assert c.copter.failsafes == ["Companion silent: LAND"]
    assert c.run(6.0, lambda: not c.armed)
    circling = flying()
    circling.copter.pilot_takes_over("LOITER")
    circling.heartbeats = False
    circling.run(1.9)
    assert circling.copter.failsafes == []


GCS, ONBOARD_CONTROLLER = 6, 18


def lands_beside(c: Copilot, system: int, component: int, kind: int) -> bool:
    """Send a heartbeat of another program; return True in LAND."""
    voice: Any = mavlink.MAVLink(None, system, component)
    c._pipe.write(mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3).pack(voice))
    return mode_of(c) == "LAND"


@pytest.mark.parametrize(
    "other",
    [(245, 190, GCS), (233, 190, ONBOARD_CONTROLLER), (233, 191, GCS)],
    ids=["MAVSDK", "other component", "ground station with the companion's ids"],
)
def test_the_script_does_not_take_another_program_for_the_companion(other: tuple[int, int, int]) -> None:
    c = flying()
    c.heartbeats = False
    assert seconds_until(c, lambda: lands_beside(c, *other), 5.0) < 1.6
    assert c.copter.failsafes == ["Companion silent: LAND"]


def test_without_the_script_another_program_hides_that_the_companion_is_dead() -> None:
    """FS_GCS_ENABLE asks for the system id only."""
    c = flying(SCR_ENABLE=0)
    c.heartbeats = False
    assert not c.run(6.0, lambda: lands_beside(c, 233, 190, GCS))
    c.run(2.5)
    assert c.copter.failsafes == ["GCS Failsafe: LAND"]


def test_a_companion_that_comes_back_does_not_stop_the_landing() -> None:
    c = flying()
    c.heartbeats = False
    assert c.run(4.0, lambda: mode_of(c) == "LAND")
    c.heartbeats = True
    c.run(2.0)
    assert mode_of(c) == "LAND"


@pytest.mark.parametrize("system", [1, 42])
def test_with_another_system_id_the_loss_of_the_companion_is_never_detected(system: int) -> None:
    """For the vehicle's own id, and for any id other than MAV_GCS_SYSID."""
    c = copter()
    c.heartbeats_as = system
    c.take_off()
    c.heartbeats = False
    c.run(10.0)
    assert mode_of(c) == "GUIDED"
    assert c.copter.failsafes == []


def test_with_the_vehicles_own_id_it_is_not_detected_even_if_the_parameter_names_it() -> None:
    c = copter(MAV_GCS_SYSID=1, SCR_ENABLE=0)
    c.heartbeats_as = 1
    c.take_off()
    c.heartbeats = False
    c.run(6.0)
    assert mode_of(c) == "GUIDED"


def test_a_mode_chosen_by_the_pilot_stays_when_the_companion_falls_silent() -> None:
    c = flying()
    c.copter.pilot_takes_over("ALT_HOLD")
    c.heartbeats = False
    c.run(6.0)
    assert mode_of(c) == "ALT_HOLD"


@pytest.mark.parametrize(("fraction", "cause"), [(0.19, "Battery is low"), (0.11, "Battery is low")])
def test_an_empty_battery_lands(fraction: float, cause: str) -> None:
    c = flying()
    c.copter.set_battery(fraction)
    c.run(0.2)
    assert mode_of(c) == "LAND"
    assert c.copter.failsafes == [f"{cause}: LAND"]


def test_a_silent_transmitter_leads_to_a_landing() -> None:
    c = flying()
    c.copter.transmitter(heard=False)
    assert 0.4 < seconds_until(c, lambda: mode_of(c) == "LAND", 4.0) < 1.0
    assert c.copter.failsafes == ["Radio Failsafe: LAND"]


def test_the_kill_switch_wins() -> None:
    c = flying()
    c.copter.pilot_disarms()
    c.run(2.0)
    assert c.vehicle.on_ground


@pytest.mark.parametrize("name", ["FS_THR_ENABLE", "FS_GCS_ENABLE", "FENCE_ACTION", "BATT_FS_LOW_ACT"])
def test_failsafes_that_return_home_are_not_simulated(name: str) -> None:
    """Return is a climb into the ceiling; a parameter file that requests it is refused."""
    with pytest.raises(ValueError, match=name):
        copter(**{name: 2 if name.startswith("BATT") else 1})


def test_a_breach_of_the_fence_ceiling_lands() -> None:
    c: Copilot = flying(FENCE_ALT_MAX=2.0)
    c.move(0.0, 0.0, -0.5)
    assert c.run(6.0, lambda: mode_of(c) == "LAND")
    assert -c.ned[2] < 2.3
