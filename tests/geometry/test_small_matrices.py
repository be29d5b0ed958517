"""Kernels of small matrices against numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.geometry.small_matrices import product, solve_in_place, symmetric_eigen
from uav_recon.types.frames import FloatArray


def _random(shape: tuple[int, ...], seed: int) -> FloatArray:
    """Return numbers of very different sizes."""
    random = np.random.default_rng(seed)
    return np.asarray(random.standard_normal(shape) * 10.0 ** random.uniform(-3.0, 3.0, shape))


@settings(max_examples=60, deadline=None)
@given(size=st.integers(1, 8), others=st.integers(1, 5), seed=st.integers(0, 10**6))
def test_products_and_solutions_are_those_of_numpy(size: int, others: int, seed: int) -> None:
    matrix, right = _random((size, size), seed), _random((size, others), seed + 1)
    np.testing.assert_allclose(product(matrix, right), matrix @ right, rtol=1e-9, atol=1e-9 * np.abs(matrix @ right).max())
    left, solution = matrix.copy(), right.copy()
    solve_in_place(left, solution)
    spread = np.abs(matrix) @ np.abs(solution)
    np.testing.assert_allclose(matrix @ solution, right, atol=float(1e-11 * (spread.max() + np.abs(right).max())))


def test_a_zero_on_the_diagonal_is_no_pivot() -> None:
    right = np.array([[2.0], [3.0]])
    solve_in_place(np.array([[0.0, 1.0], [1.0, 0.0]]), right)
    np.testing.assert_array_equal(right, [[3.0], [2.0]])


@settings(max_examples=60, deadline=None)
@given(size=st.integers(1, 6), rank=st.integers(1, 6), seed=st.integers(0, 10**6))
def test_eigenvalues_are_those_of_numpy(size: int, rank: int, seed: int) -> None:
    root = _random((size, min(rank, size)), seed)
    matrix = root @ root.T
    values, vectors = symmetric_eigen(matrix)
    expected = np.linalg.eigvalsh(matrix)
    np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-12 * expected[-1])
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(size), atol=1e-12)
    np.testing.assert_allclose((vectors * values) @ vectors.T, matrix, atol=1e-12 * expected[-1])


@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_equal_eigenvalues_have_the_axes_as_they_are(scale: float) -> None:
    values, vectors = symmetric_eigen(scale * np.eye(3))
    np.testing.assert_array_equal(values, np.full(3, scale))
    np.testing.assert_array_equal(vectors, np.eye(3))
