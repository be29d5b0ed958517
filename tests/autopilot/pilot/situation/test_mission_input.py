"""The heading that shows the place counts only from a mission that is not silent, and only if it is a number."""

from __future__ import annotations

import math

import pytest

from uav_recon.autopilot.pilot.situation.mission_input import MissionInput
from uav_recon.channels import MemoryChannel
from uav_recon.safety.refusals import RefusalCounter
from uav_recon.types.trajectory import Goal, Intent

FRESH_S = 0.5


@pytest.mark.parametrize(
    ("said_rad", "age_s", "expected_rad"),
    [(1.2, 0.0, 1.2), (1.2, 0.4, 1.2), (1.2, 0.6, None), (math.nan, 0.0, None), (None, 0.0, None)],
)
def test_the_heading_that_shows_the_place(said_rad: float | None, age_s: float, expected_rad: float | None) -> None:
    channel = MemoryChannel(Intent)
    mission = MissionInput(channel, FRESH_S, RefusalCounter())
    assert mission.seeing_yaw_rad(10.0) is None
    channel.publish(Intent(10.0, Goal.FLY, seeing_yaw_rad=said_rad))
    mission.update(10.0)
    assert mission.seeing_yaw_rad(10.0 + age_s) == expected_rad
