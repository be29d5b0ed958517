"""Tours against known ones: how long they take to find, and how much longer they are.

A file atsp_N.txt holds costs (N+1, N+1), row 0 = from the vehicle, column 0 = the way back, which costs nothing; atsp_N_lkh.txt
the order of the tasks 0..N-1 that LKH found. Names of tasks mean nothing, so each matrix is asked in many seeded orders of
its tasks, whose best tour is equally long: a search that is lucky with one order does not pass for exact.
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

ORDERS = 20  # seeded orders of the tasks of each matrix


@dataclass(frozen=True, slots=True, eq=False)
class TourCase:
    """tasks: N. costs: (N+1, N+1). known_cost: of the best tour that is known."""

    tasks: int
    costs: FloatArray
    known_cost: float


@dataclass(frozen=True, slots=True)
class TourScore:
    """median_ms of the processor over the orders; gap and worst_gap: mean and largest excess over the known tour, a share."""

    tasks: int
    median_ms: float
    gap: float
    worst_gap: float


def load_cases(folder: Path) -> tuple[TourCase, ...]:
    """Every matrix of a folder that has a tour, smallest first. Raises Failure for a file that is not one."""
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
    """Sum from node 0 along ``order`` (N,) of nodes 1..N."""
    nodes = np.concatenate(([0], order))
    return float(costs[nodes[:-1], nodes[1:]].sum())


def score(case: TourCase) -> TourScore:
    """Time and judge best_tour on every order of the case's tasks."""
    took_ms, gaps = [], []
    rng = np.random.default_rng(case.tasks)
    best_tour(case.costs)  # not the first of its size
    for _ in range(ORDERS):
        names = np.concatenate(([0], rng.permutation(case.tasks) + 1))
        costs = np.ascontiguousarray(case.costs[np.ix_(names, names)])
        began_s = time.thread_time()
        order = best_tour(costs)
        took_ms.append((time.thread_time() - began_s) * 1e3)
        gaps.append(cost_of(costs, order) / case.known_cost - 1.0)
    return TourScore(case.tasks, float(np.median(took_ms)), float(np.mean(gaps)), float(np.max(gaps)))
