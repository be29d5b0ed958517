"""Error of the odometry against the true path, after rigid alignment.

The embedded SLAM has no true origin: where the pad is, which way is north, and how a mount that is off tilts the map cannot be
seen from inside. Its model is compared with the truth after the rigid alignment of the two paths, as is usual for SLAM.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_recon.evaluation.trajectory_error import MIN_POSES, aligned
from uav_recon.types.pose import Pose

_LARGEST_GAP_S = 0.1  # between a sample of the path and the truth

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class OdometryAlignment:
    """truth_from_odom of a whole flight, and the position error (N,) in metres that it leaves."""

    truth_from_odom: Pose
    error_m: F64

    @property
    def ate_m(self) -> float:
        """Root mean square of the error (absolute trajectory error)."""
        return float(np.sqrt(np.mean(self.error_m**2)))

    @property
    def turn_rad(self) -> float:
        """Angle between the two frames."""
        w = abs(float(self.truth_from_odom.quat_wxyz[0]))
        return 2.0 * float(np.arctan2(np.linalg.norm(self.truth_from_odom.quat_wxyz[1:]), w))


def align_odometry(stamp_s: F64, position_m: F64, true_stamp_s: F64, true_position_m: F64) -> OdometryAlignment | None:
    """Align positions (N, 3) at stamps (N,) with the truth (M, 3) at stamps (M,).

    None for too few positions, or those of another clock.
    """
    if len(true_stamp_s) < MIN_POSES or len(stamp_s) < MIN_POSES:
        return None
    after = np.clip(np.searchsorted(true_stamp_s, stamp_s), 1, len(true_stamp_s) - 1)
    near = np.minimum(np.abs(true_stamp_s[after] - stamp_s), np.abs(true_stamp_s[after - 1] - stamp_s)) <= _LARGEST_GAP_S
    near &= np.isfinite(position_m).all(axis=1)
    if np.count_nonzero(near) < MIN_POSES:
        return None
    truth = np.column_stack([np.interp(stamp_s[near], true_stamp_s, true_position_m[:, axis]) for axis in range(3)])
    truth_from_odom = aligned(position_m[near], truth)
    return OdometryAlignment(truth_from_odom, np.linalg.norm(truth_from_odom.apply(position_m[near]) - truth, axis=1))
