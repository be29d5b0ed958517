from __future__ import annotations

import numpy as np
from hall import CLEARANCE_M, CONFIG, JERK, MOTION, assert_rests, assert_within_limits, flown, paths, straight, to_polyline
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.motion import MotionPlanner
from uav_recon.motion.time_scaling import BRAKE_RISE_S
from uav_recon.types.tasks import ViewPath


@settings(max_examples=80, deadline=None)
@given(path=paths(), share=st.floats(0.0, 1.0))
def test_stop_brakes_on_the_path(path: ViewPath, share: float) -> None:
    trajectory = flown(path)
    now_s = trajectory.start_s + share * trajectory.duration_s
    before = trajectory.setpoint_at(now_s)
    braked = MOTION.plan_stop(trajectory, now_s, 8)
    assert braked.identifier == 8 and braked.start_s == now_s and not len(braked.views_s)
    np.testing.assert_allclose(braked.position_m[0], before.position_m, atol=1e-9)
    np.testing.assert_allclose(braked.velocity_mps[0], before.velocity_mps, atol=1e-9)
    assert_within_limits(braked, jerk=JERK + CONFIG.acceleration_mps2 / BRAKE_RISE_S)  # the way's own, and the brake's
    assert_rests(braked, -1)
    assert to_polyline(braked.position_m, trajectory.position_m).max() < 1e-3
    speed = float(np.linalg.norm(before.velocity_mps))
    # v²/2a at nine tenths of a, with what is still gained and flown while the brake comes on, and a turn to end as well
    peak = speed + 0.15 * CONFIG.acceleration_mps2
    bound_m = peak**2 / (1.8 * CONFIG.acceleration_mps2) + 0.4 * peak + 0.1
    left_m = float(np.linalg.norm(np.diff(trajectory.position_m[int(share * len(trajectory.yaw_rad)) :], axis=0), axis=1).sum())
    assert float(np.linalg.norm(np.diff(braked.position_m, axis=0), axis=1).sum()) <= min(bound_m, left_m + 0.05)


def test_stop_before_the_start_and_after_the_end_holds() -> None:
    trajectory = flown(straight([0, 0, 1.0], [2, 0, 1.0]))
    for now_s, at_m in ((0.0, [0, 0, 1.0]), (1e4, [2, 0, 1.0])):
        held = MOTION.plan_stop(trajectory, now_s, 1)
        assert np.allclose(held.position_m, at_m, atol=1e-9) and held.start_s == now_s
        assert_rests(held, -1)


def test_stop_at_cruise_takes_little_more_than_physics() -> None:
    trajectory = flown(straight([-4, 0, 1.5], [4, 0, 1.5]))
    braked = MOTION.plan_stop(trajectory, trajectory.start_s + trajectory.duration_s / 2, 1)
    assert np.ptp(braked.position_m[:, 0]) <= CONFIG.speed_mps**2 / (2 * CONFIG.acceleration_mps2) + 0.15


@settings(max_examples=40, deadline=None)
@given(path=paths(), share=st.floats(0.05, 0.95))
def test_a_blocked_way_is_left_harder_within_what_the_guard_allows(path: ViewPath, share: float) -> None:
    trajectory, hardest_mps2 = flown(path), 2.0
    now_s = trajectory.start_s + share * trajectory.duration_s
    soft = MOTION.plan_stop(trajectory, now_s, 8)
    hard = MotionPlanner(CONFIG, CLEARANCE_M, braking_mps2=hardest_mps2).plan_stop(trajectory, now_s, 8)
    assert np.linalg.norm(hard.acceleration_mps2, axis=1).max() <= hardest_mps2
    assert hard.duration_s <= soft.duration_s + 1e-9
    assert_rests(hard, -1)


def test_a_blocked_way_at_cruise_ends_earlier() -> None:
    trajectory = flown(straight([-4, 0, 1.5], [4, 0, 1.5]))
    now_s = trajectory.start_s + trajectory.duration_s / 2
    soft, hard = (
        np.ptp(MotionPlanner(CONFIG, CLEARANCE_M, braking_mps2=a).plan_stop(trajectory, now_s, 1).position_m[:, 0])
        for a in (CONFIG.acceleration_mps2, 2.0)
    )
    assert hard <= CONFIG.speed_mps**2 / (2 * 2.0) + 0.15
    assert soft - hard >= 0.15
