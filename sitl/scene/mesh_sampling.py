"""Point samples of triangle meshes (dense or area-weighted), and the height below a point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.runtime.jit import kernel

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
COLUMN_CELLS = 12  # cells per side of a column, small enough that its occupancy flags stay in the CPU cache


def dense_points(vertices: F32, faces: I32, spacing_m: float) -> F32:
    """Return points (N, 3) float32 such that every surface point has one within about spacing_m.

    On a triangular grid of step h no surface point is farther than h / sqrt(3) from a grid point; here h is
    1.4 spacing_m. One point is kept in each cell of a quarter of the spacing.
    """
    used = np.zeros(len(vertices), bool)
    used[faces.ravel()] = True
    inner = _grid_points(vertices, faces, 1.4 * spacing_m)
    points = np.concatenate([vertices[used], inner])
    return points[_first_of_cells(points, points.min(axis=0), points.max(axis=0), np.float32(0.25 * spacing_m))]


def area_weighted_samples(vertices: F32, faces: I32, count: int, seed: int) -> tuple[F32, F32]:
    """Return points (count, 3), uniform over the area, and unit normals (count, 3); float32.

    The normals are those of the triangles on which the points lie.
    """
    rng = np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    cumulative = np.cumsum(area)
    chosen = np.searchsorted(cumulative, rng.random(count) * cumulative[-1], side="right").clip(max=len(faces) - 1)
    root, other = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    points = a[chosen] * (1 - root) + b[chosen] * (root * (1 - other)) + c[chosen] * (root * other)
    return points.astype(np.float32), (normals[chosen] / area[chosen, None]).astype(np.float32)


def height_below(vertices: F32, faces: I32, point_m: NDArray[np.float64]) -> float | None:
    """Return z (m) of the highest surface straight below point_m (3,), or None."""
    z = float(_height_below(vertices, faces, np.asarray(point_m, np.float64)))
    return None if np.isnan(z) else z


def row_points(vertices: F32, faces: I32, spacing_m: float) -> F32:
    """Return points (N, 3) float32 such that every surface point has one within about spacing_m.

    They are the vertices, and rows of points along the longest edge of each triangle. Rows, and points of a row, are
    1.4 spacing_m apart at most, so that no surface point is farther than 1.4 spacing_m / sqrt(2) from one. On long thin
    triangles these are a tenth of the points of dense_points().
    """
    used = np.zeros(len(vertices), bool)
    used[faces.ravel()] = True
    return np.concatenate([vertices[used], _rows(vertices, faces, 1.4 * spacing_m)])


@kernel
def _rows(vertices: F32, faces: I32, step_m: float) -> F32:  # noqa: C901, PLR0912
    """Return the points of row_points() other than the vertices."""
    out, total = np.empty((1024, 3), np.float32), 0
    a, b, c = np.empty(3), np.empty(3), np.empty(3)
    for f in range(faces.shape[0]):
        longest, base = 0.0, 0
        for i in range(3):
            edge = 0.0
            for k in range(3):
                d = np.float64(vertices[faces[f, i], k]) - np.float64(vertices[faces[f, (i + 1) % 3], k])
                edge += d * d
            if edge > longest:
                longest, base = edge, i
        if longest <= step_m * step_m:
            continue
        for k in range(3):
            a[k], b[k] = vertices[faces[f, base], k], vertices[faces[f, (base + 1) % 3], k]
            c[k] = vertices[faces[f, (base + 2) % 3], k]
        length, along, aside = np.sqrt(longest), 0.0, 0.0
        for k in range(3):
            along += (c[k] - a[k]) * (b[k] - a[k]) / length
            aside += (c[k] - a[k]) ** 2
        rows = max(1, int(np.ceil(np.sqrt(max(aside - along * along, 0.0)) / step_m)))
        for row in range(rows):
            up = row / rows
            parts = max(1, int(np.ceil(length * (1.0 - up) / step_m)))
            if total + parts + 1 > out.shape[0]:
                larger = np.empty((2 * (total + parts + 1), 3), np.float32)
                for n in range(total):
                    for k in range(3):
                        larger[n, k] = out[n, k]
                out = larger
            ends = 1 if row == 0 else 0  # the ends of the longest edge are vertices, returned already
            for part in range(ends, parts + 1 - ends):
                for k in range(3):
                    left = a[k] + up * (c[k] - a[k])
                    out[total, k] = left + part / parts * (1.0 - up) * (b[k] - a[k])
                total += 1
    return out[:total].copy()


@kernel
def _grid_points(vertices: F32, faces: I32, step_m: float) -> F32:
    """Return the barycentric grid points, without corners, of triangles longer than step_m."""
    steps = np.zeros(faces.shape[0], np.int64)
    total = 0
    for f in range(faces.shape[0]):
        longest = 0.0
        for i in range(3):
            edge = 0.0
            for k in range(3):
                d = np.float64(vertices[faces[f, i], k]) - np.float64(vertices[faces[f, (i + 1) % 3], k])
                edge += d * d
            longest = max(longest, edge)
        n = max(1, int(np.ceil(np.sqrt(longest) / step_m)))
        steps[f] = n
        total += (n + 1) * (n + 2) // 2 - 3
    out = np.empty((total, 3), np.float32)
    row = 0
    for f in range(faces.shape[0]):
        n = steps[f]
        for i in range(n + 1):
            for j in range(n + 1 - i):
                if n in (i, j) or i + j == 0:
                    continue
                for k in range(3):
                    out[row, k] = (
                        i * vertices[faces[f, 0], k] + j * vertices[faces[f, 1], k] + (n - i - j) * vertices[faces[f, 2], k]
                    ) / n
                row += 1
    return out


@kernel
def _cell(value: np.float32, low: np.float32, size: np.float32) -> int:
    return int(np.floor((value - low) / size))


@kernel
def _first_of_cells(points: F32, low: F32, high: F32, size: np.float32) -> I32:
    """Return the index of the first point in each cubic cell, one column of cells after another."""
    wide, tall = _cell(high[1], low[1], size) // COLUMN_CELLS + 1, _cell(high[2], low[2], size) + 1
    start = np.zeros((_cell(high[0], low[0], size) // COLUMN_CELLS + 1) * wide + 1, np.int64)
    column = np.empty(points.shape[0], np.int32)
    for p in range(points.shape[0]):
        i, j = _cell(points[p, 0], low[0], size) // COLUMN_CELLS, _cell(points[p, 1], low[1], size) // COLUMN_CELLS
        column[p] = i * wide + j
        start[column[p] + 1] += 1
    start = np.cumsum(start)
    place, order = start.copy(), np.empty(points.shape[0], np.int32)
    for p in range(points.shape[0]):
        order[place[column[p]]] = p
        place[column[p]] += 1
    taken, count = np.zeros((COLUMN_CELLS, COLUMN_CELLS, tall), np.bool_), 0
    for c in range(start.shape[0] - 1):
        for n in range(start[c], start[c + 1]):
            p = order[n]
            i, j = _cell(points[p, 0], low[0], size) % COLUMN_CELLS, _cell(points[p, 1], low[1], size) % COLUMN_CELLS
            k = _cell(points[p, 2], low[2], size)
            if not taken[i, j, k]:
                taken[i, j, k] = True
                order[count] = p
                count += 1
        taken[:] = False
    return order[:count].copy()


@kernel
def _height_below(vertices: F32, faces: I32, point: F64) -> float:
    best = np.nan
    for f in range(faces.shape[0]):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        ax, ay = a[0] - point[0], a[1] - point[1]
        bx, by = b[0] - point[0], b[1] - point[1]
        cx, cy = c[0] - point[0], c[1] - point[1]
        wa, wb, wc = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
        area = wa + wb + wc
        inside = (wa >= 0 and wb >= 0 and wc >= 0) or (wa <= 0 and wb <= 0 and wc <= 0)
        if area == 0.0 or not inside:
            continue
        z = (wa * a[2] + wb * b[2] + wc * c[2]) / area
        if z <= point[2] and (np.isnan(best) or z > best):
            best = z
    return best
