"""What makes a motion unfit to be flown before anybody asks where it leads: shapes, numbers, rest at its end."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.types.trajectory import Trajectory

_REST_MPS = 0.05


def fault_of(trajectory: Trajectory) -> str:
    """What makes a trajectory unfit to be sampled, '' if it is sound."""
    count = len(trajectory.yaw_rad) if trajectory.yaw_rad.ndim == 1 else 0
    vectors = (trajectory.position_m, trajectory.velocity_mps, trajectory.acceleration_mps2)
    scalars = (trajectory.yaw_rad, trajectory.yaw_rate_radps, trajectory.camera_pitch_down_rad)
    if count < 1 or any(v.shape != (count, 3) for v in vectors) or any(s.shape != (count,) for s in scalars):
        return "trajectory is malformed"
    if not (math.isfinite(trajectory.start_s) and math.isfinite(trajectory.step_s) and trajectory.step_s > 0.0):
        return "trajectory has no time axis"
    if not all(bool(np.isfinite(array).all()) for array in vectors + scalars):
        return "trajectory is not finite"
    if not float(np.linalg.norm(trajectory.velocity_mps[-1])) <= _REST_MPS:
        return "trajectory does not end at rest"
    return ""
