from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import spearmanr

from sitl.bench.mapper.sparsification import ause, remaining, spearman


def test_the_remaining_error_by_hand() -> None:
    error = np.array([4.0, 1.0, 1.0])
    assert remaining(error, error) == pytest.approx([2.0, 1.0, 1.0])
    assert remaining(error, -error) == pytest.approx([2.0, 2.5, 4.0])
    # the reversed ranking: (0 + 1.5 + 3) / 3 over a mean error of 2
    assert ause(error, -error) == pytest.approx(0.75)


def test_a_perfect_ranking_scores_zero_and_a_random_one_1_minus_the_best_curve() -> None:
    rng = np.random.default_rng(0)
    error = rng.exponential(size=20_000)
    assert ause(error, np.exp(error)) == pytest.approx(0.0)
    best = remaining(error, error).mean() / error.mean()
    assert ause(error, rng.random(20_000)) == pytest.approx(1.0 - best, abs=0.02)


def test_a_constant_uncertainty_scores_as_a_random_one_in_any_order() -> None:
    error = np.sort(np.random.default_rng(1).exponential(size=1000))
    same = np.ones(1000)
    assert ause(error, same) == pytest.approx(ause(error[::-1], same))
    assert remaining(error, same) == pytest.approx(np.full(1000, error.mean()))


def test_nothing_to_rank_has_no_score() -> None:
    assert ause(np.zeros(0), np.zeros(0)) is None
    assert ause(np.zeros(5), np.arange(5.0)) is None
    assert spearman(np.ones(5), np.arange(5.0)) is None
    assert spearman(np.ones(1), np.ones(1)) is None


def test_rank_correlation_is_spearmans() -> None:
    rng = np.random.default_rng(2)
    error = np.round(rng.exponential(size=300), 1)  # with ties
    uncertainty = error + rng.normal(size=300)
    assert spearman(error, uncertainty) == pytest.approx(spearmanr(error, uncertainty).statistic)
