"""Distance from points to a triangle soup: a bounding-box tree in numba, exact, without a heavy dependency."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import FloatArray, IntArray

_LEAF_TRIANGLES = 6
_MORTON_BITS = 20


class TriangleIndex:
    """Triangles sorted along a space-filling curve, under a complete binary tree of boxes.

    vertices (V, 3) metres and faces (F, 3), in any one frame; F >= 1. Degenerate triangles count as the segment or
    point that they are. Raises ValueError on an empty or non-finite soup.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        corners = np.ascontiguousarray(np.asarray(vertices, dtype=np.float64)[np.asarray(faces, dtype=np.int64)])
        if len(corners) == 0 or not np.isfinite(corners).all():
            raise ValueError(f"a triangle index needs finite triangles, got {len(corners)}")
        self._lower = corners.min(axis=(0, 1))
        self._upper = corners.max(axis=(0, 1))
        self._corners = np.ascontiguousarray(corners[np.argsort(self._curve(corners.mean(axis=1)), kind="stable")])
        leaves = 1
        while leaves * _LEAF_TRIANGLES < len(corners):
            leaves *= 2
        self._boxes = _build(self._corners, leaves)

    def distance(self, points: FloatArray) -> FloatArray:
        """Distance (N,) in metres from each point (N, 3) to the nearest triangle. Raises ValueError if not finite."""
        points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        if not np.isfinite(points).all():
            raise ValueError("query points are not finite")
        order = np.argsort(self._curve(points), kind="stable")  # neighbours in a row: each bounds the next one's search
        found = np.empty(len(points))
        found[order] = _query(points[order], self._corners, self._boxes)
        return found

    def _curve(self, points: FloatArray) -> IntArray:
        """Place on a Morton curve (N,) of points (N, 3)."""
        extent = np.maximum(self._upper - self._lower, 1e-9)
        cells = np.clip((points - self._lower) / extent, 0.0, 1.0) * (2**_MORTON_BITS - 1)
        return _morton(cells.astype(np.int64))


def warm_up() -> None:
    """Compile every kernel of this file."""
    TriangleIndex(np.eye(3), np.array([[0, 1, 2]])).distance(np.zeros((2, 3)))


@kernel
def _morton(cells: IntArray) -> IntArray:
    code = np.zeros(cells.shape[0], dtype=np.int64)
    for n in range(cells.shape[0]):
        for bit in range(_MORTON_BITS):
            for axis in range(3):
                code[n] |= ((cells[n, axis] >> bit) & 1) << (3 * bit + axis)
    return code


@kernel
def _build(corners: FloatArray, leaves: int) -> FloatArray:
    """Boxes (2 * leaves, 6) as a heap: node i has children 2i and 2i+1, leaf l is node leaves + l."""
    count = corners.shape[0]
    boxes = np.empty((2 * leaves, 6), dtype=np.float64)
    boxes[:, :3] = np.inf
    boxes[:, 3:] = -np.inf
    for leaf in range(leaves):
        node = leaves + leaf
        for t in range(leaf * count // leaves, (leaf + 1) * count // leaves):
            for corner in range(3):
                for axis in range(3):
                    boxes[node, axis] = min(boxes[node, axis], corners[t, corner, axis])
                    boxes[node, 3 + axis] = max(boxes[node, 3 + axis], corners[t, corner, axis])
    for node in range(leaves - 1, 0, -1):
        for axis in range(3):
            boxes[node, axis] = min(boxes[2 * node, axis], boxes[2 * node + 1, axis])
            boxes[node, 3 + axis] = max(boxes[2 * node, 3 + axis], boxes[2 * node + 1, 3 + axis])
    return boxes


@kernel
def _box_distance2(box: FloatArray, x: float, y: float, z: float) -> float:
    dx = max(box[0] - x, 0.0, x - box[3])
    dy = max(box[1] - y, 0.0, y - box[4])
    dz = max(box[2] - z, 0.0, z - box[5])
    return float(dx * dx + dy * dy + dz * dz)


@kernel
def _triangle_distance2(t: FloatArray, x: float, y: float, z: float) -> float:
    """Squared distance to one triangle (Ericson, Real-Time Collision Detection, section 5.1.5)."""
    abx, aby, abz = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    acx, acy, acz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    apx, apy, apz = x - t[0, 0], y - t[0, 1], z - t[0, 2]
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    v, w = 0.0, 0.0  # the nearest point is a + v ab + w ac
    if d1 > 0.0 or d2 > 0.0:
        bpx, bpy, bpz = x - t[1, 0], y - t[1, 1], z - t[1, 2]
        d3 = abx * bpx + aby * bpy + abz * bpz
        d4 = acx * bpx + acy * bpy + acz * bpz
        cpx, cpy, cpz = x - t[2, 0], y - t[2, 1], z - t[2, 2]
        d5 = abx * cpx + aby * cpy + abz * cpz
        d6 = acx * cpx + acy * cpy + acz * cpz
        va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
        if d3 >= 0.0 and d4 <= d3:
            v = 1.0
        elif d6 >= 0.0 and d5 <= d6:
            w = 1.0
        elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
            v = d1 / (d1 - d3)
        elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
            w = d2 / (d2 - d6)
        elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
            w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
            v = 1.0 - w
        else:
            v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    dx, dy, dz = apx - v * abx - w * acx, apy - v * aby - w * acy, apz - v * abz - w * acz
    return float(dx * dx + dy * dy + dz * dz)


@kernel
def _query(points: FloatArray, corners: FloatArray, boxes: FloatArray) -> FloatArray:
    leaves, count = boxes.shape[0] // 2, corners.shape[0]
    out = np.empty(points.shape[0], dtype=np.float64)
    stack = np.empty(128, dtype=np.int64)
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        best = np.inf
        if n > 0:  # triangle inequality with the point before
            sx, sy, sz = x - points[n - 1, 0], y - points[n - 1, 1], z - points[n - 1, 2]
            reach = out[n - 1] + np.sqrt(sx * sx + sy * sy + sz * sz)
            best = (reach * (1.0 + 1e-9) + 1e-12) ** 2
        stack[0], depth = 1, 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            if _box_distance2(boxes[node], x, y, z) > best:
                continue
            if node >= leaves:
                leaf = node - leaves
                for t in range(leaf * count // leaves, (leaf + 1) * count // leaves):
                    best = min(best, _triangle_distance2(corners[t], x, y, z))
                continue
            near, far = 2 * node, 2 * node + 1
            if _box_distance2(boxes[far], x, y, z) < _box_distance2(boxes[near], x, y, z):
                near, far = far, near
            stack[depth] = far
            stack[depth + 1] = near
            depth += 2
        out[n] = np.sqrt(best)
    return out
