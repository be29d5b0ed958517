"""Measures of an uncertainty's ranking of errors: AUSE and Spearman's rank correlation.

AUSE is the area under the sparsification error (Ilg et al. 2018, section 5). Sparsification removes the most uncertain
points, more and more of them, and computes the mean error of the rest. The best possible curve ranks by the error itself.
Both curves are divided by the mean error of all points.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import rankdata

from uav_recon.types.frames import FloatArray


def ause(error: FloatArray, uncertainty: FloatArray) -> float | None:
    """Return the area between the two curves; 0 = a perfect ranking.

    None if there is no error at all. A random ranking has 1 minus the area under the best curve.

    error: (N,) not negative.
    uncertainty: (N,) higher = less certain.
    """
    if len(error) == 0 or not error.sum() > 0.0:
        return None
    return float((remaining(error, uncertainty) - remaining(error, error)).mean() / error.mean())


def remaining(error: FloatArray, rank: FloatArray) -> FloatArray:
    """Return the mean error (N,) after removing the 0, 1, ... N - 1 points of highest rank.

    Points of equal rank are removed in equal shares.
    """
    order = np.argsort(rank, kind="stable")
    level = np.unique(rank[order], return_inverse=True)[1]
    shared = (np.bincount(level, error[order]) / np.bincount(level))[level]  # equal ranks define no order among themselves
    kept: FloatArray = np.cumsum(shared)[::-1] / np.arange(len(error), 0, -1)
    return kept


def spearman(error: FloatArray, uncertainty: FloatArray) -> float | None:
    """Return the rank correlation; 1 = the same order. None if either input is constant."""
    if len(error) < 2:
        return None
    a, b = rankdata(error), rankdata(uncertainty)
    a, b = a - a.mean(), b - b.mean()
    spread = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / spread if spread > 0.0 else None
