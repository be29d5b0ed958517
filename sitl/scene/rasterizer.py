"""Z-buffer renderer: depth, colour and incidence of a triangle mesh in a pinhole camera.

It runs on one core without OpenGL. Triangles are grouped into spatial chunks with their own vertex lists: an invisible
chunk costs one box test, and a visible one transforms each of its vertices once. Visibility is computed first (1/z and
face per pixel), then colour once per pixel. Pixel (0, 0) is the CENTRE of the first pixel; both sides of a triangle are
visible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.runtime.jit import kernel
from sitl.scene.zbuffer import CHUNK_FACES, rasterise
from uav_recon.sensors.stream_format import CameraSpec

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]


@dataclass(frozen=True)
class Rendering:
    """One rendered image.

    depth_m (H, W): along the optical axis, 0 without a surface. rgb (H, W, 3). incidence_cos (H, W): |cos| between ray
    and surface normal.
    """

    depth_m: F32
    rgb: U8
    incidence_cos: F32


class Renderer:
    """A mesh prepared for rendering. Immutable, so that several threads may render at once."""

    def __init__(self, vertices: F32, faces: I32, rgb: U8) -> None:
        """Prepare a mesh: vertices (V, 3), m; faces (F, 3), vertex indices; rgb (V, 3)."""
        centres = (vertices[faces[:, 0]] + vertices[faces[:, 1]] + vertices[faces[:, 2]]) / np.float32(3.0)
        order = np.argsort(_morton(centres), kind="stable")
        source, self._faces, self._vertex_start = _numbered(np.ascontiguousarray(faces[order], np.int32), len(vertices))
        self._vertices: F32 = np.ascontiguousarray(vertices[source], np.float32)
        self._rgb: U8 = np.ascontiguousarray(rgb[source], np.uint8)
        self._low, self._high = _boxes(self._vertices, self._vertex_start)

    def depth(self, world_from_camera: F64, spec: CameraSpec, near_m: float = 0.05, far_m: float = math.inf) -> F32:
        """Return the depth (H, W) float32, m along the optical axis, 0 without a surface.

        Blocks for a few milliseconds.
        """
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
        """Render the image at world_from_camera (4, 4), RDF axes. Blocks for 10 to 20 ms.

        Surfaces nearer than near_m are not rendered; surfaces beyond far_m may be left out, which saves time. Without
        colour, rgb is black.
        """
        inverse_z, face = self._visible(world_from_camera, spec, near_m, far_m)
        intrinsics = np.array([spec.fx, spec.fy, spec.cx, spec.cy])
        pose = np.ascontiguousarray(world_from_camera, np.float64)
        mesh = (self._vertices, self._faces, self._vertex_start, self._rgb)
        return Rendering(*_shade(inverse_z, face, *mesh, pose, intrinsics, colour))

    def _visible(self, world_from_camera: F64, spec: CameraSpec, near_m: float, far_m: float) -> tuple[F32, I32]:
        intrinsics = np.array([spec.fx, spec.fy, spec.cx, spec.cy])
        inverse_z = np.zeros((spec.height, spec.width), np.float32)
        face = np.full((spec.height, spec.width), -1, np.int32)
        rasterise(
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


def _morton(points: NDArray[np.floating]) -> NDArray[np.uint64]:
    """Return the Morton code of each point on a grid of 1024 cells per side.

    Points sorted by it are close in the array if they are close in space.
    """
    low = points.min(axis=0)
    scale = 1023.0 / max(float((points.max(axis=0) - low).max()), 1e-9)
    cells = ((points - low) * scale).astype(np.uint64)
    key = np.zeros(len(points), np.uint64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return key


@kernel
def _numbered(faces: I32, count: int) -> tuple[I32, U16, I32]:
    """Return the vertex lists of all chunks.

    These are the mesh indices (W,) of the listed vertices, the faces (F, 3) in indices within the list of their chunk, and
    the start of each chunk's list.
    """
    chunks = (faces.shape[0] + CHUNK_FACES - 1) // CHUNK_FACES
    source, own = np.empty(3 * faces.shape[0], np.int32), np.empty((faces.shape[0], 3), np.uint16)
    start, number = np.zeros(chunks + 1, np.int32), np.full(count, -1, np.int32)
    total = 0
    for chunk in range(chunks):
        start[chunk] = total
        for f in range(chunk * CHUNK_FACES, min((chunk + 1) * CHUNK_FACES, faces.shape[0])):
            for k in range(3):
                vertex = faces[f, k]
                if number[vertex] < start[chunk]:  # not yet in the list of this chunk
                    number[vertex] = total
                    source[total] = vertex
                    total += 1
                own[f, k] = number[vertex] - start[chunk]
    start[chunks] = total
    return source[:total].copy(), own, start


@kernel
def _boxes(vertices: F32, start: I32) -> tuple[F32, F32]:
    low, high = np.empty((start.shape[0] - 1, 3), np.float32), np.empty((start.shape[0] - 1, 3), np.float32)
    for chunk in range(start.shape[0] - 1):
        for k in range(3):
            low[chunk, k] = high[chunk, k] = vertices[start[chunk], k]
        for i in range(start[chunk], start[chunk + 1]):
            for k in range(3):
                low[chunk, k] = min(low[chunk, k], vertices[i, k])
                high[chunk, k] = max(high[chunk, k], vertices[i, k])
    return low, high


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
    inverse_z: F32, face: I32, vertices: F32, faces: U16, vertex_start: I32, rgb: U8,
    world_from_camera: F64, intrinsics: F64, coloured: bool,
) -> tuple[F32, U8, F32]:  # fmt: skip
    """Return depth, barycentric colour at the surface point, and |cos| between ray and normal."""
    height, width = inverse_z.shape
    depth = np.zeros((height, width), np.float32)
    colour = np.zeros((height, width, 3), np.uint8)
    incidence = np.zeros((height, width), np.float32)
    m = world_from_camera
    known = -1  # face of the stored corner, edges and normal: neighbouring pixels often show the same face
    a = b = c = 0
    ax = ay = az = ex = ey = ez = gx = gy = gz = nx = ny = nz = nn = 0.0
    for v in range(height):
        yn = (v - intrinsics[3]) / intrinsics[1]
        for u in range(width):
            f = face[v, u]
            if f < 0:
                continue
            z = 1.0 / np.float64(inverse_z[v, u])
            depth[v, u] = z
            xn = (u - intrinsics[2]) / intrinsics[0]
            dx = m[0, 0] * xn + m[0, 1] * yn + m[0, 2]
            dy = m[1, 0] * xn + m[1, 1] * yn + m[1, 2]
            dz = m[2, 0] * xn + m[2, 1] * yn + m[2, 2]
            if f != known:
                known = f
                first = vertex_start[f // CHUNK_FACES]
                a, b, c = first + faces[f, 0], first + faces[f, 1], first + faces[f, 2]
                ax, ay, az = np.float64(vertices[a, 0]), np.float64(vertices[a, 1]), np.float64(vertices[a, 2])
                ex, ey, ez = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
                gx, gy, gz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
                nx, ny, nz = ey * gz - ez * gy, ez * gx - ex * gz, ex * gy - ey * gx
                nn = nx * nx + ny * ny + nz * nz
            if nn <= 0.0:
                continue
            dd = dx * dx + dy * dy + dz * dz
            incidence[v, u] = abs(nx * dx + ny * dy + nz * dz) / np.sqrt(nn * dd)
            if not coloured:
                continue
            px, py, pz = m[0, 3] + z * dx - ax, m[1, 3] + z * dy - ay, m[2, 3] + z * dz - az
            s = ((py * gz - pz * gy) * nx + (pz * gx - px * gz) * ny + (px * gy - py * gx) * nz) / nn
            q = ((ey * pz - ez * py) * nx + (ez * px - ex * pz) * ny + (ex * py - ey * px) * nz) / nn
            s = min(max(s, 0.0), 1.0)
            q = min(max(q, 0.0), 1.0 - s)
            for k in range(3):
                colour[v, u, k] = np.uint8((1.0 - s - q) * rgb[a, k] + s * rgb[b, k] + q * rgb[c, k] + 0.5)
    return depth, colour, incidence
