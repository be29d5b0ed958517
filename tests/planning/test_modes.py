from __future__ import annotations

import numpy as np

from uav_recon.planning.modes import HURRY, Adaptive, AlwaysMerged, ExploreOnly, ExploreThenRefine
from uav_recon.types.tasks import PlanMode


def test_explores_only_with_more_than_enough_near_frontiers_and_more_than_their_share() -> None:
    rule = Adaptive(near_distance_m=1.5, near_count=3, near_share=0.2)
    assert rule.choose(np.array([1.0] * 4), 0.2) is PlanMode.EXPLORE
    assert rule.choose(np.array([1.0] * 3), 0.2) is PlanMode.MERGED
    assert rule.choose(np.array([1.0] * 4 + [5.0] * 15), 0.2) is PlanMode.EXPLORE
    assert rule.choose(np.array([1.0] * 4 + [5.0] * 16), 0.2) is PlanMode.MERGED
    assert rule.choose(np.array([1.6] * 9), 0.2) is PlanMode.MERGED
    assert rule.choose(np.zeros(0), 0.2) is PlanMode.MERGED


def test_refines_only_when_no_frontier_is_left() -> None:
    assert ExploreThenRefine().choose(np.array([np.inf]), 0.2) is PlanMode.EXPLORE
    assert ExploreThenRefine().choose(np.zeros(0), 0.2) is PlanMode.MERGED


def test_the_simple_rules_ask_nothing() -> None:
    for distances in (np.zeros(0), np.ones(50)):
        assert ExploreOnly().choose(distances, 0.2) is PlanMode.EXPLORE
        assert AlwaysMerged().choose(distances, 0.2) is PlanMode.MERGED


def test_late_in_the_budget_frontiers_come_first() -> None:
    rule = Adaptive(1.5, 3, 0.2)
    far = np.array([9.0])
    assert rule.choose(far, HURRY) is PlanMode.MERGED
    assert rule.choose(far, HURRY + 0.01) is PlanMode.EXPLORE
    assert rule.choose(np.zeros(0), 0.9) is PlanMode.MERGED
