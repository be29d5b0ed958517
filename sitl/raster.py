"""Depth, colour and incidence of a triangle mesh seen by a pinhole camera: a z-buffer on one core, without GL.

Triangles lie in spatial chunks with their own vertex lists, so that a chunk out of sight costs one box test and a visible
one transforms each of its vertices once. Visibility is decided first (1/z and face per pixel); colour is then worked out
once per pixel. Pixel (0, 0) is the CENTRE of the first pixel; both sides of a triangle are seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.jit import kernel
from uav_recon.sensors.wire import CameraSpec

CHUNK_FACES = 128
WIDE_PX = 24  # a triangle wider than this is drawn by the part of each row that lies in it
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]


@dataclass(frozen=True)
class Rendering:
    """One picture: depth_m (H, W) along the optical axis, 0 where nothing is; rgb (H, W, 3); incidence_cos (H, W)."""

    depth_m: F32
    rgb: U8
    incidence_cos: F32


class Renderer:
    """A mesh ready to be drawn. Immutable after construction, so any number of threads may render from it at once."""

    def __init__(self, vertices: F32, faces: I32, rgb: U8) -> None:
        """Vertices (V, 3) metres, faces (F, 3) indices, rgb (V, 3)."""
        order = np.argsort(_morton(vertices[faces].mean(axis=1)), kind="stable")
        sorted_faces = faces[order].astype(np.int64)
        chunk_of_face = np.arange(len(faces), dtype=np.int64) // CHUNK_FACES
        key = (chunk_of_face[:, None] * len(vertices) + sorted_faces).ravel()
        unique, local = np.unique(key, return_inverse=True)
        source = unique % len(vertices)
        chunks = int(chunk_of_face[-1]) + 1 if len(faces) else 0
        self._vertices: F32 = np.ascontiguousarray(vertices[source], np.float32)
        self._rgb: U8 = np.ascontiguousarray(rgb[source], np.uint8)
        self._faces: I32 = np.ascontiguousarray(local.reshape(-1, 3), np.int32)
        self._vertex_start: I32 = np.searchsorted(unique // len(vertices), np.arange(chunks + 1)).astype(np.int32)
        self._low, self._high = _boxes(self._vertices, self._vertex_start)

    def depth(self, world_from_camera: F64, spec: CameraSpec, near_m: float = 0.05, far_m: float = math.inf) -> F32:
        """Only the depth (H, W) float32, metres along the optical axis; 0 where nothing is. Blocks for a few milliseconds."""
        inverse_z, _ = self._visible(world_from_camera, spec, near_m, far_m)
        return _depth(inverse_z)

    def render(
        self,
        world_from_camera: F64,
        spec: CameraSpec,
        near_m: float = 0.05,
        far_m: float = math.inf,
        colour: bool = True,
    ) -> Rendering:
        """Draw from world_from_camera (4, 4), RDF axes. Blocks for 10 to 20 ms.

        Nothing nearer than near_m is drawn; what lies beyond far_m may be left out, which saves time. Without colour
        rgb stays black.
        """
        inverse_z, face = self._visible(world_from_camera, spec, near_m, far_m)
        intrinsics = np.array([spec.fx, spec.fy, spec.cx, spec.cy])
        pose = np.ascontiguousarray(world_from_camera, np.float64)
        return Rendering(*_shade(inverse_z, face, self._vertices, self._faces, self._rgb, pose, intrinsics, colour))

    def _visible(self, world_from_camera: F64, spec: CameraSpec, near_m: float, far_m: float) -> tuple[F32, I32]:
        intrinsics = np.array([spec.fx, spec.fy, spec.cx, spec.cy])
        inverse_z = np.zeros((spec.height, spec.width), np.float32)
        face = np.full((spec.height, spec.width), -1, np.int32)
        _rasterise(
            self._vertices,
            self._faces,
            self._vertex_start,
            self._low,
            self._high,
            np.ascontiguousarray(np.linalg.inv(world_from_camera), np.float64),
            intrinsics,
            near_m,
            far_m,
            inverse_z,
            face,
        )
        return inverse_z, face


def warm_up() -> None:
    """Compile every kernel of this file."""
    vertices = np.array([[-1, -1, 1], [1, -1, 1], [0, 1, 1]], np.float32)
    renderer = Renderer(vertices, np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8))
    spec = CameraSpec(8, 8, 4.0, 4.0, 3.5, 3.5)
    renderer.render(np.eye(4), spec)
    renderer.depth(np.eye(4), spec)


def _morton(points: NDArray[np.floating]) -> NDArray[np.uint64]:
    """Order along a Morton curve of 1024 cells a side: neighbours in space become neighbours in the array."""
    low = points.min(axis=0)
    scale = 1023.0 / max(float((points.max(axis=0) - low).max()), 1e-9)
    cells = ((points - low) * scale).astype(np.uint64)
    key = np.zeros(len(points), np.uint64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return key


def _boxes(vertices: F32, start: I32) -> tuple[F32, F32]:
    low = np.minimum.reduceat(vertices, start[:-1], axis=0)
    high = np.maximum.reduceat(vertices, start[:-1], axis=0)
    return np.ascontiguousarray(low), np.ascontiguousarray(high)


@kernel
def _box_outside(low: F32, high: F32, camera_from_world: F64, planes: F64) -> bool:
    """Whether a box lies wholly behind one of the planes a.x >= b, given in the camera frame as rows (ax, ay, az, b)."""
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
    """Smallest depth of a box along the optical axis; negative if it reaches behind the camera."""
    depth: float = camera_from_world[2, 3]
    for axis in range(3):
        r = camera_from_world[2, axis]
        depth += r * (low[axis] if r > 0 else high[axis])
    return depth


@kernel
def _hidden(low: F32, high: F32, camera_from_world: F64, intrinsics: F64, nearest_w: float, inverse_z: F32) -> bool:
    """Whether every pixel that a box ahead of the camera may cover shows something nearer than 1 / nearest_w already."""
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
    """The part of a row, and a pixel more on either side, in which at_zero + slope u >= 0."""
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
    """Draw one projected triangle (pixels, 1/z). Edges are inclusive, so neighbours leave no crack."""
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
def _fill_clipped(corners: F64, near: float, intrinsics: F64, face_id: int, inverse_z: F32, face: I32) -> None:
    """Cut a triangle (3, 3) in camera axes at the near plane (Sutherland-Hodgman) and draw the fan that is left."""
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
def _rasterise(
    vertices: F32,
    faces: I32,
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
    """Fill inverse_z (H, W) and the nearest face (H, W) of all chunks in the frustum."""
    height, width = inverse_z.shape
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    planes = np.zeros((6, 4))
    planes[0, 2], planes[0, 3] = 1.0, near
    planes[1, 0], planes[1, 2] = fx, cx + 0.5
    planes[2, 0], planes[2, 2] = -fx, width - 0.5 - cx
    planes[3, 1], planes[3, 2] = fy, cy + 0.5
    planes[4, 1], planes[4, 2] = -fy, height - 0.5 - cy
    planes[5, 2], planes[5, 3] = -1.0, -far
    r, t = camera_from_world[:3, :3], camera_from_world[:3, 3]
    r00, r01, r02, t0 = r[0, 0], r[0, 1], r[0, 2], t[0]
    r10, r11, r12, t1 = r[1, 0], r[1, 1], r[1, 2], t[1]
    r20, r21, r22, t2 = r[2, 0], r[2, 1], r[2, 2], t[2]
    points = np.empty((3 * CHUNK_FACES, 3))
    screen = np.empty((3 * CHUNK_FACES, 3))
    after = np.empty((3 * CHUNK_FACES, 2), np.int32)  # the first pixel centre at or after a vertex, each way
    corners = np.empty((3, 3))
    seen = np.empty(low.shape[0], np.int64)
    nearest = np.empty(low.shape[0])
    count = 0
    for chunk in range(low.shape[0]):
        if not _box_outside(low[chunk], high[chunk], camera_from_world, planes):
            seen[count], nearest[count] = chunk, _nearest(low[chunk], high[chunk], camera_from_world)
            count += 1
    for place in np.argsort(nearest[:count], kind="mergesort"):  # from near to far, so that what is hidden need not be drawn
        chunk = seen[place]
        if nearest[place] > near and _hidden(
            low[chunk], high[chunk], camera_from_world, intrinsics, 1.0 / nearest[place], inverse_z
        ):  # fmt: skip
            continue
        first = vertex_start[chunk]
        for i in range(first, vertex_start[chunk + 1]):
            x, y, z = np.float64(vertices[i, 0]), np.float64(vertices[i, 1]), np.float64(vertices[i, 2])
            k = i - first
            pz = r20 * x + r21 * y + r22 * z + t2
            px, py = r00 * x + r01 * y + r02 * z + t0, r10 * x + r11 * y + r12 * z + t1
            points[k, 0], points[k, 1], points[k, 2] = px, py, pz
            if pz >= near:
                w = 1.0 / pz
                x, y = fx * px * w + cx, fy * py * w + cy
                screen[k, 0], screen[k, 1], screen[k, 2] = x, y, w
                after[k, 0] = int(np.ceil(min(max(x, -2.0), width + 1.0) - 1e-9))
                after[k, 1] = int(np.ceil(min(max(y, -2.0), height + 1.0) - 1e-9))
        for f in range(chunk * CHUNK_FACES, min((chunk + 1) * CHUNK_FACES, faces.shape[0])):
            a, b, c = faces[f, 0] - first, faces[f, 1] - first, faces[f, 2] - first
            ahead = (points[a, 2] >= near) + (points[b, 2] >= near) + (points[c, 2] >= near)
            if ahead == 3:
                if after[a, 0] == after[b, 0] == after[c, 0] or after[a, 1] == after[b, 1] == after[c, 1]:
                    continue  # between two columns or rows of pixel centres, or outside
                _fill(
                    screen[a, 0], screen[a, 1], screen[a, 2], screen[b, 0], screen[b, 1], screen[b, 2],
                    screen[c, 0], screen[c, 1], screen[c, 2], f, inverse_z, face,
                )  # fmt: skip
            elif ahead > 0:
                corners[0], corners[1], corners[2] = points[a], points[b], points[c]
                _fill_clipped(corners, near, intrinsics, f, inverse_z, face)


@kernel
def _depth(inverse_z: F32) -> F32:
    out = np.zeros_like(inverse_z)
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            if inverse_z[v, u] > 0:
                out[v, u] = np.float32(1.0) / inverse_z[v, u]
    return out


@kernel
def _shade(
    inverse_z: F32, face: I32, vertices: F32, faces: I32, rgb: U8, world_from_camera: F64, intrinsics: F64, coloured: bool
) -> tuple[F32, U8, F32]:
    """Depth, barycentric colour at the pixel's own surface point, and |cos| between ray and face normal."""
    height, width = inverse_z.shape
    depth = np.zeros((height, width), np.float32)
    colour = np.zeros((height, width, 3), np.uint8)
    incidence = np.zeros((height, width), np.float32)
    m = world_from_camera
    for v in range(height):
        yn = (v - intrinsics[3]) / intrinsics[1]
        for u in range(width):
            f = face[v, u]
            if f < 0:
                continue
            z = 1.0 / np.float64(inverse_z[v, u])
            xn = (u - intrinsics[2]) / intrinsics[0]
            dx = m[0, 0] * xn + m[0, 1] * yn + m[0, 2]
            dy = m[1, 0] * xn + m[1, 1] * yn + m[1, 2]
            dz = m[2, 0] * xn + m[2, 1] * yn + m[2, 2]
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            ax, ay, az = np.float64(vertices[a, 0]), np.float64(vertices[a, 1]), np.float64(vertices[a, 2])
            ex, ey, ez = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
            gx, gy, gz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
            px, py, pz = m[0, 3] + z * dx - ax, m[1, 3] + z * dy - ay, m[2, 3] + z * dz - az
            nx, ny, nz = ey * gz - ez * gy, ez * gx - ex * gz, ex * gy - ey * gx
            nn = nx * nx + ny * ny + nz * nz
            depth[v, u] = z
            if nn <= 0.0:
                continue
            dd = dx * dx + dy * dy + dz * dz
            incidence[v, u] = abs(nx * dx + ny * dy + nz * dz) / np.sqrt(nn * dd)
            if not coloured:
                continue
            s = ((py * gz - pz * gy) * nx + (pz * gx - px * gz) * ny + (px * gy - py * gx) * nz) / nn
            q = ((ey * pz - ez * py) * nx + (ez * px - ex * pz) * ny + (ex * py - ey * px) * nz) / nn
            s = min(max(s, 0.0), 1.0)
            q = min(max(q, 0.0), 1.0 - s)
            for k in range(3):
                colour[v, u, k] = np.uint8((1.0 - s - q) * rgb[a, k] + s * rgb[b, k] + q * rgb[c, k] + 0.5)
    return depth, colour, incidence
