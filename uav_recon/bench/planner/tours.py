"""Tours against known tours: search time and excess cost.

A file atsp_N.txt holds costs (N+1, N+1): row 0 = from the vehicle, column 0 = the return, which costs nothing.
atsp_N_lkh.txt holds the order of the tasks 0..N-1 found by LKH. The numbering of tasks is arbitrary, so each matrix is
solved for many seeded random permutations of its tasks with the same best cost. A search that succeeds by chance for one
numbering does not pass as exact.
"""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uav_recon.errors import UserError
from uav_recon.planning.tour.atsp import best_tour
from uav_recon.types.frames import FloatArray, IntArray

ORDERS = 20  # seeded random permutations of the tasks of each matrix


@dataclass(frozen=True, slots=True, eq=False)
class TourCase:
    """A cost matrix and its best known tour cost.

    tasks: N.
    costs: (N+1, N+1).
    known_cost: cost of the best known tour.
    """

    tasks: int
    costs: FloatArray
    known_cost: float


@dataclass(frozen=True, slots=True)
class TourScore:
    """Results of one case over the permutations.

    median_ms: processor time.
    gap, worst_gap: mean and largest relative excess over the known tour.
    """

    tasks: int
    median_ms: float
    gap: float
    worst_gap: float


def load_cases(folder: Path) -> tuple[TourCase, ...]:
    """Read every matrix of a folder that has a known tour, smallest first.

    Raises UserError for an invalid file.
    """
    found = []
    for path in folder.glob("atsp_*.txt"):
        number = re.fullmatch(r"atsp_(\d+)\.txt", path.name)
        tour = path.with_name(f"{path.stem}_lkh.txt")
        if number and tour.exists():
            found.append(_case(path, tour, int(number[1])))
    return tuple(sorted(found, key=lambda case: case.tasks))


def _case(path: Path, tour: Path, tasks: int) -> TourCase:
    try:
        costs = np.loadtxt(path, dtype=np.float64)
        order = np.array(tour.read_text(encoding="utf-8").splitlines()[0].split(), dtype=np.int64) + 1
    except (OSError, ValueError, IndexError) as error:
        raise UserError(f"{path}: cannot be read as costs and a tour: {error}") from None
    if costs.shape != (tasks + 1, tasks + 1) or sorted(order) != list(range(1, tasks + 1)):
        raise UserError(f"{path}: shape {costs.shape} and {len(order)} tasks in the tour, want {tasks}")
    return TourCase(tasks, costs, cost_of(costs, order))


def cost_of(costs: FloatArray, order: IntArray) -> float:
    """Return the sum of the costs from node 0 along ``order`` (N,) of nodes 1..N."""
    nodes = np.concatenate(([0], order))
    return float(costs[nodes[:-1], nodes[1:]].sum())


def score(case: TourCase) -> TourScore:
    """Time and score best_tour on every permutation of the case's tasks."""
    took_ms, gaps = [], []
    rng = np.random.default_rng(case.tasks)
    best_tour(case.costs)  # warm-up for this size
    for _ in range(ORDERS):
        names = np.concatenate(([0], rng.permutation(case.tasks) + 1))
        costs = np.ascontiguousarray(case.costs[np.ix_(names, names)])
        began_s = time.thread_time()
        order = best_tour(costs)
        took_ms.append((time.thread_time() - began_s) * 1e3)
        gaps.append(cost_of(costs, order) / case.known_cost - 1.0)
    return TourScore(case.tasks, float(np.median(took_ms)), float(np.mean(gaps)), float(np.max(gaps)))
