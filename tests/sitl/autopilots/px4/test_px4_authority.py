"""AUTOPILOTS.md: pilot, battery, transmitter and fence of the simulated PX4."""

from __future__ import annotations

import math

from px4_rig import companion, flying, seconds_until, truth_mode
from scripted_companion import OFFBOARD, POSCTL


def test_a_pilot_takes_over_and_setpoints_no_longer_move_it() -> None:
    c = flying()
    c.px4.pilot_takes_over("POSCTL")
    c.run(1.1)
    assert c.mode == POSCTL
    place = c.ned
    c.go_to(2.0, 0.0, -1.2)
    c.run(3.0)
    assert math.dist(c.ned, place) < 0.3
    assert c.px4.failsafes == []


def test_a_critical_battery_lands() -> None:
    c = flying()
    c.px4.set_battery(0.19)
    c.run(0.2)
    assert truth_mode(c) == "LAND"
    assert c.px4.failsafes == ["battery critical: LAND"]


def test_the_battery_drains_while_flying() -> None:
    c = flying()
    before = c.px4._state.battery.fraction
    c.run(10.0)
    assert 0.005 < before - c.px4._state.battery.fraction < 0.02
    assert 0 < c.last["BATTERY_STATUS"].battery_remaining <= 100
    assert c.last["BATTERY_STATUS"].voltages[0] > 3500


def test_a_silent_transmitter_leads_to_a_landing() -> None:
    c = flying()
    c.px4.transmitter(heard=False)
    assert 1.3 < seconds_until(c, lambda: truth_mode(c) == "LAND", 4.0) < 1.8


def test_the_fence_holds_then_lands() -> None:
    c = flying(GF_MAX_HOR_DIST=2.0, COM_FAIL_ACT_T=5.0)
    c.go_to(6.0, 0.0, -1.2)
    assert c.run(10.0, lambda: truth_mode(c) == "LOITER")
    assert 4.8 < seconds_until(c, lambda: truth_mode(c) == "LAND", 8.0) < 5.3
    assert c.ned[0] < 3.2


def test_without_an_origin_there_is_no_fence_at_all() -> None:
    c = companion(GF_MAX_HOR_DIST=2.0)
    c.run(2.0)
    c.go_to(0.0, 0.0, -1.2, 1.27)
    c.run(1.2)
    c.set_mode(OFFBOARD)
    c.run(1.1)
    assert c.arm() == 0
    c.run(8.0)
    c.go_to(5.0, 0.0, -1.2)
    assert c.run(10.0, lambda: c.ned[0] > 4.5)
    assert c.px4.failsafes == []


LOST, BACK = "Connection to mission computer lost", "Connection to mission computer regained"


def test_missing_heartbeats_only_give_one_warning() -> None:
    c = flying()
    c.heartbeats = False  # setpoints and poses continue
    assert 3.9 < seconds_until(c, lambda: LOST in c.texts, 6.0) < 5.1  # the last heartbeat was up to a second before
    c.run(10.0)
    assert truth_mode(c) == "OFFBOARD"
    assert c.px4.failsafes == []
    assert c.texts.count(LOST) == 1
    c.heartbeats = True
    c.run(1.1)
    assert BACK in c.texts


def test_steady_heartbeats_give_no_warning() -> None:
    c = flying()
    c.run(10.0)
    assert not {LOST, BACK} & set(c.texts)
