"""Texture atlas of a mesh: axis-aligned charts, packed on shelves, with texel world points.

Each face belongs to the axis nearest to its smoothed normal. Connected faces of one axis form a chart, which is projected
along the axis. So a wall is one chart, its faces share vertices, and all texels have the same size, apart from the slant of
the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import Float32Array, FloatArray, IntArray

SMOOTHINGS = 4  # of the normals, so that noise does not split a wall into charts
GUTTER = 2  # texels around a chart
WIDEST = 8192  # maximum texture side in texels, supported by any graphics card


@dataclass(frozen=True, slots=True, eq=False)
class TextureAtlas:
    """A mesh cut into charts.

    source (W,): original vertex of each copy; faces (F, 3) of copies; uv (W, 2) in 0..1, v up. texels (T, 2): row and column
    of each texel in use in an image of side x side; points (T, 3) float32: its world point.
    """

    source: IntArray
    faces: IntArray
    uv: Float32Array
    side: int
    texels: IntArray
    points: Float32Array


def unwrap(vertices: FloatArray, faces: IntArray, normals: Float32Array, texel_m: float) -> TextureAtlas:
    """Return the atlas of vertices (V, 3), faces (F, 3) and normals (V, 3).

    Texels are enlarged if the texture would exceed WIDEST.
    """
    axis = _axes(faces, _smoothed(faces, normals))
    chart, count = _charts(faces, axis)
    source, cut = _cut(faces, chart)
    corner_chart = np.empty(len(source), dtype=np.int64)
    corner_chart[cut.ravel()] = np.repeat(chart, 3)
    flat = _flattened(vertices[source], _axis_of_chart(chart, axis, count)[corner_chart])
    low, size_m = _frames(flat, corner_chart, count)
    while True:
        cells = np.ceil(size_m / texel_m).astype(np.int64) + 1 + 2 * GUTTER
        place, side = _packed(cells)
        if side <= WIDEST:
            break
        texel_m *= 1.1
    pixel = (flat - low[corner_chart]) / texel_m + GUTTER + 0.5 + place[corner_chart]  # column, row; centres at halves
    where = np.full((side, side, 3), np.nan, dtype=np.float32)
    _fill(cut, pixel, vertices[source], where)
    rows, columns = np.nonzero(np.isfinite(where[:, :, 0]))
    uv = np.stack([pixel[:, 0] / side, 1.0 - pixel[:, 1] / side], axis=1).astype(np.float32)
    return TextureAtlas(source, cut, uv, side, np.stack([rows, columns], axis=1), where[rows, columns])


def _smoothed(faces: IntArray, normals: Float32Array) -> FloatArray:
    """Return normals averaged over SMOOTHINGS rings of neighbours."""
    smooth = normals.astype(np.float64)
    for _ in range(SMOOTHINGS):
        of_face = smooth[faces].sum(axis=1)
        smooth = np.stack(
            [np.bincount(faces.ravel(), np.repeat(of_face[:, a], 3), minlength=len(normals)) for a in range(3)], axis=1
        )
        smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-12)
    return smooth


def _axes(faces: IntArray, normals: FloatArray) -> IntArray:
    """Return 0 to 5 for +x, +y, +z, -x, -y, -z of each face (F,)."""
    mean = normals[faces].sum(axis=1)
    axis: IntArray = np.concatenate([mean, -mean], axis=1).argmax(axis=1)
    return axis


def _charts(faces: IntArray, axis: IntArray) -> tuple[IntArray, int]:
    """Return the chart number of each face (F,), and the number of charts.

    A chart is a set of faces of one axis that are connected by edges.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    key = edges[:, 0] * (int(faces.max(initial=0)) + 1) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    twin = key[order[1:]] == key[order[:-1]]
    a, b = order[:-1][twin] // 3, order[1:][twin] // 3
    same = axis[a] == axis[b]
    links = (np.ones(int(same.sum()), dtype=np.int8), (a[same], b[same]))
    count, chart = connected_components(coo_matrix(links, shape=(len(faces), len(faces))), directed=False)
    return chart.astype(np.int64), int(count)


def _cut(faces: IntArray, chart: IntArray) -> tuple[IntArray, IntArray]:
    """Return one vertex copy per chart: source (W,) and faces (F, 3) of copies."""
    many = int(faces.max(initial=0)) + 1
    copies, named = np.unique(chart[:, None] * many + faces, return_inverse=True)
    return copies % many, named.reshape(-1, 3)


def _axis_of_chart(chart: IntArray, axis: IntArray, count: int) -> IntArray:
    of_chart = np.zeros(count, dtype=np.int64)
    of_chart[chart] = axis
    return of_chart


def _flattened(points: FloatArray, axis: IntArray) -> FloatArray:
    """Return metres across and down (W, 2) of points (W, 3), projected along their axes.

    Walls are upright.
    """
    across, down = np.array([1, 0, 0]), np.array([2, 2, 1])
    n = np.arange(len(points))
    return np.stack([points[n, across[axis % 3]], -points[n, down[axis % 3]]], axis=1)


def _frames(flat: FloatArray, chart: IntArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the lower corner and the size of each chart (C, 2)."""
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, chart, flat)
    np.maximum.at(high, chart, flat)
    return low, high - low


def _packed(cells: IntArray) -> tuple[IntArray, int]:
    """Pack charts on shelves, tallest first; returns column and row (C, 2), and the image side.

    cells (C, 2): width and height of each chart in texels.
    """
    order = np.lexsort((cells[:, 0], cells[:, 1]))[::-1]
    side = max(64, int(cells.max(initial=1)), int(np.sqrt(cells.prod(axis=1).sum())))
    while True:
        place = np.zeros_like(cells)
        if _shelve(cells, order, side, place) <= side:
            return place, side
        side = int(side * 1.05) + 1


@kernel
def _shelve(cells: IntArray, order: IntArray, side: int, place: IntArray) -> int:
    column, row, height = 0, 0, 0
    for n in range(order.shape[0]):
        chart = order[n]
        if column + cells[chart, 0] > side:
            column, row, height = 0, row + height, 0
        place[chart, 0], place[chart, 1] = column, row
        column += cells[chart, 0]
        height = max(height, cells[chart, 1])
    return row + height


@kernel
def _fill(faces: IntArray, pixel: FloatArray, vertices: FloatArray, where: Float32Array) -> None:
    """Compute the world point of each texel within GUTTER texels of a face.

    The point is that of the nearest face. where: (side, side, 3); distances are measured from the centre of the texel.
    """
    side = where.shape[0]
    apart = np.full((side, side), np.float32(GUTTER * GUTTER), dtype=np.float32)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, bx, by, cx, cy = pixel[a, 0], pixel[a, 1], pixel[b, 0], pixel[b, 1], pixel[c, 0], pixel[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        left, right = max(int(min(ax, bx, cx)) - GUTTER, 0), min(int(max(ax, bx, cx)) + GUTTER + 1, side)
        top, bottom = max(int(min(ay, by, cy)) - GUTTER, 0), min(int(max(ay, by, cy)) + GUTTER + 1, side)
        for row in range(top, bottom):
            for column in range(left, right):
                if apart[row, column] == 0.0:
                    continue
                u, v = column + 0.5, row + 0.5
                wa = wb = wc = 1.0 / 3.0
                if abs(area) > 1e-9:
                    wa = max(((bx - u) * (cy - v) - (by - v) * (cx - u)) / area, 0.0)
                    wb = max(((cx - u) * (ay - v) - (cy - v) * (ax - u)) / area, 0.0)
                    wc = max(((ax - u) * (by - v) - (ay - v) * (bx - u)) / area, 0.0)
                    total = wa + wb + wc
                    wa, wb, wc = wa / total, wb / total, wc / total
                du, dv = wa * ax + wb * bx + wc * cx - u, wa * ay + wb * by + wc * cy - v
                square = np.float32(du * du + dv * dv)
                square = np.float32(0.0) if square < 1e-9 else square  # inside the face
                if square < apart[row, column]:
                    apart[row, column] = square
                    for axis in range(3):
                        where[row, column, axis] = wa * vertices[a, axis] + wb * vertices[b, axis] + wc * vertices[c, axis]
