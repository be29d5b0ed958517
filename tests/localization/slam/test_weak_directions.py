"""Weak directions: the kernels against plain numpy, on random equations and on depth of a rendered room."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from test_depth_points import HERE, compared

from uav_recon.localization.slam.depth_points import add_depth_equations
from uav_recon.localization.slam.weak_directions import (
    TriedDepth,
    add_noise,
    leave_edges,
    leave_weak_directions,
    noise_of_normals,
)
from uav_recon.types.frames import FloatArray

PLACE = slice(3, 6)
TURN_SIGMA_RAD, TRIED_M, SHARE = 0.01, 0.04, 0.3


def _equations(most: int, seed: int, weak: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Return information (M, 8, 8) and gradient (M, 8), of places with one direction less well known by a factor."""
    random = np.random.default_rng(seed)
    rows = 30.0 * random.standard_normal((most, 20, 8))
    axes = np.linalg.qr(random.standard_normal((3, 3)))[0]
    rows[:, :, PLACE] = rows[:, :, PLACE] @ (axes * np.array([weak, 1.0, 1.0])) @ axes.T
    return np.swapaxes(rows, 1, 2) @ rows, 100.0 * random.standard_normal((most, 8))


def _noise_added(information: FloatArray, gradient: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    place = information[:, PLACE, PLACE]
    gain = information[:, :, PLACE] @ noise @ np.linalg.inv(np.eye(3) + place @ noise)
    return information - gain @ information[:, PLACE], gradient - np.einsum("mab,mb->ma", gain, gradient[:, PLACE])


def _alone(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    turn = information[:3, :3] + np.eye(3) * TURN_SIGMA_RAD**-2
    alone = information[PLACE, PLACE] - information[PLACE, :3] @ np.linalg.inv(turn) @ information[:3, PLACE]
    values, axes = np.linalg.eigh(alone)
    return np.asarray(values, dtype=np.float64), np.asarray(axes, dtype=np.float64)


def _noise(values: FloatArray, left: FloatArray, axes: FloatArray) -> FloatArray:
    return np.asarray(axes * np.minimum(1.0 / np.maximum(left, 1e-9) - 1.0 / np.maximum(values, 1e-9), 100.0)) @ axes.T


@pytest.mark.parametrize("size_m2", [1e-6, 1.0, 100.0])
def test_noise_of_a_place_is_an_unknown_that_is_eliminated(size_m2: float) -> None:
    information, gradient = _equations(3, 1)
    noise = size_m2 * np.array([np.eye(3), np.diag([1.0, 0.0, 0.0]), np.zeros((3, 3))])
    expected = _noise_added(information, gradient, noise)
    add_noise(information, gradient, noise)
    np.testing.assert_allclose(information, expected[0], atol=1e-7 * np.abs(expected[0]).max())
    np.testing.assert_allclose(gradient, expected[1], atol=1e-7 * np.abs(expected[1]).max())


@pytest.mark.parametrize("weak", [1.0, 0.1, 1e-3])
@pytest.mark.parametrize("support", [1.0, 1e-3])
def test_weak_directions_are_left(weak: float, support: float) -> None:
    information, gradient = _equations(3, 2, weak)
    values, axes = _alone(information.sum(axis=0))
    left = np.maximum(values - max(0.005 * values[-1], support * 0.03**-2), 0.0)
    expected = _noise_added(information, gradient, np.tile(_noise(values, left, axes), (3, 1, 1)))
    sigma_m = leave_weak_directions(information, gradient, TURN_SIGMA_RAD, support)
    assert sigma_m == pytest.approx(1.0 / np.sqrt(max(left[0], 1e-9)))
    np.testing.assert_allclose(information, expected[0], atol=1e-6 * np.abs(expected[0]).max())
    np.testing.assert_allclose(gradient, expected[1], atol=1e-6 * np.abs(expected[1]).max())


@pytest.mark.parametrize("weak", [1.0, 1e-2])
def test_directions_along_edges_are_left(weak: float) -> None:
    information, gradient = _equations(2, 3, weak)
    shown = np.tile(2e4 * np.eye(3) + 1e3, (2, 1, 1))
    shown[1] = 0.0  # a keyframe without landmarks
    was, slope = information[0].copy(), gradient[0].copy()
    root = np.linalg.inv(np.linalg.cholesky(shown[0] + np.eye(3)))
    shares, axes = np.linalg.eigh(root @ was[PLACE, PLACE] @ root.T)
    along = root.T @ axes[:, shares < 0.05]
    assert along.shape[1] == int(weak < 1.0)
    kept = np.eye(8)
    kept[PLACE, PLACE] -= along @ along.T @ (shown[0] + np.eye(3))
    others = information[1].copy()
    leave_edges(information, gradient, shown)
    np.testing.assert_allclose(information[0], kept.T @ was @ kept, atol=1e-9 * was.max())
    np.testing.assert_allclose(gradient[0], slope @ kept, atol=1e-9 * np.abs(slope).max())
    np.testing.assert_array_equal(information[1], others)


def _plain_noise(
    information: FloatArray, leaning: FloatArray, pull_at: Callable[[FloatArray], FloatArray] | None
) -> FloatArray:
    """Return the noise (M, 3, 3) by normals. pull_at: gradient (M, 3) on the place from places farther by (M, 3)."""
    found = [_alone(each) for each in information]
    values, axes = np.array([each[0] for each in found]), np.array([each[1] for each in found])
    left = np.maximum(values, 0.0)
    for k in range(2):
        weak = values[:, k] < 0.1 * values[:, -1]
        if pull_at is not None and weak.any():
            ahead_m = TRIED_M * axes[:, :, k]
            there, back = (np.einsum("ma,ma->m", pull_at(side * ahead_m), ahead_m) for side in (1.0, -1.0))
            left[:, k] = np.where(weak, np.clip(np.minimum(-there, back) / TRIED_M**2, 0.0, left[:, k]), left[:, k])
    each = zip(values, left, axes, leaning, strict=True)
    return np.array([_noise(*three) + lean * np.eye(3) for *three, lean in each])


@pytest.mark.parametrize("tried", [True, False])
@pytest.mark.parametrize("one", [0, 1])
def test_the_noise_of_normals_is_what_does_not_pull_back(tried: bool, one: int) -> None:
    """Of one keyframe at a time: what two share depends on the signs of their directions."""
    points, every = compared()
    keyframes = every._replace(
        **{name: getattr(every, name)[one : one + 1] for name in ("number", "camera", "rotation", "place_m", "variance")}
    )
    rotation, place_m, doubt = HERE.rotation(), HERE.translation_m, np.zeros((1, 3, 3))
    information, leaning = np.zeros((1, 8, 8)), np.array([0.002])
    add_depth_equations(points, rotation, place_m, keyframes, doubt, SHARE, 1.0, information, np.zeros((1, 8)))
    axes = _alone(information[0])[1]
    kept = np.eye(8)
    kept[PLACE, PLACE] -= np.outer(axes[:, 0], axes[:, 0]) * 0.9  # as of a bare wall
    information[0] = kept.T @ information[0] @ kept

    def pull_at(ahead_m: FloatArray) -> FloatArray:
        away, there = keyframes._replace(place_m=keyframes.place_m - ahead_m), np.zeros((1, 8))
        add_depth_equations(points, rotation, place_m, away, doubt, SHARE, 4.0, np.zeros((1, 8, 8)), there)
        return there[:, PLACE]

    out = np.zeros((1, 3, 3))
    depth = TriedDepth(points, rotation, place_m, keyframes, doubt, SHARE)
    noise_of_normals(information, leaning, TURN_SIGMA_RAD, depth, tried, out)
    expected = _plain_noise(information, leaning, pull_at if tried else None)
    np.testing.assert_allclose(out, expected, rtol=1e-6, atol=1e-9)
