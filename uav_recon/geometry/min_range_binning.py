"""Minimum-range binning: the depth image in cells, each with its nearest return.

The guard uses it when neither map nor pose is valid.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.camera import Frame
from uav_recon.types.frames import Float32Array, FloatArray, IntArray
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import Pose

_ROWS = 12
_COLUMNS = 16
_SUPPORT = 4  # returns that a cell's distance needs, so that a single speckle does not count
_FULL_SHARE = 0.5  # min. share of a cell's pixels with a return for a full cell
_WIDEST_PX = 320  # max. width of the used depth image; more pixels would only cost time


def nearest_in_cells(frame: Frame, body_from_depth: Pose, consistent: bool = True) -> MinRangeGrid:
    """Divide a depth frame into cells and keep each one's nearest return (m, along the ray).

    Takes about 0.1 ms. NaN, infinity and non-positive values are no return: such pixels are neither near nor free.
    """
    lens, stride = frame.depth_intrinsics, -(-frame.depth_intrinsics.width // _WIDEST_PX)
    depth_m = frame.depth_m[::stride, ::stride]
    rows, columns = min(_ROWS, depth_m.shape[0]), min(_COLUMNS, depth_m.shape[1])
    high, wide = depth_m.shape[0] // rows, depth_m.shape[1] // columns
    top, left = (depth_m.shape[0] - rows * high) // 2, (depth_m.shape[1] - columns * wide) // 2  # pixels outside all cells
    u = ((np.arange(columns * wide) + left) * stride - lens.cx) / lens.fx
    v = ((np.arange(rows * high) + top) * stride - lens.cy) / lens.fy
    seen = np.ascontiguousarray(depth_m[top : top + rows * high, left : left + columns * wide])
    range_m, returns = _nearest(seen, u, v, high, wide)
    full = returns > _FULL_SHARE * high * wide
    half_tan = (columns * wide * stride / 2 / lens.fx, rows * high * stride / 2 / lens.fy)
    return MinRangeGrid(
        frame.stamp_s, body_from_depth, range_m, half_tan, float(returns.mean()) / (high * wide), consistent, full
    )


@kernel
def _nearest(depth_m: Float32Array, u: FloatArray, v: FloatArray, high: int, wide: int) -> tuple[Float32Array, IntArray]:
    """Return the _SUPPORT-th nearest return of each cell (m, along the ray), and its count.

    A cell has high by wide pixels. NaN where a cell has fewer returns.

    depth_m (H, W); u (W,), v (H,): tangents of the pixels' rays.
    """
    rows, columns = len(v) // high, len(u) // wide
    wanted, returns = min(_SUPPORT, high * wide), np.zeros((rows, columns), dtype=np.int64)
    out = np.empty((rows, columns), dtype=np.float32)
    nearest = np.empty(wanted)
    for row in range(rows):
        for column in range(columns):
            nearest[:] = np.inf
            for i in range(row * high, (row + 1) * high):
                for j in range(column * wide, (column + 1) * wide):
                    z = float(depth_m[i, j])
                    if not (np.isfinite(z) and z > 0.0):
                        continue
                    returns[row, column] += 1
                    away_m, k = z * np.sqrt(1.0 + u[j] ** 2 + v[i] ** 2), wanted - 1
                    if away_m >= nearest[k]:
                        continue
                    while k > 0 and nearest[k - 1] > away_m:
                        nearest[k] = nearest[k - 1]
                        k -= 1
                    nearest[k] = away_m
            out[row, column] = nearest[wanted - 1] if np.isfinite(nearest[wanted - 1]) else np.nan
    return out, returns


def warm_up() -> None:
    """Compile every kernel."""
    _nearest(np.zeros((2, 2), dtype=np.float32), np.zeros(2), np.zeros(2), 1, 1)
