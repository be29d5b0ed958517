"""Which views a mapper takes: cheap checks that need no map."""

from __future__ import annotations

import numpy as np

from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import AnyArray, FloatArray

PADDING_M = 0.15  # walls lie on the border of the room's box, and noise puts them outside
FEWEST_SHARE = 0.01  # of all pixels must have depth
INSIDE_SHARE = 0.2  # of all end points must lie in the box
STRIDE = 8  # pixels between those that are checked


def padded(box_min_m: FloatArray, box_max_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The box that is mapped. Raises ValueError if it is not a finite box."""
    low = np.asarray(box_min_m, dtype=np.float64) - PADDING_M
    high = np.asarray(box_max_m, dtype=np.float64) + PADDING_M
    if (
        low.shape != (3,)
        or high.shape != (3,)
        or not (np.isfinite(low).all() and np.isfinite(high).all() and (high > low).all())
    ):
        raise ValueError(f"not a box: {box_min_m} to {box_max_m}")
    return low, high


def acceptable(keyframe: PosedFrame, low_m: AnyArray, high_m: AnyArray) -> bool:
    """False if shapes do not fit, nothing was measured, or the view is not of the box low_m to high_m (3,)."""
    frame = keyframe.frame
    lens, colour = frame.depth_intrinsics, frame.rgb_intrinsics
    if frame.depth_m.shape != (lens.height, lens.width) or frame.rgb.shape != (colour.height, colour.width, 3):
        return False
    position = keyframe.world_from_depth.translation_m
    if not ((position > low_m) & (position < high_m)).all():
        return False
    valid = np.isfinite(frame.depth_m) & (frame.depth_m > 0)
    if valid.mean() < FEWEST_SHARE:
        return False
    v, u = np.nonzero(valid)
    v, u = v[::STRIDE], u[::STRIDE]
    z = frame.depth_m[v, u].astype(np.float64)
    points = np.stack([(u - lens.cx) / lens.fx * z, (v - lens.cy) / lens.fy * z, z], axis=1)
    world = keyframe.world_from_depth.apply(points)
    return bool(((world > low_m) & (world < high_m)).all(axis=1).mean() >= INSIDE_SHARE)
