"""The depth image in cells, each with its nearest return: what the guard looks at when it trusts neither map nor pose."""

from __future__ import annotations

import numpy as np

from uav_recon.types.camera import Frame
from uav_recon.types.nearby import Nearby
from uav_recon.types.pose import Pose

_ROWS, _COLUMNS = 12, 16
_SUPPORT = 4  # returns that a cell's distance needs, so that a single speckle does not count
_WIDEST_PX = 320  # of the depth that is looked at; more pixels would only cost time


def nearest_in_cells(frame: Frame, body_from_depth: Pose, believed: bool = True) -> Nearby:
    """Cut a depth frame into cells and keep each one's nearest return (m, along the ray): about 1 ms.

    NaN, infinity and anything not positive are no return and say nothing: neither near nor free.
    """
    lens, stride = frame.depth_intrinsics, -(-frame.depth_intrinsics.width // _WIDEST_PX)
    depth_m = frame.depth_m[::stride, ::stride]
    rows, columns = min(_ROWS, depth_m.shape[0]), min(_COLUMNS, depth_m.shape[1])
    high, wide = depth_m.shape[0] // rows, depth_m.shape[1] // columns
    top, left = (depth_m.shape[0] - rows * high) // 2, (depth_m.shape[1] - columns * wide) // 2  # what no cell takes
    u = ((np.arange(columns * wide) + left) * stride - lens.cx) / lens.fx
    v = ((np.arange(rows * high) + top) * stride - lens.cy) / lens.fy
    per_depth = np.sqrt(1.0 + u[None, :] ** 2 + v[:, None] ** 2)
    seen = depth_m[top : top + rows * high, left : left + columns * wide]
    with np.errstate(invalid="ignore"):
        there = np.isfinite(seen) & (seen > 0.0)
        ranges = np.where(there, seen * per_depth, np.inf)
    cells = ranges.reshape(rows, high, columns, wide).transpose(0, 2, 1, 3).reshape(rows, columns, high * wide)
    kth = min(_SUPPORT, high * wide) - 1
    nearest = np.partition(cells, kth, axis=-1)[..., kth]
    half_tan = (columns * wide * stride / 2 / lens.fx, rows * high * stride / 2 / lens.fy)
    range_m = np.where(np.isfinite(nearest), nearest, np.nan)
    return Nearby(frame.stamp_s, body_from_depth, range_m, half_tan, float(there.mean()), believed)
