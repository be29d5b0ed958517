"""AUTOPILOTS.md: the simulated PX4 and poses that stop, jump or have odd stamps."""

from __future__ import annotations

import math

import pytest
from px4_rig import companion, converged, flying, position_valid, seconds_until, truth_mode
from pymavlink.dialects.v20 import common as mavlink


@pytest.mark.parametrize(
    ("timeout_us", "earliest", "latest"), [(5_000_000, 5.2, 5.7), (3_000_000, 3.2, 3.7), (1_000_000, 1.2, 1.7)]
)
def test_when_poses_stop_the_autopilot_lands(timeout_us: int, earliest: float, latest: float) -> None:
    c = flying(EKF2_NOAID_TOUT=timeout_us)
    place = c.ned
    c.pose_on = False
    took = seconds_until(c, lambda: truth_mode(c) == "LAND", 8.0)
    assert earliest < took < latest
    assert c.px4.failsafes == ["position estimate lost: LAND"]
    assert math.hypot(c.ned[0] - place[0], c.ned[1] - place[1]) < 2.0
    assert c.run(20.0, lambda: not c.armed)
    assert c.vehicle.touchdowns[0] < 1.0


def test_returning_poses_do_not_stop_the_landing() -> None:
    c = flying()
    c.pose_on = False
    c.run(4.0)
    c.pose_on = True
    c.run(2.0)
    assert truth_mode(c) == "LAND"


@pytest.mark.parametrize("seed", range(1, 4))
def test_when_setpoints_and_poses_stop_in_motion_it_brakes_before_the_descent(seed: int) -> None:
    """The companion has died.

    With EKF2_NOAID_TOUT at 1 s it would not brake, because the position is lost before the landing begins.
    """
    c, speed = flying(seed), 1.0
    start = c.now_s
    c.setpoint = lambda t: (speed * (t - start), 0.0, -1.2, speed, *[0.0] * 5, 0.3, 0.0)
    c.run(10.0)
    place = c.ned
    c.setpoint, c.pose_on = None, False
    assert c.run(20.0, lambda: not c.armed)
    assert math.hypot(c.ned[0] - place[0], c.ned[1] - place[1]) < 1.6  # 2.8 to 3.4 with EKF2_NOAID_TOUT at 1 s


def test_without_a_valid_position_it_keeps_level_and_ignores_the_estimate() -> None:
    c = flying()
    c.pose_on = False
    assert c.run(4.0, lambda: truth_mode(c) == "LAND")
    place = c.ned
    x, y, z = c.px4.estimator.position
    c.px4.estimator.position = (x + 20.0, y, z)
    c.run(2.0)
    assert math.hypot(c.ned[0] - place[0], c.ned[1] - place[1]) < 0.5


def test_a_held_position_shifts_with_a_reset_of_the_estimate() -> None:
    c = flying()
    c.px4.pilot_takes_over("POSCTL")
    c.run(1.0)
    place = c.ned
    c.pose_offset = (0.6, 0.0, 0.0)
    c.reset_counter = 1
    c.run(3.0)
    assert math.dist(c.ned, place) < 0.15


def test_a_pose_jump_with_its_reset_counter_moves_the_vehicle_back_by_the_jump() -> None:
    c = flying()
    c.pose_offset = (0.6, 0.0, 0.0)
    c.reset_counter = 1
    c.run(0.1)
    assert c.last["LOCAL_POSITION_NED"].x == pytest.approx(c.ned[0] + 0.6, abs=0.1)
    c.run(4.0)
    assert c.ned[0] == pytest.approx(-0.6, abs=0.1)


def test_a_pose_jump_without_a_reset_counter_is_refused_silently() -> None:
    c = flying(EKF2_NOAID_TOUT=5_000_000)
    c.pose_offset = (0.6, 0.0, 0.0)
    c.run(0.8)
    assert abs(c.ned[0]) < 0.15
    assert c.flags & 8
    assert c.last["ESTIMATOR_STATUS"].pos_horiz_ratio > 1.0


def test_only_poses_of_the_body_in_a_local_frame_are_accepted() -> None:
    for frame, child, taken in (
        (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD, True),
        (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD, True),
        (mavlink.MAV_FRAME_LOCAL_FLU, mavlink.MAV_FRAME_BODY_FRD, False),
        (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_LOCAL_FRD, False),
    ):
        c = companion()
        c.pose_frame = (frame, child)
        c.run(2.0)
        assert c.px4.estimator.started is taken


def test_timesync_converges_after_500_answers_and_aligns_old_poses() -> None:
    c = companion()
    c.pose_age_s = 0.15
    c.run(40.0)
    assert not converged(c)
    c.run(15.0)
    assert converged(c)
    c.run(2.0)
    assert position_valid(c)
    assert set(c.px4.estimator.ignored) <= {"repeated"}


def test_unanswered_timesync_never_converges() -> None:
    c = companion()
    c.answer_timesync = False
    c.run(55.0)
    assert not converged(c)


def test_stamps_of_a_clock_other_than_timesyncs_lose_the_pose_after_convergence() -> None:
    c = companion()
    c.stamp_shift_s = 5.0
    c.run(45.0)
    assert position_valid(c)
    c.run(15.0)
    assert converged(c)
    assert not position_valid(c)
    assert c.px4.estimator.ignored["future"] > 100


def test_a_timesync_request_is_answered_on_the_autopilots_clock() -> None:
    c = companion()
    c.run(1.0)
    c.keep = {"TIMESYNC"}
    c.send(mavlink.MAVLink_timesync_message(0, 123456789))
    c.run(0.05)
    answer = next(m for m in c.messages if m.tc1 != 0)
    assert answer.ts1 == 123456789
    assert answer.tc1 * 1e-9 == pytest.approx(37.5 + 1.0, abs=0.02)
