"""Whatever a source says, nothing that makes no sense enters the state; what is only written differently changes nothing."""

from __future__ import annotations

import copy
import functools
import math
from dataclasses import replace

import numpy as np
from figure_eight import FigureEight, events
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.localization.fusion.filter_pose_gates import PoseRejection
from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.types.pose import Pose, StampedPose

MOTION = FigureEight()
STREAM = events(MOTION, 2.5, seed=8)
CUT = next(i for i, event in enumerate(STREAM) if event.arrival_s > MOTION.start_s + 1.5)
NOW_S = MOTION.start_s + 1.5

numbers = st.one_of(st.floats(), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e300, -1e-300]))
places = st.tuples(*[st.one_of(st.floats(-1e6, 1e6), st.sampled_from([0.0, 1e300]))] * 3)
quats = st.tuples(*[st.floats(-2.0, 2.0)] * 4).filter(lambda q: math.hypot(*q) > 1e-6)
covariances = st.lists(numbers, min_size=6, max_size=6).map(np.diag)


def _warm() -> FusionFilter:
    """A filter of its own in flight."""
    return copy.deepcopy(_flown())


@functools.cache
def _flown() -> FusionFilter:
    fusion = FusionFilter()
    for event in STREAM[:CUT]:
        if event.imu:
            fusion.add_imu([event.imu])
        elif event.pose:
            assert fusion.add_pose(event.pose, event.arrival_s)
    return fusion


def _newest_good() -> StampedPose:
    return next(event.pose for event in STREAM[CUT:] if event.pose)


def _bits(fusion: FusionFilter) -> bytes:
    odom = fusion.odom_at(NOW_S)
    assert odom
    return odom.odom_from_body.matrix().tobytes() + odom.velocity_odom_mps.tobytes() + odom.covariance.tobytes()


@settings(max_examples=60, deadline=None)
@given(numbers, places, quats, covariances, st.integers(-5, 105), st.integers(0, 3))
def test_hostile_poses_leave_a_sound_state(
    stamp_s: float, place: tuple[float, ...], quat: tuple[float, ...], covariance: np.ndarray, quality: int, resets: int
) -> None:
    """Anything a Pose can hold, with any stamp, covariance, quality and counter: refused, or the state is as good as before."""
    fusion = _warm()
    before = fusion.odom_at(NOW_S)
    with np.errstate(over="ignore", invalid="ignore"):
        for stamp in (stamp_s, NOW_S - 0.03):
            try:
                hostile = StampedPose(stamp, Pose(np.array(quat), np.array(place)), np.zeros(3), covariance, quality, resets)
            except ValueError:
                continue  # the type itself does not take it
            fusion.add_pose(hostile, NOW_S)
    after = fusion.odom_at(NOW_S)
    assert before
    assert after
    for array in (after.odom_from_body.matrix(), after.velocity_odom_mps, after.covariance):
        assert np.isfinite(array).all()
    moved = after.odom_from_body.translation_m - before.odom_from_body.translation_m
    assert np.linalg.norm(moved) < 0.05
    assert np.linalg.norm(after.velocity_odom_mps - before.velocity_odom_mps) < 0.3
    assert after.reset_counter == 0
    assert (np.linalg.eigvalsh(after.covariance) > 0).all()


@settings(max_examples=30, deadline=None)
@given(st.one_of(st.floats(max_value=NOW_S - 1.001), st.floats(min_value=NOW_S + 0.011), st.just(math.nan)))
def test_stamps_outside_the_last_second_never_enter(stamp_s: float) -> None:
    fusion = _warm()
    bits = _bits(fusion)
    assert not fusion.add_pose(replace(_newest_good(), stamp_s=stamp_s), NOW_S)
    assert _bits(fusion) == bits


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 12), st.floats(-9e-5, 9e-5))
def test_no_pose_enters_twice(k: int, shift_s: float) -> None:
    """The same pose, or another one that claims its stamp."""
    fusion = _warm()
    bits = _bits(fusion)
    poses = [event.pose for event in STREAM[:CUT] if event.pose and event.pose.stamp_s > NOW_S - 0.99]
    again = poses[k]
    moved = Pose(again.odom_from_body.quat_wxyz, again.odom_from_body.translation_m + 0.02)
    assert not fusion.add_pose(again, NOW_S)
    assert not fusion.add_pose(replace(again, stamp_s=again.stamp_s + shift_s, odom_from_body=moved), NOW_S)
    assert _bits(fusion) == bits
    assert fusion.rejected == {PoseRejection.DUPLICATE: 2}


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.floats(0.2, 5.0)), min_size=12, max_size=12))
def test_a_quaternion_its_negative_and_its_multiples_are_one_attitude(signs: list[tuple[bool, float]]) -> None:
    """A source that flips the sign from pose to pose, or does not normalise, flies the same flight."""
    straight, flipped, k = FusionFilter(), FusionFilter(), 0
    for event in STREAM[:CUT]:
        if event.imu:
            straight.add_imu([event.imu])
            flipped.add_imu([event.imu])
        elif event.pose:
            negative, scale = signs[k % len(signs)]
            k += 1
            quat = event.pose.odom_from_body.quat_wxyz * (-scale if negative else scale)
            same = replace(event.pose, odom_from_body=Pose(quat, event.pose.odom_from_body.translation_m))
            assert straight.add_pose(event.pose, event.arrival_s)
            assert flipped.add_pose(same, event.arrival_s)
    a, b = straight.odom_at(NOW_S), flipped.odom_at(NOW_S)
    assert a
    assert b
    np.testing.assert_allclose(a.odom_from_body.matrix(), b.odom_from_body.matrix(), atol=1e-9)
    np.testing.assert_allclose(a.velocity_odom_mps, b.velocity_odom_mps, atol=1e-9)


def test_the_same_stream_gives_the_same_bits() -> None:
    assert _bits(_flown.__wrapped__()) == _bits(_flown.__wrapped__())
