from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from box_world import FIXED, GIMBAL

from uav_recon.config import PlannerConfig, VariantName
from uav_recon.planning.mode_rules import Adaptive, AlwaysMerged, ExploreOnly, ExploreThenRefine
from uav_recon.planning.tour.task_ordering import FrontierWithDetours, Greedy, Tour
from uav_recon.planning.variants import variant
from uav_recon.types.tasks import PlanMode, TaskKind

EXPLORE, SURFACE = TaskKind.EXPLORE, TaskKind.RECONSTRUCT


@pytest.mark.parametrize("name", get_args(VariantName))
def test_every_name_makes_its_own_objects(name: VariantName) -> None:
    config = PlannerConfig()
    one, other = variant(name, config), variant(name, config)
    assert one.name == name
    assert one.kinds
    assert one.task_ordering is not other.task_ordering  # it has the state of one flight
    assert isinstance(one.mode_rule.choose(np.ones(5), np.ones(5, dtype=np.int64), 0), PlanMode)


@pytest.mark.parametrize(
    ("name", "kinds", "mode", "choice", "views"),
    [
        ("explore-yaw", {EXPLORE}, ExploreOnly, Tour, "clusters"),
        ("explore", {EXPLORE}, ExploreOnly, Tour, "clusters"),
        ("reconstruct", {SURFACE}, AlwaysMerged, Tour, "clusters"),
        ("merged", {EXPLORE, SURFACE}, AlwaysMerged, Tour, "clusters"),
        ("adaptive", {EXPLORE, SURFACE}, Adaptive, Tour, "clusters"),
        ("explore-then-refine", {EXPLORE, SURFACE}, ExploreThenRefine, Tour, "clusters"),
        ("evpp", {EXPLORE, SURFACE}, AlwaysMerged, Greedy, "field"),
        ("vpp", {EXPLORE, SURFACE}, AlwaysMerged, FrontierWithDetours, "clusters"),
    ],
)
def test_each_variant_has_its_kinds_mode_choice_and_views(
    name: VariantName, kinds: set[TaskKind], mode: type, choice: type, views: str
) -> None:
    found = variant(name, PlannerConfig())
    assert found.kinds == kinds
    assert isinstance(found.mode_rule, mode)
    assert isinstance(found.task_ordering, choice)
    assert found.views == views


def test_thresholds_come_from_the_config() -> None:
    mode = variant("adaptive", PlannerConfig(near_distance_m=2.5, near_count=7, near_share=0.3)).mode_rule
    assert mode == Adaptive(2.5, 7, 0.3)


def test_yaw_only_means_level_or_the_fixed_angle_of_the_mount() -> None:
    limit = variant("explore-yaw", PlannerConfig()).camera
    assert (limit(GIMBAL).pitch_min_rad, limit(GIMBAL).pitch_max_rad) == (0.0, 0.0)
    assert (limit(FIXED).pitch_min_rad, limit(FIXED).pitch_max_rad) == (FIXED.pitch_min_rad, FIXED.pitch_max_rad)
    assert limit(GIMBAL).range_m == GIMBAL.range_m
    assert variant("explore", PlannerConfig()).camera(GIMBAL) is GIMBAL
