"""Rest on the pad: where down is, the gyro's bias, and what is no rest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uav_recon.localization.slam.rest_detection import RestDetector
from uav_recon.types.camera import ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

G_MPS2 = 9.80665
LEVEL_MPS2 = np.array([0.0, 0.0, G_MPS2])


def _fed(
    rate_radps: FloatArray, force_mps2: FloatArray, seconds: float = 0.8, rate_noise: float = 0.0, force_noise: float = 0.0
) -> RestDetector:
    rest, random = RestDetector(), np.random.default_rng(1)
    for n in range(round(seconds * 200) + 1):
        rate = rate_radps + rate_noise * random.standard_normal(3)
        rest.add([ImuSample(n / 200, rate, force_mps2 + force_noise * random.standard_normal(3))])
    return rest


@settings(max_examples=50, deadline=None)
@given(roll=st.floats(-3.0, 3.0), pitch=st.floats(-1.4, 1.4), yaw=st.floats(-3.0, 3.0), scale=st.floats(0.92, 1.08))
def test_gravity_shows_the_tilt_and_the_heading_is_zero(roll: float, pitch: float, yaw: float, scale: float) -> None:
    body = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    level = _fed(np.zeros(3), body.inv().apply(scale * LEVEL_MPS2), seconds=0.6).level(0.6)
    assert level is not None
    np.testing.assert_allclose(level.rotation(), Rotation.from_euler("ZYX", [0.0, pitch, roll]).as_matrix(), atol=1e-6)


def test_the_mean_turn_rate_of_the_rest_is_the_bias() -> None:
    bias = np.array([0.01, -0.02, 0.03])
    rest = _fed(bias, LEVEL_MPS2, rate_noise=0.02)
    assert rest.level(0.8) is not None
    np.testing.assert_allclose(rest.gyro_bias_radps, bias, atol=0.006)


@pytest.mark.parametrize(
    ("rate", "rate_noise", "force", "seconds"),
    [
        (0.0, 0.08, 1.0, 0.8),  # it shakes
        (0.12, 0.0, 1.0, 0.8),  # it turns
        (0.0, 0.0, 0.89, 0.8),  # it falls, or the sensor is wrong
        (0.0, 0.0, 1.11, 0.8),
        (0.0, 0.0, 1.0, 0.45),  # it has rested for a moment only
        (math.nan, 0.0, 1.0, 0.8),
        (0.0, 0.0, math.nan, 0.8),
    ],
)
def test_motion_is_no_rest(rate: float, rate_noise: float, force: float, seconds: float) -> None:
    rest = _fed(np.array([0.0, 0.0, rate]), force * LEVEL_MPS2, seconds=seconds, rate_noise=rate_noise)
    assert rest.level(seconds) is None
    np.testing.assert_array_equal(rest.gyro_bias_radps, np.zeros(3))


@pytest.mark.parametrize(("rate", "rate_noise", "force"), [(0.09, 0.0, 1.0), (0.0, 0.04, 1.0), (0.0, 0.0, 0.91)])
def test_a_rest_within_the_limits_is_one(rate: float, rate_noise: float, force: float) -> None:
    assert _fed(np.array([0.0, 0.0, rate]), force * LEVEL_MPS2, rate_noise=rate_noise).level(0.8) is not None


def test_the_rest_after_a_motion_counts() -> None:
    rest = _fed(np.array([0.0, 0.0, 0.5]), LEVEL_MPS2)
    rest.add([ImuSample(0.8 + n / 200, np.zeros(3), LEVEL_MPS2) for n in range(1, 100)])
    assert rest.level(1.3) is None
    rest.add([ImuSample(1.3 + n / 200, np.zeros(3), LEVEL_MPS2) for n in range(1, 101)])
    assert rest.level(1.8) is not None


def test_without_inertial_samples_the_body_is_level_after_a_while() -> None:
    rest = RestDetector()
    assert rest.level(5.0) is None
    assert rest.level(5.2) is None
    level = rest.level(5.3)
    assert level is not None
    np.testing.assert_array_equal(level.rotation(), np.eye(3))


def test_a_body_with_its_motors_off_is_still() -> None:
    bias = np.array([0.0, 0.03, 0.0])
    rest = _fed(bias, LEVEL_MPS2, rate_noise=0.005, force_noise=0.05)
    assert not rest.still(0.8), "the bias is not known yet"
    assert rest.level(0.8) is not None
    assert rest.still(0.8)
    assert not rest.still(1.2), "no sample is new"


@pytest.mark.parametrize(("rate", "rate_noise", "force_noise"), [(0.03, 0.0, 0.0), (0.0, 0.07, 0.0), (0.0, 0.0, 0.4)])
def test_motors_that_run_or_a_turn_end_the_rest(rate: float, rate_noise: float, force_noise: float) -> None:
    rest = _fed(np.array([0.0, 0.0, rate]), LEVEL_MPS2, rate_noise=rate_noise, force_noise=force_noise)
    assert not rest.still(0.8)


@pytest.mark.parametrize(
    ("lift_mps2", "rate_radps", "stands"), [(0.0, 0.0, True), (0.3, 0.0, True), (0.9, 0.0, False), (0.0, 0.04, False)]
)
def test_a_body_whose_motors_run_stands_until_it_lifts(lift_mps2: float, rate_radps: float, stands: bool) -> None:
    """The specific force shakes by 0.6 m/s² about that of the rest; 60 samples a second, as a camera's."""
    tilted = Rotation.from_euler("Y", 0.1).inv().apply(LEVEL_MPS2)
    rest, random = _fed(np.zeros(3), tilted, rate_noise=0.002, force_noise=0.03), np.random.default_rng(2)
    assert rest.level(0.8) is not None
    answers = []
    for n in range(180):
        shaken = tilted + np.array([0.0, 0.0, lift_mps2]) + 0.6 * random.standard_normal(3)
        rest.add([ImuSample(0.8 + n / 60, np.array([rate_radps, 0.0, 0.0]) + 0.01 * random.standard_normal(3), shaken)])
        answers.append(rest.still(0.8 + n / 60))
    assert np.mean(answers) > 0.95 if stands else not any(answers[30:])


def test_nothing_is_still_without_inertial_samples() -> None:
    assert not RestDetector().still(1.0)


def test_what_the_accelerometer_measures_beside_gravity_at_rest() -> None:
    bias = np.array([0.1, -0.05, 0.02])
    rest = _fed(np.zeros(3), LEVEL_MPS2 + bias)
    assert rest.level(0.8) is not None
    np.testing.assert_allclose(rest.force_offset_mps2(Pose.identity()), bias, atol=0.005)
    np.testing.assert_array_equal(RestDetector().force_offset_mps2(Pose.identity()), np.zeros(3))
