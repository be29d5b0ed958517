"""The covariance is carried by the derivative of what carries the mean: finite differences say which that is."""

from __future__ import annotations

import numpy as np
import pytest
from figure_eight import FigureEight, perfect_imu
from numpy.typing import NDArray

from uav_recon.localization.fusion.eskf import (
    Estimate,
    PoseNoise,
    innovation,
    propagate,
    propagate_mean,
    spread,
    update_estimate,
)
from uav_recon.localization.fusion.imu_integration import InertialTrack, Vector, exponential, logarithm, multiply
from uav_recon.localization.fusion.propagation_model import GYRO, INERTIAL, KINEMATIC

MOTION = FigureEight()
QUIET = PoseNoise(1e-9, 1e-9, 0.0, 0.0)
STEP = 1e-5


def _three(array: object) -> Vector:
    x, y, z = np.asarray(array, dtype=float).tolist()
    return (x, y, z)


def _track(until_s: float) -> InertialTrack:
    track = InertialTrack()
    for k in range(int(until_s * 200) + 1):
        sample = perfect_imu(MOTION, k)
        track.push(sample.stamp_s, _three(sample.gyro_radps), _three(sample.specific_force_mps2), (0.01, -0.02, 0.015))
    return track


def _moved(state: Estimate, e: NDArray[np.float64]) -> Estimate:
    """An error (15,) put on the state."""
    return state._replace(
        position_m=_three(np.add(state.position_m, e[:3])),
        velocity_mps=_three(np.add(state.velocity_mps, e[3:6])),
        odom_from_gyro=multiply(exponential(_three(e[6:9])), state.odom_from_gyro),
        gyro_bias_radps=_three(np.add(state.gyro_bias_radps, e[9:12])),
        offset_mps2=_three(np.add(state.offset_mps2, e[12:])),
    )


def _apart(a: Estimate, b: Estimate) -> NDArray[np.float64]:
    """The error (15,) of b, so that _moved(b, error) is a."""
    w, x, y, z = b.odom_from_gyro
    return np.concatenate(
        (
            np.subtract(a.position_m, b.position_m),
            np.subtract(a.velocity_mps, b.velocity_mps),
            logarithm(multiply(a.odom_from_gyro, (w, -x, -y, -z))),
            np.subtract(a.gyro_bias_radps, b.gyro_bias_radps),
            np.subtract(a.offset_mps2, b.offset_mps2),
        )
    )


@pytest.mark.parametrize("over_s", [0.02, 0.07, 0.5])
def test_the_covariance_goes_the_way_of_the_mean(over_s: float) -> None:
    track = _track(1.0 + over_s)
    base, here = track.at(MOTION.start_s + 1.0), track.at(MOTION.start_s + 1.0 + over_s)
    assert base
    assert here
    start = Estimate.at_rest(base, (1.0, 2.0, 3.0), exponential((0.1, -0.2, 0.7)), QUIET, INERTIAL)
    start = start._replace(velocity_mps=(0.3, -0.2, 0.1), gyro_bias_radps=(0.01, -0.02, 0.015))
    end = propagate_mean(start, base, here)
    columns = [_apart(propagate_mean(_moved(start, STEP * unit), base, here), end) / STEP for unit in np.eye(15)]
    jacobian = np.stack(columns, axis=1)
    noise = propagate(start._replace(covariance=np.zeros((15, 15))), base, here, QUIET).covariance
    for unit in np.eye(15):  # each error alone, so that none hides behind a larger one
        alone = start._replace(covariance=np.outer(unit, unit))
        carried = propagate(alone, base, here, QUIET).covariance - noise
        expected = jacobian @ alone.covariance @ jacobian.T
        np.testing.assert_allclose(carried, expected, atol=(1e-3 + 0.1 * over_s**2) * max(1.0, np.abs(expected).max()))


def test_carried_in_two_steps_or_in_one_the_noise_is_the_same() -> None:
    """White noise and random walks add up over time, whatever the intervals: to first order in the turning of the body."""
    track = _track(1.2)
    base, middle, here = (track.at(MOTION.start_s + s) for s in (1.0, 1.04, 1.08))
    assert base
    assert middle
    assert here
    noise = PoseNoise(1e-5, 1e-5, 1e-5, 1e-5)
    start = Estimate.at_rest(base, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0), noise, INERTIAL)
    once = propagate(start, base, here, noise).covariance
    twice = propagate(propagate(start, base, middle, noise), middle, here, noise).covariance
    np.testing.assert_allclose(np.diagonal(once), np.diagonal(twice), rtol=0.02)


def test_a_whirl_is_one_standard_deviation_of_attitude() -> None:
    track = _track(1.0)
    base = track.at(MOTION.start_s + 0.9)
    assert base
    calm = base._replace(stamp_s=base.stamp_s + 0.05)
    whirled = calm._replace(overrate_angle_rad=base.overrate_angle_rad + 0.2)
    start = Estimate.at_rest(base, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0), QUIET, INERTIAL)
    before, after = (propagate(start, base, here, QUIET).covariance.diagonal() for here in (calm, whirled))
    np.testing.assert_allclose(after - before, [*[0.0] * 6, *[0.04] * 3, *[0.0] * 6], atol=1e-12)


def test_a_pose_pulls_by_the_share_of_the_variances() -> None:
    """One number by hand: track 4 cm², pose 1 cm², 10 cm apart: 8 cm."""
    track = _track(0.1)
    base = track.at(MOTION.start_s + 0.05)
    assert base
    noise = PoseNoise(1e-4, 1e-4, 0.0, 0.0)
    state = Estimate.at_rest(base, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), noise, INERTIAL)
    state = state._replace(covariance=np.diag([4e-4] * 3 + [1.0] * 3 + [4e-4] * 3 + [1e-4] * 6))
    residual = innovation(state, base, (0.1, 0.0, 0.0), exponential((0.0, 0.0, 0.05)))
    np.testing.assert_allclose(residual, [0.1, 0.0, 0.0, 0.0, 0.0, 0.05], atol=1e-12)
    np.testing.assert_allclose(spread(state, noise), 5e-4 * np.eye(6), atol=1e-15)
    after = update_estimate(state, residual, noise)
    np.testing.assert_allclose(after.position_m, [0.08, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(logarithm(after.odom_from_body(base)), [0.0, 0.0, 0.04], atol=1e-9)
    np.testing.assert_allclose(np.diagonal(after.covariance)[:3], 0.8e-4)
    doubted = update_estimate(state, residual, noise, doubt=4.0)
    np.testing.assert_allclose(doubted.position_m, [0.05, 0.0, 0.0], atol=1e-12)


def test_a_change_of_the_model_forgets_what_has_another_meaning_in_it() -> None:
    track = _track(0.1)
    base = track.at(MOTION.start_s + 0.05)
    assert base
    state = Estimate.at_rest(base, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), QUIET, INERTIAL)
    state = state._replace(gyro_bias_radps=(0.1, 0.1, 0.1), offset_mps2=(0.2, 0.2, 0.2))
    assert state.propagated_by(INERTIAL) is state
    blind = state.propagated_by(KINEMATIC)
    assert blind.gyro_bias_radps == blind.offset_mps2 == (0.0, 0.0, 0.0)
    assert blind.covariance[9, 9] == KINEMATIC.bias_start**2 > 100 * INERTIAL.bias_start**2
    assert blind.covariance[12, 12] == KINEMATIC.offset_start**2
    np.testing.assert_array_equal(blind.covariance[:9, :9], state.covariance[:9, :9])
    weightless = state.propagated_by(GYRO)
    assert weightless.gyro_bias_radps == state.gyro_bias_radps
    assert weightless.offset_mps2 == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(weightless.covariance[:12, :12], state.covariance[:12, :12])


def test_noise_stays_within_reason_whatever_a_source_claims() -> None:
    for claimed in (0.0, 1e-12, 1e9):
        noise = PoseNoise.claimed(claimed * np.eye(6))
        assert 0.0015 < noise.position_m2**0.5 < 0.04
        assert 0.0004 < noise.attitude_rad2**0.5 < 0.05
