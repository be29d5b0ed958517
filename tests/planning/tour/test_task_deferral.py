from __future__ import annotations

import numpy as np

from uav_recon.planning.tour.stopping_rule import VIEW_S
from uav_recon.planning.tour.task_deferral import NOW_SHARE, not_deferred
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

Place = tuple[TaskKind, float, float, float]  # kind, x, y, gain; the vehicle is at the origin and flies at 1 m/s
EXPLORE, SURFACE = TaskKind.EXPLORE, TaskKind.RECONSTRUCT


def now(*places: Place) -> list[bool]:
    at = np.array([(0.0, 0.0), *((x, y) for _, x, y, _ in places)])
    tasks = [Task(kind, np.zeros(3), Viewpoint(np.zeros(3), 0.0, 0.0), gain) for kind, _, _, gain in places]
    return [bool(one) for one in not_deferred(tasks, np.linalg.norm(at[:, None] - at, axis=-1))]


def test_a_task_with_a_low_gain_rate_against_the_best_is_deferred_for_every_kind() -> None:
    seconds, best = 10.0 - VIEW_S, (EXPLORE, 10.0 - VIEW_S, 0.0, 100.0)  # 10 per second
    for kind in TaskKind:
        enough = 10.0 * NOW_SHARE * (seconds + VIEW_S)
        assert now(best, (kind, -seconds, 0.0, enough + 0.01)) == [True, True]
        assert now(best, (kind, -seconds, 0.0, enough - 0.01)) == [True, False]


def test_near_the_path_to_the_best_task_only_the_detour_counts() -> None:
    best = (EXPLORE, 20.0, 0.0, 2000.0)
    trifle = 2000.0 / (20.0 + VIEW_S) * NOW_SHARE * VIEW_S * 1.01
    assert now(best, (SURFACE, 10.0, 0.0, trifle)) == [True, True]
    assert now(best, (SURFACE, -10.0, 0.0, trifle)) == [True, False]


def test_the_best_task_is_never_deferred_and_neither_is_the_last() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        places = [(SURFACE, float(x), float(y), float(g)) for x, y, g in rng.uniform((-9, -9, 0.1), (9, 9, 60), (7, 3))]
        rate = [gain / (np.hypot(x, y) + VIEW_S) for _, x, y, gain in places]
        assert now(*places)[int(np.argmax(rate))]
    assert now((EXPLORE, 9.0, 0.0, 3.0)) == [True]
    assert now() == []
