from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from uav_recon.bench.planner import tours
from uav_recon.errors import UserError


def write_case(folder: Path, tasks: int, seed: int = 0) -> float:
    costs = np.random.default_rng(seed).uniform(1, 9, (tasks + 1, tasks + 1))
    orders = np.array(list(itertools.permutations(range(1, tasks + 1))))
    best = min(orders, key=lambda order: tours.cost_of(costs, order))
    np.savetxt(folder / f"atsp_{tasks}.txt", costs, fmt="%.9f")
    (folder / f"atsp_{tasks}_lkh.txt").write_text(" ".join(str(n - 1) for n in best) + "\n1.0\n")
    return tours.cost_of(costs, best)


def test_cases_are_read_with_the_cost_of_their_known_tour(tmp_path: Path) -> None:
    costs = {tasks: write_case(tmp_path, tasks) for tasks in (6, 4)}
    np.savetxt(tmp_path / "atsp_3.txt", np.ones((4, 4)))  # without a known tour: left out
    cases = tours.load_cases(tmp_path)
    assert [case.tasks for case in cases] == [4, 6]
    for case in cases:
        assert case.known_cost == pytest.approx(costs[case.tasks], abs=1e-6)


def test_the_best_tour_has_no_gap_in_any_order_of_the_tasks(tmp_path: Path) -> None:
    write_case(tmp_path, 6)
    score = tours.score(tours.load_cases(tmp_path)[0])
    assert score.gap == pytest.approx(0.0, abs=1e-12)
    assert score.worst_gap == pytest.approx(0.0, abs=1e-12)
    assert score.median_ms > 0


def test_a_longer_tour_has_a_gap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_case(tmp_path, 6)
    monkeypatch.setattr(tours, "best_tour", lambda costs: np.arange(1, len(costs)))
    score = tours.score(tours.load_cases(tmp_path)[0])
    assert score.worst_gap >= score.gap > 0.05


def test_a_case_of_the_wrong_size_is_named(tmp_path: Path) -> None:
    write_case(tmp_path, 4)
    (tmp_path / "atsp_4.txt").write_text("1 2\n3 4\n")
    with pytest.raises(UserError, match=r"atsp_4.txt: shape \(2, 2\)"):
        tours.load_cases(tmp_path)
