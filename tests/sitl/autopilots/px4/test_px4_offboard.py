"""AUTOPILOTS.md: the OFFBOARD rules of the simulated PX4."""

from __future__ import annotations

import math

import pytest
from px4_rig import companion, flying, seconds_until, truth_mode
from pymavlink.dialects.v20 import common as mavlink
from scripted_companion import LOITER, OFFBOARD


def test_offboard_may_be_acknowledged_early_and_engages_with_the_setpoints() -> None:
    c = companion()
    c.ready()
    assert c.set_mode(OFFBOARD) == 0
    c.run(3.0)
    assert c.mode == LOITER
    c.go_to(0.0, 0.0, 0.0)
    c.run(0.8)
    assert truth_mode(c) == "LOITER"
    c.run(0.5)
    assert truth_mode(c) == "OFFBOARD"


def test_do_set_mode_is_often_acknowledged_twice() -> None:
    c = companion()
    c.ready()
    counts = set()
    for _ in range(12):
        c.acks.clear()
        c.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 3)
        c.run(0.1)
        counts.add(len(c.acks))
    assert counts == {1, 2}


def test_a_setpoint_without_a_controlled_axis_does_not_count() -> None:
    c = companion()
    c.ready()
    c.go_to(0.0, 0.0, -1.0)
    c.type_mask = 0b111111111
    c.run(2.0)
    c.set_mode(OFFBOARD)
    c.run(1.5)
    assert truth_mode(c) == "LOITER"


def test_setpoints_in_other_frames_are_refused_with_a_message() -> None:
    c = companion()
    c.run(0.5)
    c.send(mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, mavlink.MAV_FRAME_LOCAL_ENU, 0, *[0.0] * 11))
    c.run(0.1)
    assert any("frame not supported" in text for text in c.texts)


def test_masked_fields_are_ignored() -> None:
    c = flying()
    c.setpoint = lambda _t: (99.0, 99.0, 99.0, 0.3, 0.0, 0.0, 9.0, 9.0, 9.0, 1.0, 0.0)
    c.type_mask = 0b110111000111  # velocity only
    c.run(3.0)
    assert c.last["LOCAL_POSITION_NED"].vx == pytest.approx(0.3, abs=0.1)
    assert abs(c.ned[2] + 1.2) < 0.3


def test_a_far_setpoint_is_flown_at_the_parameters_speed() -> None:
    c = flying()
    c.go_to(20.0, 0.0, -1.2)
    fastest = 0.0
    for _ in range(400):
        c.run(0.01)
        fastest = max(fastest, math.hypot(*c.vehicle.velocity[:2]))
    assert 1.0 < fastest < 1.3


@pytest.mark.parametrize("seed", range(1, 6))
def test_when_setpoints_stop_it_lands_within_1_3_s(seed: int) -> None:
    c = flying(seed)
    c.setpoint = None
    took = seconds_until(c, lambda: truth_mode(c) == "LAND", 3.0)
    assert 0.55 < took < 1.4
    assert c.px4.failsafes == ["offboard signal lost: LAND"]
    c.go_to(1.0, 1.0, -1.2)  # the stream is back, but the landing continues
    c.run(2.0)
    assert truth_mode(c) == "LAND"
    assert c.run(15.0, lambda: not c.armed)
    assert c.vehicle.on_ground


def test_by_default_px4_stays_in_position_mode() -> None:
    c = flying(COM_OBL_RC_ACT=0)
    c.setpoint = None
    c.run(5.0)
    assert truth_mode(c) == "POSCTL"
    assert c.vehicle.position[2] > 1.0


def test_gaps_shorter_than_the_timeout_have_no_effect() -> None:
    c = flying()
    for _ in range(5):
        c.setpoint = None
        c.run(0.4)
        c.go_to(0.0, 0.0, -1.2)
        c.run(0.3)
    assert truth_mode(c) == "OFFBOARD"
    assert c.px4.failsafes == []


def test_offboard_is_granted_again_after_a_failsafe() -> None:
    """A companion must never request OFFBOARD again by itself, because the autopilot would obey."""
    c = flying()
    c.setpoint = None
    c.run(1.5)
    c.go_to(0.0, 0.0, -1.2)
    c.run(1.1)
    assert c.set_mode(OFFBOARD) == 0
    c.run(0.2)
    assert truth_mode(c) == "OFFBOARD"


def test_setpoint_arrivals_are_recorded_while_armed_in_offboard() -> None:
    c = flying()
    count = len(c.px4.setpoint_arrivals_s)
    c.run(2.0)
    new = c.px4.setpoint_arrivals_s[count:]
    assert len(new) == pytest.approx(60, abs=2)
    assert all(500.0 < t <= c.now_s for t in new)


def test_in_offboard_a_push_is_countered_beyond_the_acceleration_limit() -> None:
    """MPC_ACC_HOR_MAX, 2 m/s^2, is less than the push.

    It limits only PX4's own trajectories.
    """
    c = flying()
    c.go_to(0.0, 0.0, -1.2)
    c.run(1.0)
    c.vehicle.external_acceleration_mps2 = (2.5, 0.0, 0.0)
    c.run(2.0)
    pushed = c.away_from(0.0, 0.0, -1.2)
    c.vehicle.external_acceleration_mps2 = (0.0, 0.0, 0.0)
    assert pushed < 1.3  # at most 2.5 / (P of position * P of velocity) = 1.46
    assert math.hypot(*c.vehicle.velocity[:2]) < 0.5
    c.run(12.0)
    assert c.away_from(0.0, 0.0, -1.2) < 0.1
