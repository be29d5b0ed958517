from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from uav_recon.planning.tour import ROUNDS, SEED, _local_search, best_tour, tour_cost
from uav_recon.types.frames import FloatArray

ATSP = Path(__file__).parents[3] / "shared" / "streams" / "two_room" / "atsp"


def random_costs(rng: np.random.Generator, count: int) -> FloatArray:
    points = rng.uniform(0, 8, (count + 1, 2))
    flat = np.linalg.norm(points[:, None] - points[None], axis=2)
    return np.asarray(flat + rng.uniform(0, 2, flat.shape))


@pytest.mark.parametrize("count", range(9))
def test_small_tours_are_those_of_full_enumeration(count: int) -> None:
    costs = random_costs(np.random.default_rng(count), count)
    order = best_tour(costs)
    assert sorted(order.tolist()) == list(range(1, count + 1))
    least = min(tour_cost(costs, np.array(p, dtype=np.int64)) for p in permutations(range(1, count + 1)))
    assert tour_cost(costs, order) == pytest.approx(least)


def test_local_search_finds_the_exact_tour_where_that_is_known() -> None:
    gaps = []
    for seed in range(20):
        costs = random_costs(np.random.default_rng(seed), 10)
        gaps.append(tour_cost(costs, _local_search(costs, ROUNDS, SEED)) / tour_cost(costs, best_tour(costs)) - 1)
    assert max(gaps) < 0.03
    assert np.mean(gaps) < 0.003


def test_large_tours_visit_all_once_and_repeat() -> None:
    costs = random_costs(np.random.default_rng(5), 40)
    first = best_tour(costs)
    assert sorted(first.tolist()) == list(range(1, 41))
    np.testing.assert_array_equal(first, best_tour(costs))


@pytest.mark.shared
@pytest.mark.parametrize("count", [5, 10, 15, 20, 30])
def test_tours_are_within_one_percent_of_lkh(count: int) -> None:
    costs = np.loadtxt(ATSP / f"atsp_{count}.txt")
    order, cost = (ATSP / f"atsp_{count}_lkh.txt").read_text().strip().splitlines()
    lkh = np.array([int(node) + 1 for node in order.split()])  # theirs counts tasks from 0
    assert tour_cost(costs, lkh) == pytest.approx(float(cost), rel=1e-4)
    assert tour_cost(costs, best_tour(costs)) <= 1.01 * tour_cost(costs, lkh)
