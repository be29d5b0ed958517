"""AUTOPILOTS.md: the simulated ArduCopter and poses that stop, jump or have odd stamps."""

from __future__ import annotations

import math

import pytest
from ardupilot_rig import BLIND, FOLLOWING, GUIDED, copter, flying, mode_of, seconds_until
from pymavlink.dialects.v20 import common as mavlink


def test_when_poses_stop_the_flags_fall_after_7_s_and_it_lands_after_8_s() -> None:
    c = flying()
    place = c.ned
    c.pose_on = False
    begin = c.now_s
    assert 7.0 < seconds_until(c, lambda: c.flags == BLIND, 9.0) < 7.5
    assert c.run(3.0, lambda: mode_of(c) == "LAND")
    assert c.now_s - begin == pytest.approx(8.0, abs=0.2)
    assert math.dist(c.ned[:2], place[:2]) < 2.0
    assert c.copter.failsafes == ["EKF Failsafe: LAND"]
    assert c.run(20.0, lambda: not c.armed)
    assert math.dist(c.ned[:2], place[:2]) < 5.0
    assert c.vehicle.touchdowns[0] < 1.0


def test_gaps_up_to_two_seconds_have_no_effect() -> None:
    c = flying()
    for _ in range(3):
        c.pose_on = False
        c.run(2.0)
        c.pose_on = True
        c.run(1.0)
        assert c.flags == FOLLOWING
    assert mode_of(c) == "GUIDED"
    assert c.texts == ["Arming motors"]


def test_returning_poses_do_not_stop_the_landing() -> None:
    c = flying()
    c.pose_on = False
    assert c.run(9.0, lambda: mode_of(c) == "LAND")
    c.pose_on = True
    c.run(1.5)
    assert mode_of(c) == "LAND"


def test_without_a_position_guided_is_refused() -> None:
    c = flying()
    c.pose_on = False
    assert c.run(9.0, lambda: mode_of(c) == "LAND")
    assert c.set_mode(GUIDED) == 4


def test_a_pose_jump_with_its_reset_counter_moves_the_vehicle_back_by_the_jump() -> None:
    c = flying()
    c.go_to(0.0, 0.0, -1.2, 1.27)
    c.run(0.5)
    c.pose_offset = (0.6, 0.0, 0.0)
    c.reset_counter = 1
    c.run(0.1)
    assert c.last["LOCAL_POSITION_NED"].x == pytest.approx(c.ned[0] + 0.6, abs=0.1)
    c.run(4.0)
    assert c.ned[0] == pytest.approx(-0.6, abs=0.1)


def test_setpoints_shifted_in_the_same_tick_keep_the_vehicle_still() -> None:
    c = flying()
    c.go_to(0.0, 0.0, -1.2, 1.27)
    c.run(0.5)
    c.pose_offset = (0.6, 0.0, 0.0)
    c.reset_counter = 1
    c.go_to(0.6, 0.0, -1.2, 1.27)
    worst = 0.0
    for _ in range(40):
        c.run(0.1)
        worst = max(worst, abs(c.ned[0]))
    assert worst < 0.15


def test_a_held_position_shifts_with_a_reset_of_the_estimate() -> None:
    c = flying()
    c.copter.pilot_takes_over("LOITER")
    c.run(1.0)
    place = c.ned
    c.pose_offset = (0.6, 0.0, 0.0)
    c.reset_counter = 1
    c.run(3.0)
    assert math.dist(c.ned, place) < 0.15


def test_a_pose_jump_without_a_reset_counter_is_refused_silently() -> None:
    c = flying()
    c.go_to(0.0, 0.0, -1.2, 1.27)
    c.run(0.5)
    texts = len(c.texts)
    c.pose_offset = (2.0, 0.0, 0.0)
    c.run(3.0)
    assert abs(c.ned[0]) < 0.5
    assert c.flags == FOLLOWING
    assert c.last["EKF_STATUS_REPORT"].pos_horiz_variance >= 1.0
    assert len(c.texts) == texts


def test_only_poses_of_the_body_in_the_local_frame_are_accepted() -> None:
    for frame, child, taken in (
        (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD, True),
        (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD, False),
        (mavlink.MAV_FRAME_LOCAL_FLU, mavlink.MAV_FRAME_BODY_FRD, False),
        (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_LOCAL_FRD, False),
    ):
        c = copter()
        c.pose_frame = (frame, child)
        c.run(2.0)
        assert c.copter.estimator.started is taken
        assert c.texts == []


@pytest.mark.parametrize(("quality_min", "taken"), [(0, True), (20, False)])
def test_vision_position_estimate_carries_no_quality(quality_min: int, taken: bool) -> None:
    c = copter(VISO_QUAL_MIN=quality_min)
    c.pose_on = False
    for i in range(200):
        stamp_us = round((c.now_s + 1000.0) * 1e6) + i
        c.send(mavlink.MAVLink_vision_position_estimate_message(stamp_us, 0.0, 0.0, 0.0, 0.0, 0.0, 1.27, [1e-4] * 21, 0))
        c.run(0.02)
    assert c.copter.estimator.started is taken


@pytest.mark.parametrize("quality", [5, 19])
def test_poses_of_low_quality_are_not_fused(quality: int) -> None:
    c = copter()
    c.pose_quality = quality
    c.run(2.0)
    assert not c.copter.estimator.started


def test_poses_are_not_fused_unless_the_parameters_enable_it() -> None:
    c = copter(VISO_TYPE=0)
    c.run(2.0)
    assert c.flags == 0xA5


def test_stamps_of_any_clock_are_aligned_by_their_least_lag() -> None:
    c = copter()
    c.stamp_shift_s = -700.0
    c.take_off()
    assert c.flags == FOLLOWING


def test_timesync_is_answered_on_its_own_clock() -> None:
    c = copter()
    c.run(1.0)
    c.keep = {"TIMESYNC"}
    c.send(mavlink.MAVLink_timesync_message(0, 123456789))
    c.run(0.05)
    answer = next(m for m in c.messages if m.tc1 != 0)
    assert answer.ts1 == 123456789
    assert answer.tc1 * 1e-9 == pytest.approx(12.5 + 1.0, abs=0.02)
