from __future__ import annotations

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.planning.modes import Adaptive, AlwaysMerged, ExploreOnly, mode_rule
from uav_recon.types.tasks import PlanMode


def test_explores_only_with_more_than_enough_near_frontiers_and_more_than_their_share() -> None:
    rule = Adaptive(near_distance_m=1.5, near_count=3, near_share=0.2)
    assert rule.choose(np.array([1.0] * 4)) is PlanMode.EXPLORE
    assert rule.choose(np.array([1.0] * 3)) is PlanMode.MERGED
    assert rule.choose(np.array([1.0] * 4 + [5.0] * 15)) is PlanMode.EXPLORE
    assert rule.choose(np.array([1.0] * 4 + [5.0] * 16)) is PlanMode.MERGED
    assert rule.choose(np.array([1.6] * 9)) is PlanMode.MERGED
    assert rule.choose(np.zeros(0)) is PlanMode.MERGED


def test_a_variant_is_another_small_object() -> None:
    config = PlannerConfig(near_count=7)
    assert mode_rule("adaptive", config) == Adaptive(config.near_distance_m, 7, config.near_share)
    assert mode_rule("explore", config).choose(np.zeros(0)) is PlanMode.EXPLORE
    assert isinstance(mode_rule("explore", config), ExploreOnly)
    assert isinstance(mode_rule("merged", config), AlwaysMerged)
    assert mode_rule("merged", config).choose(np.zeros(50)) is PlanMode.MERGED
