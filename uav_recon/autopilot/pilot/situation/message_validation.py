"""Validation of messages from other processes: trajectories, free space and range grids.

Shapes, numbers, and rest at the end of a motion are checked before anything else uses them.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.types.maps import FreeSpace
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Trajectory

_REST_MPS = 0.05  #: refuse: a trajectory that is faster at its end: each must end at rest
#: refuse: a trajectory with a larger number in any unit: no flight needs it, and arithmetic may overflow above
_LARGEST_SI = 1e6
_FINEST_M = 0.01  #: reject: known-free space with smaller voxels, which are no size to check a hull with
_COARSEST_M = 2.0  #: reject: known-free space with larger voxels


def trajectory_fault(trajectory: Trajectory) -> Reason | None:
    """Return why a trajectory cannot be sampled, None if it can."""
    count = len(trajectory.yaw_rad) if trajectory.yaw_rad.ndim == 1 else 0
    vectors = (trajectory.position_m, trajectory.velocity_mps, trajectory.acceleration_mps2)
    scalars = (trajectory.yaw_rad, trajectory.yaw_rate_radps, trajectory.camera_pitch_down_rad)
    if count < 1 or any(v.shape != (count, 3) for v in vectors) or any(s.shape != (count,) for s in scalars):
        return Reason(ReasonCode.TRAJECTORY_MALFORMED)
    if not (math.isfinite(trajectory.start_s) and math.isfinite(trajectory.step_s) and trajectory.step_s > 0.0):
        return Reason(ReasonCode.TRAJECTORY_NO_TIME_AXIS)
    if not all(bool(np.isfinite(array).all()) for array in vectors + scalars):
        return Reason(ReasonCode.TRAJECTORY_NOT_FINITE)
    if any(bool((np.abs(array) > _LARGEST_SI).any()) for array in vectors + scalars):
        return Reason(ReasonCode.TRAJECTORY_OUT_OF_RANGE)
    if not float(np.linalg.norm(trajectory.velocity_mps[-1])) <= _REST_MPS:
        return Reason(ReasonCode.TRAJECTORY_NOT_AT_REST)
    return None


def is_valid_free_space(space: FreeSpace) -> bool:
    """Return True if known-free space is valid.

    It is a grid of voxels of a size comparable with a hull, and has a bit for each.
    """
    grid, bits = space.grid, space.bits
    if grid.origin_world_m.shape != (3,) or not bool((np.abs(grid.origin_world_m) <= _LARGEST_SI).all()):
        return False
    if not _FINEST_M <= grid.resolution_m <= _COARSEST_M or min(grid.shape) < 1:
        return False
    return bits.shape == (-(-math.prod(grid.shape) // 8),)


def is_valid_range_grid(nearby: MinRangeGrid) -> bool:
    """Return True if a range grid has rows and columns of cells, and a field of view."""
    cells, (wide, high) = nearby.range_m, nearby.half_tan
    return cells.ndim == 2 and cells.size > 0 and 0.0 < wide <= _LARGEST_SI and 0.0 < high <= _LARGEST_SI
