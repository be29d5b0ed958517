"""Trajectories that cannot be sampled are named."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from uav_recon.autopilot.soundness import fault_of
from uav_recon.types.trajectory import Trajectory


def line(**changes: Any) -> Trajectory:
    n = 5
    flat, still = np.zeros(n), np.zeros((n, 3))
    return dataclasses.replace(Trajectory(0.0, 0.1, still, still, still, flat, flat, flat, np.zeros(0), 0, 1), **changes)


ENDS = np.zeros((5, 3))
ENDS[-1, 0] = 0.05


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({}, ""),
        ({"velocity_mps": ENDS}, ""),
        ({"position_m": np.zeros((4, 3))}, "malformed"),
        ({"position_m": np.zeros((5, 2))}, "malformed"),
        ({"acceleration_mps2": np.zeros((6, 3))}, "malformed"),
        ({"yaw_rad": np.zeros((5, 1))}, "malformed"),
        ({"yaw_rad": np.zeros(0)}, "malformed"),
        ({"camera_pitch_down_rad": np.zeros(4)}, "malformed"),
        ({"step_s": 0.0}, "time axis"),
        ({"step_s": math.inf}, "time axis"),
        ({"start_s": math.nan}, "time axis"),
        ({"yaw_rate_radps": np.full(5, math.nan)}, "finite"),
        ({"velocity_mps": ENDS * 1.01}, "rest"),
        ({"velocity_mps": np.full((5, 3), 0.2)}, "rest"),
    ],
)
def test_trajectories_that_cannot_be_sampled_are_named(changes: dict[str, Any], fault: str) -> None:
    found = fault_of(line(**changes))
    assert fault in found
    assert bool(found) is bool(fault)


def test_a_trajectory_of_one_sample_is_a_place() -> None:
    one, place = np.zeros(1), np.zeros((1, 3))
    assert fault_of(Trajectory(0.0, 0.1, place, place, place, one, one, one, np.zeros(0), 0, 1)) == ""
    none, nowhere = np.zeros(0), np.zeros((0, 3))
    assert fault_of(Trajectory(0.0, 0.1, nowhere, nowhere, nowhere, none, none, none, none, 0, 1)) == "trajectory is malformed"
