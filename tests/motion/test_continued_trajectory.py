from __future__ import annotations

import numpy as np
import pytest
from hall import (
    CLEARANCE_M,
    CONFIG,
    HALL,
    JERK,
    MOTION,
    RATE,
    SPIN,
    assert_rests,
    assert_sees,
    flown,
    is_free,
    jerks,
    path_of,
    random_path,
    room,
    room_around,
    straight,
    wall,
)  # fmt: skip
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.motion.time_scaling import BRAKE_RISE_S, KEPT_S
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Trajectory


def left(flying: Trajectory, leave_s: float, path: ViewPath) -> Trajectory:
    answer = MOTION.plan_from_motion(path, HALL, flying, leave_s, np.inf, 9)
    assert isinstance(answer, Trajectory), answer
    return answer


def assert_joins(answer: Trajectory, flying: Trajectory, leave_s: float) -> None:
    """It is the old motion until it leaves it, and goes on from there without a jump."""
    assert answer.start_s <= leave_s
    assert answer.start_s >= max(flying.start_s, leave_s - KEPT_S - flying.step_s) - 1e-9
    for now_s in np.arange(answer.start_s, leave_s - 2 * flying.step_s, 0.013):
        old, new = flying.setpoint_at(now_s), answer.setpoint_at(now_s)
        np.testing.assert_allclose(new.position_m, old.position_m, atol=1e-9)
        np.testing.assert_allclose(new.velocity_mps, old.velocity_mps, atol=1e-3)
        np.testing.assert_allclose(new.acceleration_mps2, old.acceleration_mps2, atol=0.05)
        assert abs(new.yaw_rad - old.yaw_rad) < 1e-9
        assert abs(new.yaw_rate_radps - old.yaw_rate_radps) < 1e-3
    velocity = np.diff(answer.position_m, axis=0) / answer.step_s
    turning = np.diff(answer.yaw_rad) / answer.step_s
    assert np.linalg.norm(velocity, axis=1).max() <= CONFIG.speed_mps * 1.01
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() / answer.step_s <= 1.05 * CONFIG.acceleration_mps2
    assert np.abs(turning).max() <= 1.01 * RATE
    assert np.abs(np.diff(turning)).max() / answer.step_s <= 1.05 * SPIN
    assert -1.05 * CONFIG.descent_mps <= velocity[:, 2].min() and velocity[:, 2].max() <= 1.05 * CONFIG.climb_mps
    assert jerks(answer)[:-2].max() <= max(JERK, 3 * CONFIG.acceleration_mps2 / BRAKE_RISE_S)


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**31), share=st.floats(0.0, 1.2))
def test_a_motion_is_left_without_a_jump(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    flying = flown(random_path(rng, short=bool(seed % 2)), yaw_rad=0.3)
    leave_s = flying.start_s + share * flying.duration_s
    path = random_path(rng, bool(seed // 2 % 2), flying.setpoint_at(leave_s).position_m)
    answer = left(flying, leave_s, path)
    assert answer.identifier == 9
    assert_joins(answer, flying, leave_s)
    assert_rests(answer, -1)
    assert_sees(answer, path)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), first=st.floats(0.2, 0.8), second=st.floats(0.0, 0.9))
def test_what_left_one_motion_can_be_left_in_turn(seed: int, first: float, second: float) -> None:
    rng = np.random.default_rng(seed)
    flying = flown(random_path(rng, short=False))
    for share in (first, second):
        leave_s = flying.start_s + min(KEPT_S, flying.duration_s) + share * max(flying.duration_s - KEPT_S, 0.0)
        path = random_path(rng, False, flying.setpoint_at(leave_s).position_m)
        answer = left(flying, leave_s, path)
        assert_joins(answer, flying, leave_s)
        flying = answer


@pytest.mark.parametrize("turn_deg", [0, 30, 60, 90, 120, 180])
def test_any_direction_can_be_taken_from_full_speed(turn_deg: float) -> None:
    flying = flown(straight([-4, 0, 1.5], [4, 0, 1.5]))
    leave_s = flying.start_s + flying.duration_s / 2
    here = flying.setpoint_at(leave_s).position_m
    way = here + 2.0 * np.array([np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg)), 0.0])
    answer = left(flying, leave_s, path_of([np.array([here, way])], [0.0]))
    assert_joins(answer, flying, leave_s)
    rest_s = 2.0 / CONFIG.speed_mps + CONFIG.speed_mps / CONFIG.acceleration_mps2  # from a stand, after the leaving
    stop_s = CONFIG.speed_mps / CONFIG.acceleration_mps2
    assert answer.duration_s - KEPT_S <= rest_s + 2 * stop_s * (turn_deg >= 60) + 1.0


def test_going_straight_on_costs_nothing() -> None:
    flying = flown(straight([-4, 0, 1.5], [2, 0, 1.5]))
    leave_s = flying.start_s + flying.duration_s - 1.6
    here = flying.setpoint_at(leave_s).position_m
    answer = left(flying, leave_s, path_of([np.array([here, [2, 0, 1.5]]), np.array([[2, 0, 1.5], [4, 0, 1.5]])], [0.0, 0.0]))
    whole = flown(path_of([np.array([[-4, 0, 1.5], [2, 0, 1.5]]), np.array([[2, 0, 1.5], [4, 0, 1.5]])], [0.0, 0.0]))
    assert answer.start_s + answer.duration_s <= whole.start_s + whole.duration_s + 0.4
    assert len(answer.views_s) == 2


def test_before_a_wall_it_turns_away_in_time() -> None:
    """At full speed along a wall, the new way goes back: it may not run on into what is not free."""
    walled = room(wall([1.6, -5, 0], [1.8, 5, 3]))
    flying = flown(straight([-4, 0, 1.5], [1.1, 0, 1.5]), walled)
    for before_s in np.arange(0.2, 3.0, 0.2):
        leave_s = flying.start_s + flying.duration_s - before_s
        here = flying.setpoint_at(leave_s).position_m
        for goal in ([-2, 0, 1.5], [0.5, 2.0, 1.5], [0.9, -2.0, 1.5]):
            answer = MOTION.plan_from_motion(path_of([np.array([here, goal])], [1.0]), walled, flying, leave_s, np.inf, 9)
            assert isinstance(answer, Trajectory), answer
            assert is_free(answer.position_m, walled).all()
            assert room_around(answer.position_m, walled).min() >= CLEARANCE_M - 0.05 - 1e-6
            assert_rests(answer, -1)


def test_where_it_cannot_run_on_it_brakes_along_the_way_it_has() -> None:
    """In a bent corridor, just before the bend, sent back: straight on is wall, the old way round the bend is free."""
    corridor = room(
        wall([-5, 0.5, 0], [0.5, 5, 3]), wall([-5, -5, 0], [1.4, -0.5, 3]), wall([1.4, -5, 0], [5, 5, 3]),
    )  # fmt: skip
    bent = path_of([np.array([[-3, 0, 1.5], [0.95, 0, 1.5], [0.95, 3, 1.5]])], [0.0])
    flying = flown(bent, corridor)
    at = int(np.argmax(flying.position_m[:, 0] > 0.4))
    leave_s = flying.start_s + at * flying.step_s
    here = flying.position_m[at]
    answer = MOTION.plan_from_motion(path_of([np.array([here, [-3, 0, 1.5]])], [0.0]), corridor, flying, leave_s, np.inf, 9)
    assert isinstance(answer, Trajectory), answer
    assert_joins(answer, flying, leave_s)
    assert room_around(answer.position_m, corridor).min() >= CLEARANCE_M - 0.05 - 0.02
    np.testing.assert_allclose(answer.position_m[-1], [-3, 0, 1.5], atol=1e-9)


def test_what_is_impossible_is_refused_in_words() -> None:
    flying = flown(straight([-4, 0, 1.5], [0, 0, 1.5]))
    here = flying.setpoint_at(7.0).position_m
    walled = room(wall([1.6, -5, 0], [1.8, 5, 3]))
    path = path_of([np.array([here, [3, 0, 1.5]])], [1.0])
    blocked = MOTION.plan_from_motion(path, walled, flying, 7.0, np.inf, 9)
    assert isinstance(blocked, Reason)
    assert blocked.code is ReasonCode.PATH_CLEARANCE
    assert MOTION.plan_from_motion(path, room(epoch=1), flying, 7.0, np.inf, 9) == Reason(ReasonCode.PATH_MAP_EPOCH, (0, 1))
