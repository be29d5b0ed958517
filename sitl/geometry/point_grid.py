"""Point cloud sorted into cells, for distances to cylinders and the points below a position.

Each cell stores the bounding box of its points. A distance query visits the cells outward from the position and ends
when the remaining cells cannot hold a nearer point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.runtime.jit import kernel

CELL_M = 0.10
_UNDER_M = 0.015  # horizontal half-width, per axis, within which a point counts as straight below
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class PointGrid:
    """Points (N, 3), m, in cubic cells, for distances from upright cylinders. Immutable."""

    def __init__(self, points_m: F32, cell_m: float = CELL_M) -> None:
        self.cell_m = cell_m
        self.low: F64 = points_m.min(axis=0).astype(np.float64) - 1e-6
        cell = np.floor((points_m - self.low) / cell_m).astype(np.int64)
        self.shape: I64 = cell.max(axis=0)[:2] + 1
        column = cell[:, 0] * self.shape[1] + cell[:, 1]
        key = column * (int(cell[:, 2].max()) + 1) + cell[:, 2]
        order = np.argsort(key, kind="stable")
        self.points: F32 = np.ascontiguousarray(points_m[order])
        first = np.flatnonzero(np.diff(key[order], prepend=-1))
        # index of the first point of each non-empty cell, column by column
        self.start: I64 = np.append(first, len(order)).astype(np.int64)
        self.columns: I64 = np.searchsorted(column[order][first], np.arange(int(self.shape.prod()) + 1)).astype(np.int64)
        self.boxes: F32 = np.concatenate(
            (np.minimum.reduceat(self.points, first, axis=0), np.maximum.reduceat(self.points, first, axis=0)), axis=1
        )

    def distances(self, positions_m: F64, radius_m: float, half_height_m: float, cap_m: float) -> F64:
        """Return the distance (M,), m, from each upright cylinder to its nearest point.

        The cylinders are solid and centred at positions_m (M, 3). Distances are limited to cap_m.
        """
        return _distances(
            np.ascontiguousarray(positions_m, np.float64),
            radius_m,
            half_height_m,
            cap_m,
            self.points,
            self.start,
            self.columns,
            self.boxes,
            self.shape,
            self.low,
            self.cell_m,
        )

    def highest_below(self, x: float, y: float, z: float) -> float:
        """Return the height (m) of the highest point straight below (x, y, z); -inf without one."""
        return float(
            _highest_below(x, y, z, self.points, self.start, self.columns, self.boxes, self.shape, self.low, self.cell_m)
        )


@kernel
def _axis_gap(value: float, low: float, high: float) -> float:
    return max(low - value, value - high, 0.0)


@kernel
def _distance(
    position: F64, radius: float, half: float, cap: float,
    points: F32, start: I64, columns: I64, boxes: F32, shape: I64, low: F64, cell: float,
) -> float:  # fmt: skip
    """Return the distance of one cylinder; search square rings of cell columns around it.

    The search ends at the first ring that lies farther away than the nearest point found.
    """
    x, y, z = position[0], position[1], position[2]
    cx, cy = int(np.floor((x - low[0]) / cell)), int(np.floor((y - low[1]) / cell))
    best = cap
    rings = int(np.ceil((radius + cap) / cell)) + 1
    for ring in range(rings + 1):
        if (ring - 1) * cell - radius >= best:
            break
        for i in range(max(cx - ring, 0), min(cx + ring, shape[0] - 1) + 1):
            step = 1 if abs(i - cx) == ring or ring == 0 else 2 * ring
            for j in range(cy - ring, cy + ring + 1, step):
                if j < 0 or j >= shape[1]:
                    continue
                column = i * shape[1] + j
                for k in range(columns[column], columns[column + 1]):
                    gap_x, gap_y = _axis_gap(x, boxes[k, 0], boxes[k, 3]), _axis_gap(y, boxes[k, 1], boxes[k, 4])
                    flat = max(np.sqrt(gap_x * gap_x + gap_y * gap_y) - radius, 0.0)
                    gap_z = max(boxes[k, 2] - z - half, z - half - boxes[k, 5], 0.0)
                    if flat * flat + gap_z * gap_z >= best * best:
                        continue
                    for p in range(start[k], start[k + 1]):
                        dx, dy = points[p, 0] - x, points[p, 1] - y
                        radial = max(np.sqrt(dx * dx + dy * dy) - radius, 0.0)
                        axial = max(abs(points[p, 2] - z) - half, 0.0)
                        best = min(best, np.sqrt(radial * radial + axial * axial))
    return best


@kernel
def _distances(
    positions: F64, radius: float, half: float, cap: float,
    points: F32, start: I64, columns: I64, boxes: F32, shape: I64, low: F64, cell: float,
) -> F64:  # fmt: skip
    """Return the distance for each position.

    The distance changes by no more than the step from the previous position, which limits the search radius.
    """
    out = np.empty(positions.shape[0])
    for m in range(positions.shape[0]):
        least = cap
        if m > 0:
            step = positions[m] - positions[m - 1]
            least = min(cap, out[m - 1] + np.sqrt((step * step).sum()) + 1e-9)
        out[m] = _distance(positions[m], radius, half, least, points, start, columns, boxes, shape, low, cell)
    return out


@kernel
def _highest_below(
    x: float, y: float, z: float,
    points: F32, start: I64, columns: I64, boxes: F32, shape: I64, low: F64, cell: float,
) -> float:  # fmt: skip
    """Return the height of the highest point near (x, y) that is not above z; -inf without one.

    Near means within _UNDER_M along both axes.
    """
    best = -np.inf
    first_i, last_i = int(np.floor((x - _UNDER_M - low[0]) / cell)), int(np.floor((x + _UNDER_M - low[0]) / cell))
    first_j, last_j = int(np.floor((y - _UNDER_M - low[1]) / cell)), int(np.floor((y + _UNDER_M - low[1]) / cell))
    for i in range(max(first_i, 0), min(last_i, shape[0] - 1) + 1):
        for j in range(max(first_j, 0), min(last_j, shape[1] - 1) + 1):
            column = i * shape[1] + j
            for k in range(columns[column], columns[column + 1]):
                if boxes[k, 2] > z or boxes[k, 5] <= best:
                    continue
                for p in range(start[k], start[k + 1]):
                    beside = abs(points[p, 0] - x) <= _UNDER_M and abs(points[p, 1] - y) <= _UNDER_M
                    if beside and best < points[p, 2] <= z:
                        best = float(points[p, 2])
    return best
