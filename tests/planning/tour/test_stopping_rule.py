from __future__ import annotations

import itertools

import numpy as np
import pytest

from uav_recon.planning.frontier.cluster_table import OPENING
from uav_recon.planning.tour.stopping_rule import SHORTEST_TOUR_S, VIEW_S, StoppingRule
from uav_recon.types.frames import FloatArray
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

EXPLORE, SURFACE = TaskKind.EXPLORE, TaskKind.RECONSTRUCT


def along_a_line(*at: tuple[TaskKind, float, float]) -> tuple[list[Task], FloatArray]:
    """Return tasks on a line, given as (kind, metres from the vehicle, gain), and their costs.

    The costs (N + 1, N + 1) are at 1 m/s.
    """
    x = np.array([0.0, *(metres for _, metres, _ in at)])
    places = [np.array([metres, 0.0, 1.0]) for metres in x[1:]]
    tasks = [Task(kind, p, Viewpoint(p, 0.0, 0.0), gain) for p, (kind, _, gain) in zip(places, at, strict=True)]
    return tasks, np.abs(x[:, None] - x)


def kept(stopping_rule: StoppingRule, *at: tuple[TaskKind, float, float]) -> list[int]:
    tasks, costs_s = along_a_line(*at)
    answer = stopping_rule.keep(tasks, costs_s, np.arange(1, len(at) + 1))
    assert answer.dropped == len(at) - len(answer.order)
    nodes: list[int] = answer.order.tolist()
    return nodes


def worth_after_10_per_second() -> StoppingRule:
    """Return a rule that has seen a tour with a gain of 10 per second.

    With its share of a fifth it requires a gain of 2 per second.
    """
    stopping_rule = StoppingRule(0.2)
    metres = SHORTEST_TOUR_S - 4 * VIEW_S
    tour = [(SURFACE, metres * n / 4, 10 * SHORTEST_TOUR_S / 4) for n in range(1, 5)]
    assert kept(stopping_rule, *tour) == [1, 2, 3, 4]
    return stopping_rule


def test_a_task_must_gain_its_share_of_the_best_rate_so_far() -> None:
    seconds = 4.0 + VIEW_S
    assert kept(worth_after_10_per_second(), (SURFACE, 4.0, 2 * seconds + 0.01)) == [1]
    assert kept(worth_after_10_per_second(), (SURFACE, 4.0, 2 * seconds - 0.01)) == []


def test_openings_are_always_kept_and_gaps_are_weighed_like_surface() -> None:
    assert kept(worth_after_10_per_second(), (EXPLORE, 100.0, OPENING), (SURFACE, 101.0, 0.1)) == [1]
    seconds = 50.0 + VIEW_S
    assert kept(worth_after_10_per_second(), (EXPLORE, 50.0, 2 * seconds + 0.01)) == [1]
    assert kept(worth_after_10_per_second(), (EXPLORE, 50.0, 2 * seconds - 0.01)) == []


def test_only_the_detour_counts_and_not_the_path_that_is_flown_anyway() -> None:
    stopping_rule = worth_after_10_per_second()
    assert kept(stopping_rule, (SURFACE, 50.0, 1.1), (EXPLORE, 60.0, OPENING)) == [1, 2]  # on the path: only the stop counts
    assert kept(stopping_rule, (SURFACE, -5.0, 15.0), (EXPLORE, 60.0, OPENING)) == [2]  # back and forth: 10.5 s


def test_far_tasks_share_the_cost_of_the_path() -> None:
    far = [(SURFACE, 20.0 + n, 12.0) for n in range(6)]
    assert kept(worth_after_10_per_second(), *far) == [1, 2, 3, 4, 5, 6]  # a gain of 72 for 28 s
    assert kept(worth_after_10_per_second(), *far[:3]) == []  # a gain of 36 for 23.5 s
    poor_end = [*far, (SURFACE, 45.0, 12.0)]
    assert kept(worth_after_10_per_second(), *poor_end) == [1, 2, 3, 4, 5, 6]


def test_the_first_tour_sets_the_rate_and_one_nearby_view_does_not_set_it_high() -> None:
    stopping_rule = StoppingRule(0.2)
    assert kept(stopping_rule, (SURFACE, 0.1, 30.0)) == [1]  # it would be 50 per second over its 0.6 s alone
    assert kept(stopping_rule, (SURFACE, 10.0, 10.0)) == [1]
    assert kept(stopping_rule, (SURFACE, 20.0, 10.0)) == []


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_the_unit_of_the_gain_does_not_matter(scale: float) -> None:
    stopping_rule = StoppingRule(0.2)
    tour = [(SURFACE, float(n), 40.0 * scale) for n in range(1, 9)]
    assert len(kept(stopping_rule, *tour)) == 8
    assert kept(stopping_rule, (SURFACE, 3.0, 100.0 * scale), (SURFACE, 90.0, 20.0 * scale)) == [1]


@pytest.mark.parametrize("seed", range(20))
def test_no_kept_part_of_a_tour_gains_less_than_its_flight_costs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 10))
    place = rng.uniform(0, 20, (count + 1, 2))
    costs_s = np.linalg.norm(place[:, None] - place, axis=-1) + rng.uniform(0, 2, (count + 1, count + 1))
    kinds = rng.choice(np.array([EXPLORE, SURFACE, SURFACE]), count)
    tasks = [
        Task(kind, np.zeros(3), Viewpoint(np.zeros(3), 0.0, 0.0), float(rng.uniform(0, 60)) + OPENING * (kind is EXPLORE))
        for kind in kinds
    ]
    stopping_rule = worth_after_10_per_second()
    nodes = stopping_rule.keep(tasks, costs_s, rng.permutation(count) + 1).order.tolist()

    def seconds(tour: list[int]) -> float:
        return float(sum(costs_s[a, b] + VIEW_S for a, b in itertools.pairwise([0, *tour])))

    assert [n for n, task in enumerate(tasks, 1) if task.kind is EXPLORE and n not in nodes] == []
    for first, last in itertools.combinations(range(len(nodes) + 1), 2):
        stretch = [tasks[node - 1] for node in nodes[first:last]]
        if all(task.kind is SURFACE for task in stretch):
            saved_s = seconds(nodes) - seconds(nodes[:first] + nodes[last:])
            assert sum(task.gain for task in stretch) >= 2.0 * saved_s - 1e-6


def test_an_empty_tour_stays_empty() -> None:
    assert kept(worth_after_10_per_second()) == []
