from __future__ import annotations

import numpy as np

from uav_recon.planning.mode_rules import Adaptive, AlwaysMerged, ExploreOnly, ExploreThenRefine, ModeRule
from uav_recon.types.tasks import PlanMode


def chosen(rule: ModeRule, *distance_m: float, gaps_m: tuple[float, ...] = (), farther: int = 0) -> PlanMode:
    openings = np.array([1] * len(distance_m) + [0] * len(gaps_m), dtype=np.int64)
    return rule.choose(np.array([*distance_m, *gaps_m], dtype=np.float64), openings, farther)


def test_explores_only_with_more_than_enough_near_frontiers_and_more_than_their_share() -> None:
    rule = Adaptive(near_distance_m=1.5, near_count=3, near_share=0.2)
    assert chosen(rule, *[1.0] * 4) is PlanMode.EXPLORE
    assert chosen(rule, *[1.0] * 3) is PlanMode.MERGED
    assert chosen(rule, *[1.0] * 4, *[5.0] * 15) is PlanMode.EXPLORE
    assert chosen(rule, *[1.0] * 4, *[5.0] * 16) is PlanMode.MERGED
    assert chosen(rule, *[1.6] * 9) is PlanMode.MERGED
    assert chosen(rule) is PlanMode.MERGED


def test_the_share_is_that_of_all_openings() -> None:
    rule = Adaptive(near_distance_m=1.5, near_count=3, near_share=0.2)
    assert chosen(rule, *[1.0] * 5, farther=19) is PlanMode.EXPLORE
    assert chosen(rule, *[1.0] * 5, farther=20) is PlanMode.MERGED


def test_a_view_counts_as_often_as_there_are_openings_that_it_covers() -> None:
    rule = Adaptive(near_distance_m=1.5, near_count=3, near_share=0.2)
    near, far = np.array([1.0, 1.2]), np.array([1.0, 5.0])
    assert rule.choose(near, np.array([3, 1]), 15) is PlanMode.EXPLORE
    assert rule.choose(near, np.array([3, 1]), 16) is PlanMode.MERGED
    assert rule.choose(near, np.array([3, 0]), 0) is PlanMode.MERGED
    assert rule.choose(far, np.array([4, 15]), 0) is PlanMode.EXPLORE
    assert rule.choose(far, np.array([4, 16]), 0) is PlanMode.MERGED


def test_gaps_in_front_of_walls_are_not_counted() -> None:
    rule = Adaptive(near_distance_m=1.5, near_count=3, near_share=0.2)
    assert chosen(rule, 1.0, 1.0, 1.0, gaps_m=(1.0,) * 9) is PlanMode.MERGED
    assert chosen(rule, *[1.0] * 4, gaps_m=(5.0,) * 30) is PlanMode.EXPLORE


def test_refines_only_when_no_frontier_is_left() -> None:
    assert chosen(ExploreThenRefine(), gaps_m=(9.0,)) is PlanMode.EXPLORE
    assert chosen(ExploreThenRefine()) is PlanMode.MERGED


def test_the_simple_rules_ignore_the_frontiers() -> None:
    for distances in ((), (1.0,) * 50):
        assert chosen(ExploreOnly(), *distances) is PlanMode.EXPLORE
        assert chosen(AlwaysMerged(), *distances) is PlanMode.MERGED
