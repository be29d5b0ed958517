from __future__ import annotations

import math

import numpy as np
import pytest
from figure_eight import GRAVITY, FigureEight, perfect_imu
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uav_recon.localization.fusion.imu_integration import (
    InertialState,
    InertialTrack,
    Vector,
    conjugate,
    exponential,
    logarithm,
    multiply,
    normalised,
    rotate,
)

vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


def _three(array: object) -> Vector:
    x, y, z = np.asarray(array, dtype=float).tolist()
    return (x, y, z)


@given(vectors, vectors, vectors)
def test_quaternion_algebra_is_scipys(a: Vector, b: Vector, v: Vector) -> None:
    qa, qb = exponential(a), exponential(b)
    ra, rb = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
    np.testing.assert_allclose(rotate(multiply(qa, qb), v), (ra * rb).apply(v), atol=1e-9)
    np.testing.assert_allclose(rotate(conjugate(qa), v), ra.inv().apply(v), atol=1e-9)
    turned = Rotation.from_rotvec(logarithm(multiply(qa, qb)))
    assert (turned.inv() * ra * rb).magnitude() < 1e-7
    np.testing.assert_allclose(np.linalg.norm(normalised(multiply(qa, qb))), 1.0)


def _fly(track: InertialTrack, motion: FigureEight, duration_s: float) -> None:
    for k in range(int(duration_s * 200) + 1):
        sample = perfect_imu(motion, k)
        track.push(sample.stamp_s, _three(sample.gyro_radps), _three(sample.specific_force_mps2))


def _between(track: InertialTrack, a_s: float, b_s: float) -> tuple[InertialState, InertialState]:
    a, b = track.at(a_s), track.at(b_s)
    assert a is not None
    assert b is not None
    return a, b


@pytest.mark.parametrize(("start_s", "end_s"), [(100.2, 101.7), (100.2031, 100.2679), (119.0, 124.5)])
def test_any_two_instants_give_the_motion_between_them(start_s: float, end_s: float) -> None:
    """Also between samples, and after the track has forgotten its beginning."""
    motion, track = FigureEight(), InertialTrack()
    _fly(track, motion, end_s - 99.5)
    assert (track.oldest_s > 100.0) == (end_s > 121.0)
    a, b = _between(track, start_s, end_s)
    odom_from_gyro = multiply((*_wxyz(motion.attitude(start_s)),), conjugate(a.gyro_from_body))
    dt = end_s - start_s
    dv = rotate(odom_from_gyro, _three(np.subtract(b.velocity_integral, a.velocity_integral)))
    dx = np.subtract(b.position_integral, a.position_integral) - np.array(a.velocity_integral) * dt
    velocity = motion.velocity(start_s) + dv + GRAVITY * dt
    position = (
        motion.position(start_s) + motion.velocity(start_s) * dt + rotate(odom_from_gyro, _three(dx)) + 0.5 * GRAVITY * dt**2
    )
    np.testing.assert_allclose(velocity, motion.velocity(end_s), atol=2e-3 * max(1.0, dt))
    np.testing.assert_allclose(position, motion.position(end_s), atol=2e-3 * max(1.0, dt**2))
    turned = Rotation.from_quat(multiply(odom_from_gyro, b.gyro_from_body), scalar_first=True)
    assert (turned.inv() * motion.attitude(end_s)).magnitude() < 1e-3


def _wxyz(rotation: Rotation) -> tuple[float, float, float, float]:
    w, x, y, z = rotation.as_quat(scalar_first=True).tolist()
    return (w, x, y, z)


def test_a_gap_is_coasted_not_extrapolated() -> None:
    track = InertialTrack()
    track.push(0.0, (0.0, 0.0, 1.0), (5.0, 0.0, 9.80665))
    a, b = _between(track, 0.0, 2.0)
    np.testing.assert_allclose(np.subtract(b.velocity_integral, a.velocity_integral), [0.0, 0.0, 2 * 9.80665])
    assert b.gyro_from_body == (1.0, 0.0, 0.0, 0.0)
    track.push(2.0, (0.0, 0.0, 1.0), (5.0, 0.0, 9.80665))
    _a, c = _between(track, 0.0, 2.0)
    np.testing.assert_allclose(c.velocity_integral, b.velocity_integral)


def test_coasting_turns_at_its_rate() -> None:
    track = InertialTrack()
    track.coast(0.0, (0.0, 0.0, 0.5))
    track.coast(1.0, (0.0, 0.0, 0.25))
    _a, b = _between(track, 0.0, 3.0)
    np.testing.assert_allclose(logarithm(b.gyro_from_body), [0.0, 0.0, 1.0], atol=1e-12)


def test_what_no_propeller_pushes_is_summed_up_whatever_is_forgotten() -> None:
    track, hover, blow = InertialTrack(), (0.0, 0.0, 9.8), (0.0, -40.0, 30.0)
    for k in range(3):
        track.push(k * 0.01, (0.0, 0.0, 0.0), hover)
    for k in range(3, 9):
        track.push(k * 0.01, (0.0, 0.0, 0.0), blow)
    for k in range(9, 5000):
        track.push(k * 0.01, (0.0, 0.0, 0.0), (18.0, 0.0, 20.0))  # as hard as a vehicle flies
        if k == 20:
            before, after = _between(track, 0.015, 0.15)
            assert before.shock_velocity_mps == 0.0
            assert after.shock_velocity_mps == pytest.approx(50.0 * 0.06, abs=0.4)  # its edges are cut in halves
    assert track.oldest_s > 1.0
    assert _between(track, 25.0, 49.0)[1].shock_velocity_mps == 0.0


def test_what_no_vehicle_turns_is_summed_up_whatever_is_forgotten() -> None:
    track, hover = InertialTrack(), (0.0, 0.0, 9.8)
    for k in range(5000):
        rate = {3: (0.0, -9.0, 12.0), 6: (0.0, 30.0, 0.0)}.get(k, (0.0, 0.0, 9.9))  # 15 and 30 rad/s; as fast as one turns
        track.push(k * 0.01, rate, hover)
        if k == 20:
            assert [_between(track, a, b)[1].overrate_angle_rad > 0.0 for a, b in ((0.0, 0.02), (0.0, 0.025))] == [False, True]
            before, after = _between(track, 0.045, 0.075)
            assert after.overrate_angle_rad - before.overrate_angle_rad == pytest.approx(0.02 * math.hypot(8.75, 4.95))
    assert _between(track, 25.0, 49.0)[1].overrate_angle_rad == 0.0


def test_a_gyro_that_says_more_than_one_can_counts_as_one_that_says_so_much() -> None:
    track = InertialTrack()
    for k in range(11):
        track.push(k * 0.01, (18.0, 0.0, -24.0), (0.0, 0.0, 9.8))
    turned = logarithm(_between(track, 0.0, 0.1)[1].gyro_from_body)
    np.testing.assert_allclose(turned, [0.1 * 17.5 * 0.6, 0.0, -0.1 * 17.5 * 0.8], atol=1e-9)


def test_before_its_beginning_a_track_knows_nothing() -> None:
    track = InertialTrack()
    assert track.at(0.0) is None
    track.coast(1.0, (0.0, 0.0, 0.0))
    assert track.at(0.999) is None
