"""Minimum range grid: nearest returns of one raw depth frame, without pose or map."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

import numpy as np

from uav_recon.types.frames import BoolArray, Float32Array, FloatArray, frozen
from uav_recon.types.pose import Pose

_EVERY = frozen(np.ones((), dtype=bool))


@dataclass(frozen=True, slots=True, eq=False)
class MinRangeGrid:
    """A depth image in cells of equal angle tangents, rows from the top, columns from the left.

    range_m: (rows, columns) float32, distance along the ray to the nearest return in each cell, NaN where it holds too few.
    half_tan: tangents of half the horizontal and half the vertical angle of view. share: of the pixels that had a return.
    consistent: with itself and with earlier frames. Even if it is not, the vehicle does not fly towards the near returns in it.
    full: (rows, columns), cells most of whose pixels had a return. In any other cell, the space in front of the nearest return
    is unknown.
    """

    stamp_s: float
    body_from_depth: Pose
    range_m: Float32Array
    half_tan: tuple[float, float]
    share: float
    consistent: bool = True
    full: BoolArray = field(default_factory=lambda: _EVERY)

    def __post_init__(self) -> None:
        object.__setattr__(self, "range_m", frozen(np.asarray(self.range_m, dtype=np.float32)))

    def points(self) -> FloatArray:
        """Return the returns (N, 3) in the depth imager's axes, along the rays of the cell centres."""
        there = np.isfinite(self.range_m)
        found: FloatArray = ray_directions(self)[there] * self.range_m[there][:, None]
        return found


def ray_directions(grid: MinRangeGrid) -> FloatArray:
    """Return the unit vectors (rows, columns, 3) through the cell centres.

    They are in the depth imager's axes.
    """
    return _rays(*grid.range_m.shape, *grid.half_tan)


def in_view(seen: FloatArray, half_tan: FloatArray, shape: tuple[int, ...]) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Return whether positions (..., 3) lie in a depth imager's view, and their row and column.

    seen: in the depth imager's axes. half_tan: (..., 2). shape: of the view, its last two numbers are rows and columns.
    """
    deep = np.maximum(seen[..., 2], 1e-6)
    rows, columns = shape[-2:]
    u = np.floor((seen[..., 0] / deep / half_tan[..., 0] + 1.0) / 2.0 * columns)
    v = np.floor((seen[..., 1] / deep / half_tan[..., 1] + 1.0) / 2.0 * rows)
    inside: BoolArray = (seen[..., 2] > 0.0) & (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    return inside, v, u


@functools.lru_cache(maxsize=4)  # cameras have one shape each
def _rays(rows: int, columns: int, half_tan_x: float, half_tan_y: float) -> FloatArray:
    """Return the unit vectors (rows, columns, 3) through the cell centres."""
    x = ((np.arange(columns) + 0.5) / columns * 2.0 - 1.0) * half_tan_x
    y = ((np.arange(rows) + 0.5) / rows * 2.0 - 1.0) * half_tan_y
    rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], np.ones((rows, columns))), axis=-1)
    return frozen(rays / np.linalg.norm(rays, axis=-1, keepdims=True))
