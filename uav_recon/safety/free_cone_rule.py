"""Which points count as inside a free cone. Guard and occupancy map use this one function."""

from __future__ import annotations

import numpy as np

from uav_recon.types.frames import BoolArray, FloatArray


def points_in_cones(
    points_m: FloatArray, apex_m: FloatArray, axis: FloatArray, cos_half_angle: FloatArray, reach_m: FloatArray
) -> BoolArray:
    """Return a mask (C, N) of points (N, 3) in C cones, each closed by a sphere around its apex.

    apex_m: (C, 3). axis: (C, 3) unit vectors. cos_half_angle: (C,), not negative. reach_m: (C,) radius of the sphere;
    nothing is inside a negative one.
    """
    off_m = points_m[None] - apex_m[:, None]
    along_m = np.einsum("cni,ci->cn", off_m, axis)
    distance_m = np.linalg.norm(off_m, axis=2)
    inside: BoolArray = (along_m >= cos_half_angle[:, None] * distance_m) & (distance_m <= reach_m[:, None])
    return inside
