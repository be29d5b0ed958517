"""Nearest triangle in each pixel: chunks of triangles drawn into a 1/z buffer, near to far.

An image of a scanned room has more triangles than pixels, so speed depends on early rejection: of a chunk outside the
frustum or behind drawn surfaces, of a triangle that covers no pixel centre, and of a triangle behind every pixel that it
may cover. Only the remaining triangles are rasterised.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.runtime.jit import kernel

CHUNK_FACES = 128
WIDE_PX = 24  # for a wider triangle the covered part of each row is computed first
SMALL_PX = 4  # a triangle over at most this many rows and columns is drawn by _fill_small()
_ROUNDING = 1.0 + 1e-6  # margin for the rounding of 1/z to 32 bits
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
U16 = NDArray[np.uint16]


@kernel
def _box_outside(low: F32, high: F32, camera_from_world: F64, planes: F64) -> bool:
    """Return True if a box lies wholly outside one of the half-spaces a.x >= b.

    planes: rows (ax, ay, az, b) in the camera frame.
    """
    r, t = camera_from_world[:3, :3], camera_from_world[:3, 3]
    for p in range(planes.shape[0]):
        reach = planes[p, 0] * t[0] + planes[p, 1] * t[1] + planes[p, 2] * t[2]
        for axis in range(3):
            n = planes[p, 0] * r[0, axis] + planes[p, 1] * r[1, axis] + planes[p, 2] * r[2, axis]
            reach += n * (high[axis] if n > 0 else low[axis])
        if reach < planes[p, 3]:
            return True
    return False


@kernel
def _nearest(low: F32, high: F32, camera_from_world: F64) -> float:
    """Return the smallest depth of a box along the optical axis; negative behind the camera."""
    depth: float = camera_from_world[2, 3]
    for axis in range(3):
        r = camera_from_world[2, axis]
        depth += r * (low[axis] if r > 0 else high[axis])
    return depth


@kernel
def _hidden(low: F32, high: F32, camera_from_world: F64, intrinsics: F64, nearest_w: float, inverse_z: F32) -> bool:
    """Return True if every pixel a box may cover shows a surface nearer than 1 / nearest_w.

    The box must be in front of the camera.
    """
    u_low, u_high, v_low, v_high = np.inf, -np.inf, np.inf, -np.inf
    m = camera_from_world
    for corner in range(8):
        x = np.float64(high[0] if corner & 1 else low[0])
        y = np.float64(high[1] if corner & 2 else low[1])
        z = np.float64(high[2] if corner & 4 else low[2])
        w = 1.0 / (m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
        u = intrinsics[0] * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) * w + intrinsics[2]
        v = intrinsics[1] * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) * w + intrinsics[3]
        u_low, u_high, v_low, v_high = min(u_low, u), max(u_high, u), min(v_low, v), max(v_high, v)
    height, width = inverse_z.shape
    for v_pixel in range(max(int(np.floor(v_low)), 0), min(int(np.ceil(v_high)), height - 1) + 1):
        for u_pixel in range(max(int(np.floor(u_low)), 0), min(int(np.ceil(u_high)), width - 1) + 1):
            if inverse_z[v_pixel, u_pixel] <= nearest_w:
                return False
    return True


@kernel
def _narrowed(at_zero: float, slope: float, first: int, last: int) -> tuple[int, int]:
    """Return the part of a row, plus a pixel on either side, in which at_zero + slope u >= 0."""
    if slope > 0.0:
        return max(first, int(np.floor(min(max(-at_zero / slope, first - 1.0), last + 1.0))) - 1), last
    if slope < 0.0:
        return first, min(last, int(np.ceil(max(min(-at_zero / slope, last + 1.0), first - 1.0))) + 1)
    return first, last


@kernel
def _fill(
    x0: float, y0: float, w0: float, x1: float, y1: float, w1: float, x2: float, y2: float, w2: float,
    face_id: int, inverse_z: F32, face: I32,
) -> None:  # fmt: skip
    """Draw one projected triangle (x, y in pixels, w = 1/z).

    Edges are inclusive, so that adjacent triangles leave no gap.
    """
    height, width = inverse_z.shape
    u_low = max(int(np.ceil(min(x0, x1, x2) - 1e-9)), 0)
    u_high = min(int(np.floor(max(x0, x1, x2) + 1e-9)), width - 1)
    v_low = max(int(np.ceil(min(y0, y1, y2) - 1e-9)), 0)
    v_high = min(int(np.floor(max(y0, y1, y2) + 1e-9)), height - 1)
    if u_low > u_high or v_low > v_high:
        return
    area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    if area == 0.0:
        return
    scale = 1.0 / area
    du1, dv1 = (y2 - y0) * scale, -(x2 - x0) * scale
    du2, dv2 = -(y1 - y0) * scale, (x1 - x0) * scale
    dw1, dw2 = w1 - w0, w2 - w0
    dwu, dwv = du1 * dw1 + du2 * dw2, dv1 * dw1 + dv2 * dw2
    wide = u_high - u_low > WIDE_PX
    for v in range(v_low, v_high + 1):
        first, last = u_low, u_high
        if wide:
            b1, b2 = (v - y0) * dv1 - x0 * du1, (v - y0) * dv2 - x0 * du2
            first, last = _narrowed(b1, du1, first, last)
            first, last = _narrowed(b2, du2, first, last)
            first, last = _narrowed(1.0 - b1 - b2, -du1 - du2, first, last)
        b1 = (first - x0) * du1 + (v - y0) * dv1
        b2 = (first - x0) * du2 + (v - y0) * dv2
        w = w0 + (first - x0) * dwu + (v - y0) * dwv
        for u in range(first, last + 1):
            if b1 >= -1e-9 and b2 >= -1e-9 and b1 + b2 <= 1.0 + 1e-9 and w > inverse_z[v, u]:
                inverse_z[v, u] = w
                face[v, u] = face_id
            b1 += du1
            b2 += du2
            w += dwu


@kernel
def _fill_small(
    x0: float, y0: float, w0: float, x1: float, y1: float, w1: float, x2: float, y2: float, w2: float,
    u_low: int, u_high: int, v_low: int, v_high: int, face_id: int, inverse_z: F32, face: I32,
) -> None:  # fmt: skip
    """Draw a triangle over a few pixels, as _fill() does.

    The depth test comes first, and there is no division before a pixel is known to lie in the triangle.
    """
    nearest_w = max(w0, w1, w2) * _ROUNDING
    dx1, dy1, dx2, dy2 = x1 - x0, y1 - y0, x2 - x0, y2 - y0
    area = dx1 * dy2 - dy1 * dx2
    if area < 0.0:
        dx1, dy1, dx2, dy2, w1, w2, area = dx2, dy2, dx1, dy1, w2, w1, -area
    if area == 0.0:
        return
    least, most = -1e-9 * area, (1.0 + 1e-9) * area
    for v in range(v_low, v_high + 1):
        for u in range(u_low, u_high + 1):
            shown = inverse_z[v, u]
            if shown >= nearest_w:
                continue
            e1 = (u - x0) * dy2 - (v - y0) * dx2
            e2 = (v - y0) * dx1 - (u - x0) * dy1
            if e1 >= least and e2 >= least and e1 + e2 <= most:
                w = w0 + (e1 * (w1 - w0) + e2 * (w2 - w0)) / area
                if w > shown:
                    inverse_z[v, u] = w
                    face[v, u] = face_id


@kernel
def _fill_clipped(corners: F64, near: float, intrinsics: F64, face_id: int, inverse_z: F32, face: I32) -> None:
    """Clip a triangle (3, 3), camera axes, at the near plane (Sutherland-Hodgman) and draw it."""
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    xs, ys, ws = np.empty(4), np.empty(4), np.empty(4)
    n = 0
    for i in range(3):
        a, b = corners[i], corners[(i + 1) % 3]
        if a[2] >= near:
            xs[n], ys[n], ws[n] = fx * a[0] / a[2] + cx, fy * a[1] / a[2] + cy, 1.0 / a[2]
            n += 1
        if (a[2] >= near) != (b[2] >= near):
            s = (near - a[2]) / (b[2] - a[2])
            xs[n] = fx * (a[0] + s * (b[0] - a[0])) / near + cx
            ys[n] = fy * (a[1] + s * (b[1] - a[1])) / near + cy
            ws[n] = 1.0 / near
            n += 1
    for i in range(1, n - 1):
        _fill(
            xs[0], ys[0], ws[0], xs[i], ys[i], ws[i], xs[i + 1], ys[i + 1], ws[i + 1], face_id, inverse_z, face
        )  # fmt: skip


@kernel
def _project(
    vertices: F32, camera_from_world: F64, intrinsics: F64, height: int, width: int, points: F64, screen: F64, after: I32
) -> None:
    """Transform vertices (V, 3) into camera axes and project them, into the given arrays.

    points: camera axes. screen: (u, v, 1/z). after: row (upper 16 bits) and column (lower 16 bits), each plus 2, of the
    first pixel centre at or after the vertex; undefined behind the camera.
    """
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    m = camera_from_world
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    right, bottom = width + 1.0, height + 1.0
    px, py, pz, su, sv, sw = points[0], points[1], points[2], screen[0], screen[1], screen[2]
    for k in range(vertices.shape[0]):
        x, y, z = np.float64(vertices[k, 0]), np.float64(vertices[k, 1]), np.float64(vertices[k, 2])
        px[k] = m00 * x + m01 * y + m02 * z + m03
        py[k] = m10 * x + m11 * y + m12 * z + m13
        pz[k] = m20 * x + m21 * y + m22 * z + m23
    for k in range(vertices.shape[0]):
        w = 1.0 / pz[k]
        sw[k], su[k], sv[k] = w, fx * px[k] * w + cx, fy * py[k] * w + cy
    for k in range(vertices.shape[0]):
        column = np.int32(np.ceil(min(max(su[k], -2.0), right) - 1e-9) + 2.0)
        row = np.int32(np.ceil(min(max(sv[k], -2.0), bottom) - 1e-9) + 2.0)
        after[k] = row * np.int32(65536) + column


@kernel
def rasterise(  # noqa: C901
    vertices: F32,
    faces: U16,
    vertex_start: I32,
    low: F32,
    high: F32,
    camera_from_world: F64,
    intrinsics: F64,
    near: float,
    far: float,
    inverse_z: F32,
    face: I32,
) -> None:
    """Write inverse_z (H, W) and the nearest face (H, W) of all chunks in the frustum.

    vertices (V, 3), m. faces (F, 3): indices within the vertex list of their chunk. low, high: bounding boxes of the
    chunks. near, far: limits of depth, m.
    """
    height, width = inverse_z.shape
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    planes = np.zeros((6, 4))
    planes[0, 2], planes[0, 3] = 1.0, near
    planes[1, 0], planes[1, 2] = fx, cx + 0.5
    planes[2, 0], planes[2, 2] = -fx, width - 0.5 - cx
    planes[3, 1], planes[3, 2] = fy, cy + 0.5
    planes[4, 1], planes[4, 2] = -fy, height - 0.5 - cy
    planes[5, 2], planes[5, 3] = -1.0, -far
    points = np.empty((3, 3 * CHUNK_FACES))
    screen = np.empty((3, 3 * CHUNK_FACES))
    after = np.empty(3 * CHUNK_FACES, np.int32)
    corners = np.empty((3, 3))
    seen = np.empty(low.shape[0], np.int64)
    nearest = np.empty(low.shape[0])
    count = 0
    for chunk in range(low.shape[0]):
        if not _box_outside(low[chunk], high[chunk], camera_from_world, planes):
            seen[count], nearest[count] = chunk, _nearest(low[chunk], high[chunk], camera_from_world)
            count += 1
    for place in np.argsort(nearest[:count], kind="mergesort"):  # near to far, so that hidden chunks can be skipped
        chunk = seen[place]
        whole = nearest[place] > near
        if whole and _hidden(low[chunk], high[chunk], camera_from_world, intrinsics, 1.0 / nearest[place], inverse_z):
            continue
        own = vertices[vertex_start[chunk] : vertex_start[chunk + 1]]
        _project(own, camera_from_world, intrinsics, height, width, points, screen, after)
        first = chunk * CHUNK_FACES
        triangles = faces[first : first + CHUNK_FACES]
        for t in range(triangles.shape[0]):
            f = first + t
            a, b, c = np.uint64(triangles[t, 0]), np.uint64(triangles[t, 1]), np.uint64(triangles[t, 2])
            ahead = 3 if whole else (points[2, a] >= near) + (points[2, b] >= near) + (points[2, c] >= near)
            if ahead == 3:
                ka, kb, kc = after[a], after[b], after[c]
                turns = (ka ^ kb) | (ka ^ kc)
                if turns & 0xFFFF == 0 or turns >> 16 == 0:
                    continue  # covers no pixel centre, or lies outside the image
                v_low, v_high = max((min(ka, kb, kc) >> 16) - 2, 0), min((max(ka, kb, kc) >> 16) - 3, height - 1)
                ka, kb, kc = ka & 0xFFFF, kb & 0xFFFF, kc & 0xFFFF
                u_low, u_high = max(min(ka, kb, kc) - 2, 0), min(max(ka, kb, kc) - 3, width - 1)
                if u_high - u_low < SMALL_PX and v_high - v_low < SMALL_PX:
                    _fill_small(
                        screen[0, a], screen[1, a], screen[2, a], screen[0, b], screen[1, b], screen[2, b],
                        screen[0, c], screen[1, c], screen[2, c], u_low, u_high, v_low, v_high, f, inverse_z, face,
                    )  # fmt: skip
                    continue
                _fill(
                    screen[0, a], screen[1, a], screen[2, a], screen[0, b], screen[1, b], screen[2, b],
                    screen[0, c], screen[1, c], screen[2, c], f, inverse_z, face,
                )  # fmt: skip
            elif ahead > 0:
                for k in range(3):
                    corners[0, k], corners[1, k], corners[2, k] = points[k, a], points[k, b], points[k, c]
                _fill_clipped(corners, near, intrinsics, f, inverse_z, face)
