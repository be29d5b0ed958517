"""The preset of the planner reaches every stage of the mission, not the planner alone."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import pytest

from uav_recon import config as configuration
from uav_recon.app import mission_factory
from uav_recon.mapping.keyframe_selection import KeyframeSelection, PlannedViewsOnly

FLOWN = Path(__file__).parents[2] / "systemd" / "config.toml"


@pytest.mark.parametrize(
    ("preset", "spacing_m", "selection"), [("rosser", 0.2, PlannedViewsOnly), ("auto", math.inf, KeyframeSelection)]
)
def test_the_mission_flies_by_the_preset(preset: Literal["rosser", "auto"], spacing_m: float, selection: type) -> None:
    tree = configuration.load(FLOWN).model_dump(mode="json", exclude_none=True)
    tree["planner"] = {"preset": preset}
    config = configuration.parse(tree, "test")
    orders = mission_factory.mission_parameters(mission_factory.with_preset(config))
    assert orders.view_spacing_m == spacing_m
    voxels = mission_factory.make_occupancy_map(config)
    assert type(mission_factory.make_keyframe_selection(mission_factory.with_preset(config), voxels.grid)) is selection
    assert mission_factory.with_preset(mission_factory.with_preset(config)) == mission_factory.with_preset(config)
