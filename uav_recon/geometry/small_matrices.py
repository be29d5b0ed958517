"""Small matrices in kernels: products, linear equations, and eigenvalues of symmetric ones.

A call of numpy or LAPACK costs more than the arithmetic of a matrix of a few rows.
Golub and Van Loan 2013, Matrix Computations: Gauss with partial pivoting, Jacobi's method.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray

_SWEEPS = 12  # of Jacobi's method; it converges quadratically, 3 x 3 in four or five
_NEGLIGIBLE = 1e-30  # squared, of the elements beside the diagonal against those on it


@kernel
def product(one: AnyArray, other: AnyArray) -> AnyArray:
    """Return the product (N, K) of two matrices (N, M), (M, K)."""
    out = np.zeros((one.shape[0], other.shape[1]))
    for a in range(one.shape[0]):
        for c in range(one.shape[1]):
            for b in range(other.shape[1]):
                out[a, b] += one[a, c] * other[c, b]
    return out


@kernel
def solve_in_place(matrix: AnyArray, right: AnyArray) -> None:
    """Replace the right sides (N, K) of linear equations by their solutions.

    The matrix (N, N) must be regular, and is overwritten.
    """
    size = matrix.shape[0]
    for a in range(size):
        most = a + int(np.argmax(np.abs(matrix[a:, a])))
        _swap_rows(matrix, a, most)
        _swap_rows(right, a, most)
        for b in range(a + 1, size):
            share = matrix[b, a] / matrix[a, a]
            _subtract_row(matrix, b, a, share)
            _subtract_row(right, b, a, share)
    for a in range(size - 1, -1, -1):
        for b in range(a + 1, size):
            _subtract_row(right, a, b, matrix[a, b])
        right[a] /= matrix[a, a]


@kernel
def _swap_rows(matrix: AnyArray, a: int, b: int) -> None:
    for c in range(matrix.shape[1]):
        matrix[a, c], matrix[b, c] = matrix[b, c], matrix[a, c]


@kernel
def _subtract_row(matrix: AnyArray, a: int, b: int, share: float) -> None:
    """Subtract a share of row b from row a."""
    for c in range(matrix.shape[1]):
        matrix[a, c] -= share * matrix[b, c]


@kernel
def symmetric_eigen(matrix: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return the eigenvalues (N,) of a symmetric matrix (N, N), smallest first.

    And the eigenvectors in columns (N, N).
    """
    size = matrix.shape[0]
    left, vectors = matrix.copy(), np.eye(size)
    for _ in range(_SWEEPS):
        beside = along = 0.0
        for a in range(size):
            along += left[a, a] * left[a, a]
            for b in range(a):
                beside += left[a, b] * left[a, b]
        if beside <= _NEGLIGIBLE * along:
            break
        for a in range(size):
            for b in range(a):
                if left[a, b] != 0.0:
                    _rotate(left, vectors, a, b)
    values = np.empty(size)
    for a in range(size):
        values[a] = left[a, a]
    order = np.argsort(values)
    return values[order], vectors[:, order]


@kernel
def _rotate(left: AnyArray, vectors: AnyArray, a: int, b: int) -> None:
    """Turn the axes a and b of a symmetric matrix (N, N) so that its element there becomes zero."""
    half = 0.5 * (left[b, b] - left[a, a]) / left[a, b]
    tangent = (1.0 if half >= 0.0 else -1.0) / (abs(half) + np.sqrt(half * half + 1.0))
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    for c in range(left.shape[0]):
        one, other = left[c, a], left[c, b]
        left[c, a], left[c, b] = cosine * one - sine * other, sine * one + cosine * other
    for c in range(left.shape[0]):
        one, other = left[a, c], left[b, c]
        left[a, c], left[b, c] = cosine * one - sine * other, sine * one + cosine * other
        one, other = vectors[c, a], vectors[c, b]
        vectors[c, a], vectors[c, b] = cosine * one - sine * other, sine * one + cosine * other
