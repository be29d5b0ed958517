"""Whether an uncertainty ranks errors: the area under the sparsification error, and Spearman's rank correlation.

Sparsification (Ilg et al. 2018, section 5): leave out the most uncertain points, ever more of them, and watch the mean error
of those that remain; beside it the best that any ranking could do, by the error itself. Both over the mean error of all.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import rankdata

from uav_recon.types.frames import FloatArray


def ause(error: FloatArray, uncertainty: FloatArray) -> float | None:
    """Area between the two curves, 0 = a perfect ranking; a random one gives 1 less the best curve's area. None if there is
    no error at all. error (N,) not negative, uncertainty (N,) higher = worse known.
    """  # fmt: skip
    if len(error) == 0 or not error.sum() > 0.0:
        return None
    return float((remaining(error, uncertainty) - remaining(error, error)).mean() / error.mean())


def remaining(error: FloatArray, rank: FloatArray) -> FloatArray:
    """Mean error (N,) of what is left after leaving out the 0, 1, ... N - 1 points of highest rank; ties share alike."""
    order = np.argsort(rank, kind="stable")
    level = np.unique(rank[order], return_inverse=True)[1]
    shared = (np.bincount(level, error[order]) / np.bincount(level))[level]  # equal ranks say nothing of who goes first
    kept: FloatArray = np.cumsum(shared)[::-1] / np.arange(len(error), 0, -1)
    return kept


def spearman(error: FloatArray, uncertainty: FloatArray) -> float | None:
    """Rank correlation, 1 = the same order; None where either is constant."""
    if len(error) < 2:
        return None
    a, b = rankdata(error), rankdata(uncertainty)
    a, b = a - a.mean(), b - b.mean()
    spread = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / spread if spread > 0.0 else None
