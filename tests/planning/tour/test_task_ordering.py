from __future__ import annotations

import itertools

import numpy as np
import pytest

from uav_recon.planning.tour.stopping_rule import VIEW_S, StoppingRule
from uav_recon.planning.tour.task_ordering import DETOUR_S, DETOUR_SHARE, FrontierWithDetours, Greedy, TaskOrdering, Tour
from uav_recon.types.frames import FloatArray
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

EXPLORE, SURFACE = TaskKind.EXPLORE, TaskKind.RECONSTRUCT
Place = tuple[TaskKind, float, float, float]  # kind, x, y, gain; the vehicle is at the origin and flies at 1 m/s


def case(places: list[Place]) -> tuple[list[Task], FloatArray]:
    at = np.array([(0.0, 0.0), *((x, y) for _, x, y, _ in places)])
    tasks = [Task(kind, np.zeros(3), Viewpoint(np.zeros(3), 0.0, 0.0), gain) for kind, _, _, gain in places]
    return tasks, np.linalg.norm(at[:, None] - at, axis=-1)


def order(choice: TaskOrdering, places: list[Place]) -> list[int]:
    nodes: list[int] = choice.order(*case(places)).order.tolist()
    return nodes


def test_the_tour_is_the_shortest_one() -> None:
    rng = np.random.default_rng(3)
    places = [(EXPLORE, float(x), float(y), 9.0) for x, y in rng.uniform(-5, 5, (6, 2))]
    _, costs_s = case(places)
    best = min(itertools.permutations(range(1, 7)), key=lambda o: sum(costs_s[a, b] for a, b in itertools.pairwise((0, *o))))
    assert order(Tour(StoppingRule(0.15)), places) == list(best)


def test_a_deferred_task_is_flown_when_no_other_is_worth_its_flight() -> None:
    rich, gap = (SURFACE, 5.0, 0.0, 500.0), (EXPLORE, -3.0, 0.0, 0.0)
    tour = Tour(StoppingRule(0.15))
    assert order(tour, [rich, gap]) == [1]
    small = (EXPLORE, -3.0, 0.0, 40.0)
    assert order(tour, [(SURFACE, 5.0, 0.0, 1.0), small]) == [2]  # too low a gain for this flight: dropped
    assert order(tour, [(SURFACE, 5.0, 0.0, 1.0), gap]) == []
    assert order(tour, []) == []


def test_greedy_takes_the_one_view_that_gains_most_per_second() -> None:
    near_and_poor, far_and_rich = (SURFACE, 1.0, 0.0, 30.0), (SURFACE, 9.0, 0.0, 120.0)
    assert order(Greedy(StoppingRule(0.0)), [far_and_rich, near_and_poor]) == [2]
    assert order(Greedy(StoppingRule(0.0)), [far_and_rich, (SURFACE, 4.0, 0.0, 30.0)]) == [1]
    assert order(Greedy(StoppingRule(0.0)), []) == []


def test_the_nearest_frontier_is_next_and_surface_is_viewed_on_the_path() -> None:
    far, near = (EXPLORE, 30.0, 0.0, 90.0), (EXPLORE, -10.0, 0.0, 9.0)
    beside_the_way, off_the_way = (SURFACE, -5.0, 1.0, 20.0), (SURFACE, 0.0, 8.0, 500.0)
    assert order(FrontierWithDetours(StoppingRule(0.0)), [far, near, beside_the_way, off_the_way]) == [3, 2]


def test_detours_stay_within_their_allowance() -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        places = [(EXPLORE, 8.0, 0.0, 9.0)]
        places += [(SURFACE, float(x), float(y), float(g)) for x, y, g in rng.uniform((-2, -3, 1), (10, 3, 60), (12, 3))]
        tasks, costs_s = case(places)
        way = FrontierWithDetours(StoppingRule(0.0)).order(tasks, costs_s).order.tolist()
        assert way[-1] == 1
        flown_s = sum(costs_s[a, b] for a, b in itertools.pairwise((0, *way))) + VIEW_S * (len(way) - 1)
        allowed_s = max(DETOUR_SHARE * costs_s[0, 1], DETOUR_S)
        assert flown_s <= costs_s[0, 1] + allowed_s + 1e-9
        assert len(set(way)) == len(way)


def test_without_a_frontier_surface_is_viewed_nearest_first() -> None:
    places = [(SURFACE, 5.0, 0.0, 50.0), (SURFACE, -1.0, 0.0, 50.0), (SURFACE, 2.0, 0.0, 50.0)]
    assert order(FrontierWithDetours(StoppingRule(0.0)), places) == [2, 3, 1]


@pytest.mark.parametrize("kind", [Tour, Greedy, FrontierWithDetours])
def test_every_choice_ends_when_surface_is_not_worth_its_flight(
    kind: type[Tour] | type[Greedy] | type[FrontierWithDetours],
) -> None:
    choice = kind(StoppingRule(0.5))
    assert order(choice, [(SURFACE, 4.0, 0.0, 100.0)]) == [1]
    tasks, costs_s = case([(SURFACE, 40.0, 0.0, 30.0)])
    answer = choice.order(tasks, costs_s)
    assert (len(answer.order), answer.dropped) == (0, 1)
    assert order(choice, [(EXPLORE, 40.0, 0.0, 150.0)]) == [1]
    assert order(choice, [(EXPLORE, 40.0, 0.0, 30.0)]) == []
    assert order(choice, []) == []
