"""Points in cells, for distances from a hull to the nearest of them and for what lies straight below a place.

Each cell has the box that its points fill, and a query walks the cells outward until no nearer point can follow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.runtime.jit import kernel

CELL_M = 0.10
_UNDER_M = 0.015  # beside a place, what lies below it
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class PointGrid:
    """Points (N, 3) sorted into cubic cells, for distances from upright cylinders. Immutable."""

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
        self.start: I64 = np.append(first, len(order)).astype(np.int64)  # of each cell that holds points, column by column
        self.columns: I64 = np.searchsorted(column[order][first], np.arange(int(self.shape.prod()) + 1)).astype(np.int64)
        self.boxes: F32 = np.concatenate(
            (np.minimum.reduceat(self.points, first, axis=0), np.maximum.reduceat(self.points, first, axis=0)), axis=1
        )

    def distances(self, positions_m: F64, radius_m: float, half_height_m: float, cap_m: float) -> F64:
        """Distance (M,) from solid cylinders centred at positions_m (M, 3) to the nearest point, at most cap_m."""
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
        """Height (m) of the highest point straight below a place; -inf without one."""
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
    """Rings of columns of cells around the centre; a ring that lies farther than the best so far ends the search."""
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
    """Distance changes by no more than the body moves: near the place asked about before the search need not go far."""
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
    """Of the points beside (x, y) that are no higher than z."""
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
