"""Trajectories that cannot be sampled are named."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from uav_recon.autopilot.pilot.message_validation import is_valid_free_space, is_valid_range_grid, trajectory_fault
from uav_recon.types.maps import FreeSpace, GridSpec
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import Pose
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
        ({"yaw_rate_radps": np.full(5, -1e6)}, ""),
        ({"yaw_rad": np.full(5, -1.7e308)}, "beyond all reason"),
        ({"yaw_rad": np.full(5, -1.1e6)}, "beyond all reason"),
        ({"position_m": np.full((5, 3), 1.3e154)}, "beyond all reason"),
        ({"velocity_mps": ENDS * 1.01}, "rest"),
        ({"velocity_mps": np.full((5, 3), 0.2)}, "rest"),
    ],
)
def test_trajectories_that_cannot_be_sampled_are_named(changes: dict[str, Any], fault: str) -> None:
    found = trajectory_fault(line(**changes))
    assert fault in found
    assert bool(found) is bool(fault)


def test_a_trajectory_of_one_sample_is_a_place() -> None:
    one, place = np.zeros(1), np.zeros((1, 3))
    assert trajectory_fault(Trajectory(0.0, 0.1, place, place, place, one, one, one, np.zeros(0), 0, 1)) == ""
    none, nowhere = np.zeros(0), np.zeros((0, 3))
    assert (
        trajectory_fault(Trajectory(0.0, 0.1, nowhere, nowhere, nowhere, none, none, none, none, 0, 1))
        == "trajectory is malformed"
    )


BITS = np.zeros(8, np.uint8)  # of 3 x 4 x 5 voxels


@pytest.mark.parametrize(
    ("origin_m", "resolution_m", "shape", "bits", "good"),
    [
        ((0.0, 0.0, 0.0), 0.1, (3, 4, 5), BITS, True),
        ((-1e6, 0.0, 1e6), 0.01, (3, 4, 5), BITS, True),
        ((0.0, 0.0, 0.0), 2.0, (4, 4, 4), BITS, True),
        ((0.0, 0.0, 0.0), 0.0, (3, 4, 5), BITS, False),
        ((0.0, 0.0, 0.0), math.nan, (3, 4, 5), BITS, False),
        ((0.0, 0.0, 0.0), -0.1, (3, 4, 5), BITS, False),
        ((0.0, 0.0, 0.0), 0.0099, (3, 4, 5), BITS, False),
        ((0.0, 0.0, 0.0), 2.01, (3, 4, 5), BITS, False),
        ((math.nan, 0.0, 0.0), 0.1, (3, 4, 5), BITS, False),
        ((0.0, math.inf, 0.0), 0.1, (3, 4, 5), BITS, False),
        ((0.0, 0.0, 1.1e6), 0.1, (3, 4, 5), BITS, False),
        ((0.0, 0.0), 0.1, (3, 4, 5), BITS, False),
        ((0.0, 0.0, 0.0), 0.1, (-3, -4, 5), BITS, False),
        ((0.0, 0.0, 0.0), 0.1, (3, 4, 0), BITS[:0], False),
        ((0.0, 0.0, 0.0), 0.1, (3, 4, 5), BITS[:7], False),
        ((0.0, 0.0, 0.0), 0.1, (5, 13, 1), BITS, False),
        ((0.0, 0.0, 0.0), 0.1, (3, 4, 5), BITS.reshape(2, 4), False),
    ],
)
def test_known_free_space_is_a_grid_and_a_bit_for_each_voxel(
    origin_m: tuple[float, ...], resolution_m: float, shape: tuple[int, int, int], bits: Any, good: bool
) -> None:
    assert is_valid_free_space(FreeSpace(GridSpec(np.array(origin_m), resolution_m, shape), bits, 1)) is good


@pytest.mark.parametrize(
    ("shape", "half_tan", "good"),
    [
        ((12, 16), (0.95, 0.55), True),
        ((1, 1), (1e6, 1e-6), True),
        ((16,), (0.95, 0.55), False),
        ((), (0.95, 0.55), False),
        ((2, 12, 16), (0.95, 0.55), False),
        ((0, 0), (0.95, 0.55), False),
        ((12, 16), (0.0, 0.55), False),
        ((12, 16), (0.95, 0.0), False),
        ((12, 16), (math.nan, 0.55), False),
        ((12, 16), (0.95, math.nan), False),
        ((12, 16), (math.inf, 0.55), False),
        ((12, 16), (0.95, math.inf), False),
        ((12, 16), (-0.95, -0.55), False),
    ],
)
def test_depth_is_cells_in_a_field_of_view(shape: tuple[int, ...], half_tan: tuple[float, float], good: bool) -> None:
    assert is_valid_range_grid(MinRangeGrid(5.0, Pose.identity(), np.full(shape, 2.0), half_tan, 0.9)) is good
