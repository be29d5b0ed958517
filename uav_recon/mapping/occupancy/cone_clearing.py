"""Cone clearing: which voxels a free cone contains, and what it says about them.

A wide beam measures the nearest surface in it, and may miss a thin one. It therefore only frees what nothing else is known
about, and a single solid depth return takes that back.
"""

from __future__ import annotations

import dataclasses
import math
from itertools import product

import numpy as np

from uav_recon.mapping.occupancy.log_odds import FREE_AT
from uav_recon.safety.free_cone_rule import points_in_cones
from uav_recon.types.frames import AnyArray, FloatArray, IntArray
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.maps import GridSpec

CONE_STEP = 1  # of log-odds, by one measurement: as a doubtful depth frame, so it takes four to free a voxel; ends at FREE_AT


def voxels_inside(cone: FreeCone, grid: GridSpec) -> IntArray:
    """Return the flat indices (N,) of the voxels wholly inside the cone.

    The cone is convex: a voxel is inside if its eight corners are.
    """
    low_m, high_m = _box(cone)
    low = np.maximum(grid.index(low_m), 0)
    high = np.minimum(grid.index(high_m) + 1, np.array(grid.shape))
    if np.any(high <= low):
        return np.zeros(0, dtype=np.int64)
    edges = [
        origin + grid.resolution_m * np.arange(a, b + 1) for origin, a, b in zip(grid.origin_world_m, low, high, strict=True)
    ]
    corners_m = np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1)
    cos = np.array([math.cos(cone.half_angle_rad)])
    corner = points_in_cones(
        corners_m.reshape(-1, 3), cone.apex_odom_m[None], cone.axis_odom[None], cos, np.array([cone.reach_m])
    ).reshape(corners_m.shape[:3])
    inside = np.ones(high - low, dtype=np.bool_)
    for side in product((slice(None, -1), slice(1, None)), repeat=3):
        inside &= corner[side]
    flat: IntArray = np.ravel_multi_index(tuple((np.argwhere(inside) + low).T), grid.shape)
    return flat


def clear_cone(cone: FreeCone, grid: GridSpec, odds: AnyArray) -> IntArray:
    """Add the evidence of a cone to the log-odds; returns the voxels (N,) that became free.

    It ends one voxel before the cone does, for the errors of poses and map. Voxels with any evidence of a surface keep it, and
    none becomes more certain than just free.
    """
    inside = voxels_inside(dataclasses.replace(cone, reach_m=cone.reach_m - grid.resolution_m), grid)
    open_to_it = inside[(odds[inside] > FREE_AT) & (odds[inside] <= 0)]
    odds[open_to_it] -= CONE_STEP
    freed: IntArray = open_to_it[odds[open_to_it] == FREE_AT]
    return freed


def _box(cone: FreeCone) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper corner (3,) of a box around the cone."""
    end_m = cone.apex_odom_m + cone.reach_m * cone.axis_odom
    aside_m = cone.reach_m * math.sin(cone.half_angle_rad)
    return np.minimum(cone.apex_odom_m, end_m) - aside_m, np.maximum(cone.apex_odom_m, end_m) + aside_m
