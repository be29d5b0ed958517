from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from uav_recon.planning.tour.atsp import EXACT_LIMIT, SEED, best_tour, rounds_for, tour_cost
from uav_recon.planning.tour.local_search import search_tour
from uav_recon.types.frames import FloatArray

ATSP = Path(__file__).parents[4] / "shared" / "streams" / "two_room" / "atsp"


def random_costs(rng: np.random.Generator, count: int) -> FloatArray:
    points = rng.uniform(0, 8, (count + 1, 2))
    flat = np.linalg.norm(points[:, None] - points[None], axis=2)
    return np.asarray(flat + rng.uniform(0, 2, flat.shape))


def flight_costs(rng: np.random.Generator, count: int) -> FloatArray:
    """Return the seconds between views in two rooms joined by a door.

    They are the longer of flight and turn, plus the turn into the direction of flight.
    """
    points = rng.uniform(0, 1, (count + 1, 3)) * np.array([10.0, 6.0, 2.0])
    yaws = rng.uniform(-np.pi, np.pi, count + 1)
    far = points[:, 0] > 5.0
    to_door = np.linalg.norm(points - np.array([5.0, 3.0, 1.0]), axis=1)
    straight = np.linalg.norm(points[:, None] - points[None], axis=2)
    lengths = np.where(far[:, None] != far[None], to_door[:, None] + to_door[None], straight)
    step = points[None] - points[:, None]
    turn, leaving = yaws[None] - yaws[:, None], np.arctan2(step[..., 1], step[..., 0]) - yaws[:, None]
    turn, leaving = (np.abs((angle + np.pi) % (2 * np.pi) - np.pi) for angle in (turn, leaving))
    return np.asarray(np.maximum(lengths / 0.8, turn / 0.785) + 0.25 * leaving / 0.785)


@pytest.mark.parametrize("count", range(10))
def test_small_tours_are_those_of_full_enumeration(count: int) -> None:
    costs = random_costs(np.random.default_rng(count), count)
    order = best_tour(costs)
    assert sorted(order.tolist()) == list(range(1, count + 1))
    every = np.array(list(permutations(range(1, count + 1))), dtype=np.int64)
    walked = np.column_stack([np.zeros(len(every), dtype=np.int64), every])
    assert tour_cost(costs, order) == pytest.approx(costs[walked[:, :-1], walked[:, 1:]].sum(axis=1).min())


def test_the_return_to_the_start_is_never_counted() -> None:
    rng = np.random.default_rng(3)
    for count in (6, 20):
        costs = random_costs(rng, count)
        dear = costs.copy()
        dear[:, 0] = 1e6
        np.testing.assert_array_equal(best_tour(costs), best_tour(dear))


def test_local_search_finds_the_exact_tour_where_that_is_known() -> None:
    gaps = []
    for seed in range(40):
        costs = random_costs(np.random.default_rng(seed), EXACT_LIMIT)
        found = search_tour(costs, rounds_for(EXACT_LIMIT), SEED)
        gaps.append(tour_cost(costs, found) / tour_cost(costs, best_tour(costs)) - 1)
    assert max(gaps) < 0.05
    assert np.mean(gaps) < 0.003


@pytest.mark.parametrize("count", [4, 5, 6, 20, 30, 50])
def test_a_search_visits_all_once_and_more_rounds_never_make_it_worse(count: int) -> None:
    costs = random_costs(np.random.default_rng(count), count)
    before = np.inf
    for rounds in (0, 10, 200):
        order = search_tour(costs, rounds, SEED)
        assert sorted(order.tolist()) == list(range(1, count + 1))
        assert tour_cost(costs, order) <= before + 1e-9
        before = tour_cost(costs, order)


@pytest.mark.parametrize("count", [20, 30, 50])
def test_searched_tours_are_near_the_best_that_a_far_longer_search_finds(count: int) -> None:
    gaps = []
    for seed in range(16):
        costs = flight_costs(np.random.default_rng(seed), count)
        best = min(tour_cost(costs, search_tour(costs, 2000, start)) for start in range(3))
        gaps.append(tour_cost(costs, best_tour(costs)) / best - 1)
    assert np.mean(gaps) <= 0.002


def test_large_tours_are_repeatable() -> None:
    costs = random_costs(np.random.default_rng(5), 40)
    np.testing.assert_array_equal(best_tour(costs), best_tour(costs))


@pytest.mark.shared
@pytest.mark.parametrize("count", [5, 10, 15, 20, 30, 50])
def test_tours_are_as_good_as_those_of_lkh(count: int) -> None:
    costs = np.loadtxt(ATSP / f"atsp_{count}.txt")
    order, cost = (ATSP / f"atsp_{count}_lkh.txt").read_text().strip().splitlines()
    lkh = np.array([int(node) + 1 for node in order.split()])  # LKH counts tasks from 0
    assert tour_cost(costs, lkh) == pytest.approx(float(cost), rel=1e-4)
    assert tour_cost(costs, best_tour(costs)) <= 1.002 * tour_cost(costs, lkh)
