"""Trajectories that cannot be sampled are named."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from uav_recon.autopilot.pilot.situation.message_validation import is_valid_free_space, is_valid_range_grid, trajectory_fault
from uav_recon.types.maps import FreeSpace, GridSpec
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
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
        ({}, None),
        ({"velocity_mps": ENDS}, None),
        ({"position_m": np.zeros((4, 3))}, ReasonCode.TRAJECTORY_MALFORMED),
        ({"position_m": np.zeros((5, 2))}, ReasonCode.TRAJECTORY_MALFORMED),
        ({"acceleration_mps2": np.zeros((6, 3))}, ReasonCode.TRAJECTORY_MALFORMED),
        ({"yaw_rad": np.zeros((5, 1))}, ReasonCode.TRAJECTORY_MALFORMED),
        ({"yaw_rad": np.zeros(0)}, ReasonCode.TRAJECTORY_MALFORMED),
        ({"camera_pitch_down_rad": np.zeros(4)}, ReasonCode.TRAJECTORY_MALFORMED),
        ({"step_s": 0.0}, ReasonCode.TRAJECTORY_NO_TIME_AXIS),
        ({"step_s": math.inf}, ReasonCode.TRAJECTORY_NO_TIME_AXIS),
        ({"start_s": math.nan}, ReasonCode.TRAJECTORY_NO_TIME_AXIS),
        ({"yaw_rate_radps": np.full(5, math.nan)}, ReasonCode.TRAJECTORY_NOT_FINITE),
        ({"yaw_rate_radps": np.full(5, -1e6)}, None),
        ({"yaw_rad": np.full(5, -1.7e308)}, ReasonCode.TRAJECTORY_OUT_OF_RANGE),
        ({"yaw_rad": np.full(5, -1.1e6)}, ReasonCode.TRAJECTORY_OUT_OF_RANGE),
        ({"position_m": np.full((5, 3), 1.3e154)}, ReasonCode.TRAJECTORY_OUT_OF_RANGE),
        ({"velocity_mps": ENDS * 1.01}, ReasonCode.TRAJECTORY_NOT_AT_REST),
        ({"velocity_mps": np.full((5, 3), 0.2)}, ReasonCode.TRAJECTORY_NOT_AT_REST),
    ],
)
def test_trajectories_that_cannot_be_sampled_are_named(changes: dict[str, Any], fault: ReasonCode | None) -> None:
    found = trajectory_fault(line(**changes))
    assert (found and found.code) is fault


def test_a_trajectory_of_one_sample_is_a_place() -> None:
    one, place = np.zeros(1), np.zeros((1, 3))
    assert trajectory_fault(Trajectory(0.0, 0.1, place, place, place, one, one, one, np.zeros(0), 0, 1)) is None
    none, nowhere = np.zeros(0), np.zeros((0, 3))
    empty = Trajectory(0.0, 0.1, nowhere, nowhere, nowhere, none, none, none, none, 0, 1)
    assert trajectory_fault(empty) == Reason(ReasonCode.TRAJECTORY_MALFORMED)


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
