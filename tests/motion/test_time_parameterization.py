"""The fastest pass against what can be worked out by hand, and against scipy's linear programming."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from uav_recon.motion.time_parameterization import PER_SPAN, Curve, fastest, node_times, smoothed
from uav_recon.types.frames import FloatArray

FREE = np.full(1000, np.inf)  # no silence that limits it


def straight_band(metres: float, spans: int) -> FloatArray:
    control = np.zeros((spans + 3, 5))
    control[:, 0] = np.arange(-1, spans + 2) * metres / spans
    return control


def test_a_straight_line_is_passed_in_bang_bang_time() -> None:
    curve = Curve.of(straight_band(6.0, 40))
    cap, x, times = np.full(len(curve.along_m), (1.0 / 0.15) ** 2), np.empty(len(curve.along_m)), np.empty(len(curve.along_m))
    assert fastest(curve.slope, curve.bend, cap, FREE[: len(cap)], np.full(len(cap), 1.2), 1.5, 0.0, x)
    node_times(x, times)
    np.testing.assert_allclose(times[-1], 6.0 / 1.0 + 1.0 / 1.2, rtol=1e-3)
    np.testing.assert_allclose(curve.along_m[-1], 6.0)


def test_a_circle_is_passed_at_the_root_of_acceleration_times_radius() -> None:
    angle = np.arange(-1, 42) * 0.15
    control = np.zeros((43, 5))
    control[:, :2] = 1.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    curve = Curve.of(control)
    cap, x = np.full(len(curve.along_m), 1e3), np.empty(len(curve.along_m))
    assert fastest(curve.slope, curve.bend, cap, FREE[: len(cap)], np.full(len(cap), 0.6), 1.5, 0.0, x)
    speed = np.sqrt(x) * np.linalg.norm(curve.slope[:, :3], axis=1)
    np.testing.assert_allclose(speed.max(), np.sqrt(0.6 * 1.0), rtol=0.01)


def test_what_is_entered_too_fast_is_told() -> None:
    curve = Curve.of(straight_band(0.3, 2))
    cap, x = np.full(len(curve.along_m), 40.0), np.empty(len(curve.along_m))
    length_m = 0.15  # of a span
    just = 2 * 1.2 * 0.3 / length_m**2
    assert fastest(curve.slope, curve.bend, cap, FREE[: len(cap)], np.full(len(cap), 1.2), 1.5, 0.99 * just, x)
    np.testing.assert_allclose(x[0], 0.99 * just)
    assert not fastest(curve.slope, curve.bend, cap, FREE[: len(cap)], np.full(len(cap), 1.2), 1.5, 1.01 * just, x)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), turning=st.booleans(), back=st.booleans())
def test_no_pass_is_faster(seed: int, turning: bool, back: bool) -> None:
    """In one coordinate all bounds are linear in x and its slope, and the sum of x is greatest for the fastest pass.

    Where the curve turns back the greedy pass may come in too fast and lose a little; the bounds hold all the same.
    """
    rng = np.random.default_rng(seed)
    column, bound = (3, 1.5) if turning else (0, 1.2)
    control = np.zeros((11, 5))
    control[:, column] = np.cumsum(rng.normal(0.05, 0.1, 11) if back else rng.uniform(0.04, 0.25, 11))
    curve = Curve.of(control)
    count = len(curve.along_m)
    cap, x = rng.uniform(5, 50, count), np.empty(count)
    assert fastest(curve.slope, curve.bend, cap, FREE[: len(cap)], np.full(len(cap), 1.2), 1.5, 0.0, x)
    slope, bend = curve.slope[:-1, column], curve.bend[:-1, column]
    row = np.zeros((count - 1, count))
    n = np.arange(count - 1)
    row[n, n] = bend - slope * PER_SPAN / 2
    row[n, n + 1] += slope * PER_SPAN / 2
    assert np.all(np.abs(row @ x) <= bound * (1 + 1e-3) + 1e-6)
    assert np.all(x <= cap * (1 + 1e-9)) and x[0] == x[-1] == 0.0
    cap[[0, -1]] = 0.0
    limits = np.full(2 * count - 2, bound)
    best = linprog(-np.ones(count), np.vstack([row, -row]), limits, bounds=list(zip(0 * cap, cap, strict=True)))
    assert best.success
    assert back or x.sum() >= 0.995 * -best.fun


@pytest.mark.parametrize("box", [1, 3, 11])
def test_smoothing_is_numpys_average_twice(box: int) -> None:
    samples = np.random.default_rng(1).normal(size=(60, 2))
    out = np.empty((60 - 2 * box + 2, 2))
    smoothed(samples, box, out)
    weights = np.convolve(np.ones(box) / box, np.ones(box) / box)
    for d in range(2):
        np.testing.assert_allclose(out[:, d], np.convolve(samples[:, d], weights, "valid"), atol=1e-12)
