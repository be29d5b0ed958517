"""One axis against filterpy's filter of three, with its (9, 9) matrices."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from uav_recon.localization.kalman import Spread

THREE = np.eye(3)


def oracle(spread: Spread) -> KalmanFilter:
    kalman = KalmanFilter(dim_x=9, dim_z=3)
    kalman.H = np.hstack([THREE, np.zeros((3, 6))])
    kalman.P = np.kron(matrix(spread), THREE)
    return kalman


def matrix(s: Spread) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.array([[s.pp, s.pv, s.pb], [s.pv, s.vv, s.vb], [s.pb, s.vb, s.bb]])


def noise(dt: float, a: float, b: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Q by numerical integration of what white noise on v and b does until the end of the step."""
    left = (np.arange(4000) + 0.5) * dt / 4000
    by_a = np.stack([left, np.ones_like(left), np.zeros_like(left)])
    by_b = np.stack([0.5 * left**2, left, np.ones_like(left)])
    return np.asarray((a**2 * by_a @ by_a.T + b**2 * by_b @ by_b.T) * dt / 4000)


@pytest.mark.parametrize("dt", [0.004, 0.066, 0.4])
@pytest.mark.parametrize(("a", "b"), [(0.01, 0.03), (0.1, 1.2)])
def test_a_run_of_steps_agrees_with_filterpy(dt: float, a: float, b: float) -> None:
    rng = np.random.default_rng(3)
    spread, mean = Spread(1e-4, 0.0, 0.0, 0.25, 0.0, 0.04), np.zeros((3, 3))  # rows: position, velocity, offset
    kalman = oracle(spread)
    step = np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    for _ in range(40):
        place, variance = rng.normal(0, 1, 3), float(rng.uniform(4e-6, 9e-4))
        kalman.predict(F=np.kron(step, THREE), Q=np.kron(noise(dt, a, b), THREE))
        kalman.update(place, R=variance * THREE)
        spread, mean = spread.carried(dt, a, b), step @ mean
        mean = mean + np.outer(spread.gains(variance), place - mean[0])
        spread = spread.corrected(variance)
        np.testing.assert_allclose(np.kron(matrix(spread), THREE), kalman.P, rtol=1e-5, atol=1e-12)
        np.testing.assert_allclose(mean.ravel(), kalman.x.ravel(), rtol=1e-5, atol=1e-8)
        assert np.linalg.eigvalsh(matrix(spread)).min() > 0.0


def test_a_forgotten_offset_hangs_on_nothing() -> None:
    spread = Spread(1.0, 0.5, 0.4, 2.0, 0.3, 0.2).offset_unknown()
    assert spread == Spread(1.0, 0.5, 0.0, 2.0, 0.0, 1.0)
