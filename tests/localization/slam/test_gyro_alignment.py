"""Delay of the frames and bias of the gyro, from the turns that images show."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uav_recon.localization.slam.gyro_alignment import GyroAlignment
from uav_recon.types.camera import ImuSample
from uav_recon.types.frames import FloatArray

PERIOD_S = 1.0 / 15.0
BIAS_RADPS = np.array([0.004, -0.006, 0.005])
HOVER_MPS2 = np.array([0.0, 0.0, 9.80665])

Attitude = Callable[[FloatArray], Rotation]


def _turning(t: FloatArray) -> Rotation:
    """Attitude at times (N,): turns and tilts that begin and end."""
    yaw = 1.2 * np.sin(0.9 * t) + 0.3 * np.sin(2.1 * t)
    return Rotation.from_euler("ZYX", np.stack((yaw, 0.12 * np.sin(1.7 * t), 0.10 * np.sin(1.3 * t + 1.0)), axis=1))


def _spinning(t: FloatArray) -> Rotation:
    """A turn of constant rate."""
    return Rotation.from_euler("ZYX", np.stack((0.8 * t, 0.0 * t, 0.0 * t), axis=1))


def _samples(attitude: Attitude, seconds: float, bias: FloatArray, from_s: float = -0.2) -> list[ImuSample]:
    stamps = np.arange(from_s, seconds, 0.005)
    half_s = 5e-4
    rate = (attitude(stamps - half_s).inv() * attitude(stamps + half_s)).as_rotvec() / (2 * half_s)
    return [ImuSample(stamp, row, HOVER_MPS2) for stamp, row in zip(stamps.tolist(), rate + bias, strict=True)]


def _aligned(attitude: Attitude, delay_s: float, bias: FloatArray, seconds: float = 20.0, outlier: int = 0) -> GyroAlignment:
    """Frames from attitudes of ``delay_s`` before their stamps, with 1 mrad of noise. outlier: the period of wrong ones."""
    gyro, random = GyroAlignment(), np.random.default_rng(3)
    gyro.add(_samples(attitude, seconds, bias))
    stamps = np.arange(0.0, seconds - 0.1, PERIOD_S)
    shown = attitude(stamps - delay_s)
    turned = (shown[:-1].inv() * shown[1:]).as_rotvec() + 1e-3 * random.standard_normal((len(stamps) - 1, 3))
    for n, row in enumerate(turned):
        wrong = 0.15 * random.standard_normal(3) if outlier and n % outlier == outlier - 1 else np.zeros(3)
        gyro.update(stamps[n], stamps[n + 1], row + wrong)
    return gyro


@pytest.mark.parametrize("delay_s", [0.0, 0.012, 0.025, 0.04])
def test_delay_and_bias_show_in_turns(delay_s: float) -> None:
    gyro = _aligned(_turning, delay_s, BIAS_RADPS)
    assert gyro.delay_s == pytest.approx(delay_s, abs=0.003)
    assert gyro.delay_sigma_s < 0.004
    np.testing.assert_allclose(gyro.bias_radps, BIAS_RADPS, atol=0.0015)


def test_a_constant_turn_shows_no_delay() -> None:
    gyro = _aligned(_spinning, 0.03, np.zeros(3))
    assert gyro.delay_s == pytest.approx(0.0, abs=0.005)
    assert gyro.delay_sigma_s > 0.018


def test_a_camera_whose_mount_is_off_turns_about_other_axes() -> None:
    """Pitch and roll of the mount show in turns of the heading; its own heading shows in tilts only."""
    off = Rotation.from_rotvec([0.015, -0.01, 0.0])
    gyro, stamps = GyroAlignment(), np.arange(0.0, 19.9, PERIOD_S)
    gyro.add(_samples(_turning, 20.0, np.zeros(3)))
    shown, random = _turning(stamps) * off.inv(), np.random.default_rng(4)
    turned = (shown[:-1].inv() * shown[1:]).as_rotvec() + 1e-3 * random.standard_normal((len(stamps) - 1, 3))
    for n, row in enumerate(turned):
        gyro.update(stamps[n], stamps[n + 1], row)
    found = gyro.turn(1.0, 2.2)
    assert found is not None
    ends = _turning(np.array([1.0, 2.2])) * off.inv()
    np.testing.assert_allclose(found, (ends[0].inv() * ends[1]).as_rotvec(), atol=0.003)


def test_wrong_turns_are_left_out() -> None:
    gyro = _aligned(_turning, 0.02, BIAS_RADPS, outlier=6)
    assert gyro.delay_s == pytest.approx(0.02, abs=0.004)
    np.testing.assert_allclose(gyro.bias_radps, BIAS_RADPS, atol=0.002)


def test_the_delay_is_bounded() -> None:
    gyro = _aligned(_turning, 0.3, np.zeros(3), seconds=8.0)
    assert abs(gyro.delay_s) <= 0.08


def test_a_rest_gives_the_bias_at_once() -> None:
    gyro = GyroAlignment()
    gyro.add(_samples(_turning, 2.0, BIAS_RADPS))
    gyro.rest(BIAS_RADPS)
    turned = gyro.turn(0.5, 1.5)
    assert turned is not None
    ends = _turning(np.array([0.5, 1.5]))
    np.testing.assert_allclose(turned, (ends[0].inv() * ends[1]).as_rotvec(), atol=0.003)
    rate = gyro.rate(1.0)
    assert rate is not None
    np.testing.assert_allclose(
        rate, (_turning(np.array([0.98])).inv() * _turning(np.array([1.0]))).as_rotvec()[0] / 0.02, atol=0.01
    )


def test_what_the_samples_do_not_cover_is_unknown() -> None:
    gyro, samples = GyroAlignment(), _samples(_turning, 2.0, np.zeros(3), from_s=0.0)
    assert gyro.turn(0.0, 0.1) is None
    gyro.add([sample for sample in samples if not 0.8 < sample.stamp_s < 1.0])
    covered = [(0.1, 0.7), (1.1, 1.9)]
    gaps = [(-0.1, 0.3), (0.7, 0.9), (0.85, 0.95), (0.9, 1.2), (0.5, 1.5), (1.9, 2.2)]
    for a, b in covered:
        assert gyro.turn(a, b) is not None, (a, b)
        assert gyro.track(a, b) is not None, (a, b)
    for a, b in gaps:
        assert gyro.turn(a, b) is None, (a, b)
        assert gyro.track(a, b) is None, (a, b)
    assert gyro.rate(0.9) is None
    assert gyro.rate(0.5) is not None
    before = gyro.bias_radps
    gyro.update(0.7, 0.9, np.full(3, 0.01))
    np.testing.assert_array_equal(gyro.bias_radps, before)


def test_samples_that_are_older_or_not_finite_are_dropped() -> None:
    gyro, samples = GyroAlignment(), _samples(_turning, 1.0, np.zeros(3))
    gyro.add(samples)
    expected = gyro.turn(0.2, 0.8)
    bad = [ImuSample(1.01, np.array([np.nan, 0.0, 0.0]), HOVER_MPS2), ImuSample(1.01, np.zeros(3), np.full(3, np.inf))]
    gyro.add([*samples[:50], *bad])
    assert expected is not None
    np.testing.assert_array_equal(gyro.turn(0.2, 0.8), expected)
    assert gyro.turn(0.2, 1.04) is not None
    assert gyro.turn(0.2, 1.06) is None


def test_the_turn_is_less_certain_where_the_body_turns_fast() -> None:
    gyro = GyroAlignment()
    gyro.add(_samples(_spinning, 2.0, np.zeros(3)))
    still = GyroAlignment()
    still.add([ImuSample(0.005 * n, np.zeros(3), HOVER_MPS2) for n in range(400)])
    assert gyro.turn_sigma_rad(1.0, 1.067) > 2.0 * still.turn_sigma_rad(1.0, 1.067)


def test_turn_rates_without_forces_carry_no_motion() -> None:
    gyro, samples = GyroAlignment(), _samples(_turning, 1.0, np.zeros(3))
    gyro.add([sample for sample in samples if sample.stamp_s < 0.5])
    gyro.add([ImuSample(s.stamp_s, s.gyro_radps, np.full(3, np.nan)) for s in samples if s.stamp_s >= 0.5])
    assert gyro.between(0.2, 0.4) is None
    assert gyro.turned(0.2, 0.9) is not None
    late = GyroAlignment()
    late.add(samples)
    newest_s = samples[-1].stamp_s
    late.add([ImuSample(newest_s + 0.1, np.zeros(3), np.full(3, np.nan))])
    assert late.between(newest_s + 0.11, newest_s + 0.12) is None
    assert late.at(newest_s + 0.11) is None
