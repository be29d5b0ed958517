"""The nearest thing ahead, straight from a raw depth frame: no pose, no map."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.types.camera import Intrinsics
from uav_recon.types.frames import Float32Array, FloatArray


def nearest_in_cone(
    depth_m: Float32Array,
    intrinsics: Intrinsics,
    direction_optical: FloatArray,
    half_angle_rad: float,
    support_pixels: int = 8,
) -> float:
    """Distance (m, along the ray) to the nearest return inside a cone about the direction of travel.

    depth_m: (H, W) along the optical axis; NaN, infinity and anything not positive are no return and say nothing.
    direction_optical: (3,) in the depth imager's optical RDF axes, need not be of unit length.
    support_pixels: the answer is the distance that this many pixels reach or fall below, so single speckles do not count.
    Returns infinity if the cone holds fewer returns than that, or there is no direction: absence of returns is NOT
    free space, the caller has to judge coverage. Raises ValueError if the shape does not fit the intrinsics.
    """
    if depth_m.shape != (intrinsics.height, intrinsics.width):
        raise ValueError(f"depth is {depth_m.shape}, intrinsics say {(intrinsics.height, intrinsics.width)}")
    length = float(np.linalg.norm(direction_optical))
    if not math.isfinite(length) or length < 1e-9:
        return math.inf
    bearings = intrinsics.bearings()
    range_per_depth = np.linalg.norm(bearings, axis=-1)
    cosine = bearings @ (np.asarray(direction_optical, dtype=np.float64) / length) / range_per_depth
    with np.errstate(invalid="ignore"):
        seen = (cosine >= math.cos(half_angle_rad)) & np.isfinite(depth_m) & (depth_m > 0.0)
    distances = (depth_m * range_per_depth)[seen]
    if distances.size < support_pixels:
        return math.inf
    return float(np.partition(distances, support_pixels - 1)[support_pixels - 1])
