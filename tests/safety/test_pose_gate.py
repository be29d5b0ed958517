"""Which poses are believed: spikes, jumps, turns, stamps, and tracks that come back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uav_recon.safety.pose_gate import PoseGate, PoseVerdict
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

STEP_S = 1 / 30


def pose(
    stamp_s: float,
    place: tuple[float, float, float] = (0.0, 0.0, 1.0),
    yaw_rad: float = 0.0,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **more: Any,
) -> StampedPose:
    return StampedPose(stamp_s, Pose.from_yaw(yaw_rad, np.array(place)), np.array(velocity), **more)


def settled() -> PoseGate:
    gate = PoseGate(0.8)
    assert gate.judge(pose(0.0), 0.02) == PoseVerdict(True)
    return gate


def judge(gate: PoseGate, one: StampedPose) -> PoseVerdict:
    return gate.judge(one, one.stamp_s + 0.02)


def test_a_flight_is_believed() -> None:
    gate = PoseGate(0.8)
    for n in range(90):
        t = n * STEP_S
        assert judge(gate, pose(t, (math.sin(t), 0.0, 1.0), 0.8 * t, (math.cos(t), 0.0, 0.0))) == PoseVerdict(True)


@pytest.mark.parametrize(
    ("now_s", "good"), [(0.1, True), (0.249, True), (0.251, False), (0.051, True), (0.049, False), (math.nan, False)]
)
def test_old_and_future_stamps_are_not(now_s: float, good: bool) -> None:
    verdict = PoseGate(0.8).judge(pose(0.1), now_s)
    assert verdict.good is good
    assert verdict.why == (None if good else Reason(ReasonCode.POSE_AGE, (now_s - 0.1,)))


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"velocity_odom_mps": np.zeros(2)}, ReasonCode.POSE_MALFORMED),
        ({"velocity_odom_mps": np.zeros(4)}, ReasonCode.POSE_MALFORMED),
        ({"covariance": np.eye(3)}, ReasonCode.POSE_MALFORMED),
        ({"covariance": np.eye(7)}, ReasonCode.POSE_MALFORMED),
        ({"velocity_odom_mps": np.full(3, math.nan)}, ReasonCode.POSE_OUT_OF_RANGE),
        ({"velocity_odom_mps": np.array([0.0, 0.0, -10_001.0])}, ReasonCode.POSE_OUT_OF_RANGE),
        ({"odom_from_body": Pose.from_yaw(0.0, np.array([0.0, 1e300, 0.0]))}, ReasonCode.POSE_OUT_OF_RANGE),
        ({"odom_from_body": Pose.from_yaw(0.0, np.array([-10_001.0, 0.0, 0.0]))}, ReasonCode.POSE_OUT_OF_RANGE),
        ({"covariance": np.full((6, 6), math.nan)}, ReasonCode.POSE_OUT_OF_RANGE),
        ({"covariance": np.full((6, 6), math.inf)}, ReasonCode.POSE_OUT_OF_RANGE),
        ({"covariance": np.diag([1e-4] * 5 + [0.85e39])}, ReasonCode.POSE_OUT_OF_RANGE),
        ({"covariance": np.diag([10_001.0] + [1e-4] * 5)}, ReasonCode.POSE_OUT_OF_RANGE),
        ({"covariance": np.diag([1e-4] * 5 + [-10_001.0])}, ReasonCode.POSE_OUT_OF_RANGE),
        ({"quality": 0}, ReasonCode.POSE_NO_QUALITY),
        ({"quality": -1}, ReasonCode.POSE_NO_QUALITY),
    ],
)
def test_what_is_unfit_by_itself_is_named(changes: dict[str, Any], why: ReasonCode) -> None:
    usual: dict[str, Any] = {"odom_from_body": Pose.identity(), "velocity_odom_mps": np.zeros(3)}
    bad = StampedPose(0.1, **{**usual, **changes})
    assert judge(settled(), bad) == PoseVerdict(False, why=Reason(why))


def test_the_least_quality_the_oldest_and_the_earliest_stamp_are_believed() -> None:
    assert PoseGate(0.8).judge(pose(0.0, quality=1), 0.0).good
    assert PoseGate(0.8).judge(pose(0.0), 0.15).good
    assert PoseGate(0.8).judge(pose(0.0), -0.05).good


def test_the_largest_numbers_are_believed() -> None:
    largest = pose(0.0, (1e4, -1e4, 1e4), velocity=(1e4, 0.0, -1e4), covariance=np.full((6, 6), 1e4))
    assert PoseGate(0.8).judge(largest, 0.0).good


def test_a_covariance_that_is_none_widens_nothing_and_raises_nothing() -> None:
    for off_m, good in ((0.09, True), (0.11, False)):
        assert judge(settled(), pose(STEP_S, (off_m, 0.0, 1.0), covariance=-np.eye(6))).good is good


def test_a_pose_is_never_taken_twice_or_backwards() -> None:
    gate = settled()
    assert judge(gate, pose(0.1)).good
    assert judge(gate, pose(0.1)).why == Reason(ReasonCode.POSE_REPEATED)
    assert judge(gate, pose(0.05)).why == Reason(ReasonCode.POSE_REPEATED)
    assert judge(gate, pose(0.13)).good


@pytest.mark.parametrize("jump_m", [0.09, 0.105])
def test_a_spike_is_left_out(jump_m: float) -> None:
    gate = settled()
    verdict = judge(gate, pose(STEP_S, (jump_m, 0.0, 1.0)))
    assert verdict.good is (jump_m < 0.1)
    assert judge(gate, pose(2 * STEP_S)).good, "and what goes on is believed"


def test_a_pose_near_the_last_one_is_no_jump_whatever_velocity_that_had() -> None:
    gate = settled()
    assert judge(gate, pose(0.1, velocity=(-0.5, 0.0, 0.0))).good
    assert judge(gate, pose(0.4, (0.05, 0.0, 1.0))).good


def test_an_unsure_pose_may_be_farther_off_but_not_far() -> None:
    for sigma_m, off_m, good in ((0.05, 0.14, True), (0.05, 0.16, False), (1.0, 0.29, True), (1.0, 0.31, False)):
        unsure = pose(STEP_S, (off_m, 0.0, 1.0), covariance=np.eye(6) * sigma_m**2)
        assert judge(settled(), unsure).good is good, (sigma_m, off_m)


def test_nobody_flies_at_more_than_two_metres_a_second() -> None:
    for speed, good in ((2.0, True), (3.0, True), (6.0, False)):  # over one step the tolerance of a place covers the rest
        gate = PoseGate(0.8)
        assert judge(gate, pose(0.0, velocity=(speed, 0.0, 0.0))).good
        verdict = judge(gate, pose(STEP_S, (speed * STEP_S, 0.0, 1.0)))
        assert verdict.good is good
        assert (verdict.why and verdict.why.code) is (None if good else ReasonCode.POSE_SPEED)


@pytest.mark.parametrize(("turn_deg", "good"), [(11.0, True), (11.1, False), (-11.0, True), (-11.1, False), (180.0, False)])
def test_a_turn_is_eight_degrees_beside_what_can_be_flown(turn_deg: float, good: bool) -> None:
    verdict = judge(settled(), pose(STEP_S, yaw_rad=math.radians(turn_deg)))
    assert verdict.good is good  # 8 degrees and 2 * 0.8 rad/s for a thirtieth of a second: 11.06
    assert (verdict.why and verdict.why.code) is (None if good else ReasonCode.POSE_TURN)


def test_a_source_that_says_so_begins_again() -> None:
    gate = settled()
    assert judge(gate, pose(STEP_S, (3.0, 2.0, 1.0), 1.0, reset_counter=1)) == PoseVerdict(True, again=True)
    assert judge(gate, pose(2 * STEP_S, (3.0, 2.0, 1.0), 1.0, reset_counter=1)) == PoseVerdict(True)


def test_a_jump_that_stays_is_believed_after_moments_of_agreement_and_as_a_new_odom() -> None:
    gate = settled()
    answers = [judge(gate, pose(n * STEP_S, (0.5, 0.0, 1.0))) for n in range(1, 40)]
    first = next(n for n, verdict in enumerate(answers) if verdict.good)
    assert answers[first].again
    assert first == 12, "0.4 s after the first: before the silence of the poses ends the flight"
    assert all(verdict == PoseVerdict(True) for verdict in answers[first + 1 :])


def test_three_bad_ones_in_a_row_put_the_old_track_on_trial_too() -> None:
    gate = settled()
    for n in range(1, 3):
        assert not judge(gate, pose(n * STEP_S, (0.5 * n, 0.0, 1.0))).good
    assert judge(gate, pose(3 * STEP_S)).good, "two are a glitch"
    for n in range(4, 7):
        assert not judge(gate, pose(n * STEP_S, (0.5 * n, 0.0, 1.0))).good
    assert judge(gate, pose(7 * STEP_S)) == PoseVerdict(False, why=Reason(ReasonCode.POSE_ON_TRIAL))


@pytest.mark.parametrize(
    ("way_m", "again"), [(-0.09, False), (0.0, False), (0.2, False), (0.3, False), (0.49, False), (-0.12, True), (0.75, True)]
)
def test_a_track_that_goes_on_where_the_accepted_one_led_is_no_restart(way_m: float, again: bool) -> None:
    """Between them some poses were wrong; the vehicle may have braked or flown on."""
    gate = PoseGate(0.8)
    assert judge(gate, pose(0.0, velocity=(1.0, 0.0, 0.0))).good
    for n in range(1, 5):
        assert not judge(gate, pose(n * STEP_S, (0.0, 0.5 * n, 1.0))).good
    answers = [judge(gate, pose(n * STEP_S, (way_m, 0.0, 1.0))) for n in range(5, 30)]
    first = next(verdict for verdict in answers if verdict.good)
    assert first.again is again


def test_a_track_that_goes_on_after_a_second_is_a_restart() -> None:
    gate = settled()
    answers = [judge(gate, pose(0.2 * n, (0.9 if n < 4 else 0.0, 0.0, 1.0))) for n in range(1, 30)]
    assert next(verdict for verdict in answers if verdict.good).again


def test_a_slow_track_has_to_send_ten() -> None:
    gate = settled()
    answers = [judge(gate, pose(0.2 * n, (0.9, 0.9, 1.0))).good for n in range(1, 30)]
    assert answers.index(True) == 9


def test_a_new_track_that_breaks_begins_again() -> None:
    gate = settled()
    for n in range(1, 11):
        assert not judge(gate, pose(n * STEP_S, (0.5, 0.0, 1.0))).good
    answers = [judge(gate, pose(n * STEP_S, (1.5, 0.0, 1.0))).good for n in range(11, 70)]
    assert answers.index(True) == 13


@pytest.mark.parametrize(("speed_mps", "good"), [(0.0, True), (0.44, True), (0.46, False), (-0.44, True), (-0.46, False)])
def test_over_half_a_second_a_push_explains_an_eighth_of_a_metre(speed_mps: float, good: bool) -> None:
    gate = PoseGate(0.8)
    assert judge(gate, pose(0.0, velocity=(0.0, 0.7, 0.0))).good
    assert judge(gate, pose(0.5, (speed_mps * 0.5, 0.35, 1.0))).good is good


@pytest.mark.parametrize(("speed_mps", "good"), [(2.19, True), (2.21, False)])
def test_over_half_a_second_the_way_itself_has_a_limit(speed_mps: float, good: bool) -> None:
    gate = PoseGate(0.8)
    assert judge(gate, pose(0.0, velocity=(0.0, speed_mps, 0.0))).good
    verdict = judge(gate, pose(0.5, (0.0, speed_mps * 0.5, 1.0)))
    assert verdict.good is good
    assert verdict.why == (None if good else Reason(ReasonCode.POSE_SPEED, (1.1, 0.5)))


def test_a_turn_is_counted_from_the_last_heading_and_across_the_cut() -> None:
    for first, second, good in ((1.0, 1.15, True), (1.0, -0.9, False), (3.1, -3.1, True), (-2.0, -1.0, False)):
        gate = PoseGate(0.8)
        assert judge(gate, pose(0.0, yaw_rad=first)).good
        assert judge(gate, pose(STEP_S, yaw_rad=second)).good is good


def test_no_more_than_moments_of_agreement_are_needed() -> None:
    gate = settled()
    answers = [judge(gate, pose(n / 32, (0.5, 0.0, 1.0))).good for n in range(1, 40)]
    assert answers.index(True) == 13


@pytest.mark.parametrize("back_s", [0.0, 0.1])
def test_a_track_that_repeats_itself_or_goes_back_proves_nothing(back_s: float) -> None:
    gate = settled()
    for n in range(1, 60):
        assert not judge(gate, pose(0.2 * n, (0.9, 0.9, 1.0))).good
        assert not judge(gate, pose(0.2 * n - back_s, (0.9, 0.9, 1.0))).good


@pytest.mark.parametrize(("before", "after"), [(3, 4), (255, 0), (300, 300), (1000, 1001)])
def test_whatever_way_the_counter_of_resets_changes_odom_has_jumped(before: int, after: int) -> None:
    gate = PoseGate(0.8)
    assert judge(gate, pose(0.0, reset_counter=before)) == PoseVerdict(True)
    again = judge(gate, pose(STEP_S, (5.0, 0.0, 1.0) if after != before else (0.0, 0.0, 1.0), reset_counter=int(str(after))))
    assert again == PoseVerdict(True, again=after != before)


@pytest.mark.parametrize(
    ("sigma_m", "off_m", "good"), [(0.05, 0.149, True), (0.05, 0.152, False), (0.2, 0.299, True), (0.2, 0.302, False)]
)
def test_a_doubtful_pose_may_lie_three_sigma_off(sigma_m: float, off_m: float, good: bool) -> None:
    """sigma of the place: the root of the mean of its three variances."""
    gate = settled()
    covariance = np.diag([1.0, 0.5, 1.5, 9.0, 9.0, 9.0]) * sigma_m**2
    assert judge(gate, pose(STEP_S, (off_m, 0.0, 1.0), covariance=covariance)).good is good


def test_a_negative_variance_is_none() -> None:
    gate = settled()
    assert judge(gate, pose(STEP_S, (0.09, 0.0, 1.0), covariance=-np.eye(6))).good
    assert not judge(gate, pose(2 * STEP_S, (0.21, 0.0, 1.0), covariance=-np.eye(6))).good


def test_a_track_that_goes_back_in_time_begins_again() -> None:
    gate, t, counted = settled(), 1.0, 0
    for _ in range(3):
        for n in range(8):  # too few at a time
            counted += judge(gate, pose(t + n * 0.05, (3.0, 0.0, 1.0))).good
        t += 0.1
    assert counted == 0
