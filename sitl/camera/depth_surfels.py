"""Surface elements from depth images: one per cube, with a normal and a standard deviation.

Used in place of the neural surface in flights that are evaluated without a reconstructed model: a few milliseconds per
image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.runtime.jit import kernel

NORMAL_BASE_M = 0.08  # half the baseline of the depth differences for normals: large against the depth noise
MAX_RELATIVE_DEPTH_STEP = 0.12  # relative depth difference from the middle of the baseline's ends; more is an edge
SMALLEST_COSINE = 0.15
PRIOR_SIGMA_M = 1.0  # standard deviation before any measurement
INITIAL_CAPACITY = 4096  # initial capacity, in surface elements
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]


class DepthSurfels:
    """One surface element per cube of cell_m, between low_m and high_m (3,), that was measured.

    They are in the order of their first measurement.
    """

    def __init__(self, low_m: F64, high_m: F64, cell_m: float) -> None:
        self._low = np.asarray(low_m, np.float64)
        self._cell_m = cell_m
        extent = np.asarray(high_m, np.float64) - self._low
        self._cube = np.full(tuple(int(n) for n in np.ceil(extent / cell_m - 1e-6)), -1, np.int32)
        self._sums = np.zeros((INITIAL_CAPACITY, 8))  # points (3), normals (3), weight, information
        self._view = np.zeros(INITIAL_CAPACITY, np.int32)
        self._views = self._count = 0

    def __len__(self) -> int:
        return self._count

    def look(self, depth_m: F32, lens: F64, rotation: F64, eye_m: F64, noise: float) -> None:
        """Add a depth image (H, W), m, NaN without a return. Takes a few milliseconds.

        lens: fx, fy, cx, cy. rotation (3, 3) and eye_m (3,): world_from_camera. noise: sigma_z = noise z², 1/m.
        An image adds the information (cos / sigma_z)², cos of the incidence angle, once to each cube that it measures,
        however many of its pixels fall into the cube.
        """
        self._views += 1
        while not self._see(depth_m, lens, rotation, eye_m, noise):
            self._sums = np.concatenate([self._sums, np.zeros_like(self._sums)])
            self._view = np.concatenate([self._view, np.zeros_like(self._view)])

    def _see(self, depth_m: F32, lens: F64, rotation: F64, eye_m: F64, noise: float) -> bool:
        if self._count + depth_m.size > len(self._view):
            return False
        self._count = _look(
            np.ascontiguousarray(depth_m, np.float32), np.asarray(lens, np.float64), np.ascontiguousarray(rotation),
            np.asarray(eye_m, np.float64), noise, self._low, self._cell_m, self._cube, self._sums, self._view,
            self._views, self._count,
        )  # fmt: skip
        return True

    def elements(self) -> tuple[F64, F64, F64]:
        """Return positions (N, 3), unit normals (N, 3) towards the camera, and sigmas (N,), m."""
        return _elements(self._sums[: self._count])


def warm_up() -> None:
    """Compile all kernels of this module."""
    memory = DepthSurfels(np.zeros(3), np.ones(3), 0.1)
    depth, eye = np.full((8, 8), 0.5, np.float32), np.full(3, 0.4)
    for array in (depth, eye):  # read-only, as in a frozen frame
        array.setflags(write=False)
    memory.look(depth, np.array([8.0, 8.0, 3.5, 3.5]), np.eye(3), eye, 0.005)
    memory.elements()


@kernel
def _elements(sums: F64) -> tuple[F64, F64, F64]:
    """Return the means of the sums of _look(): positions, normals and standard deviations.

    A normal is (0, 0, 1) where the measured normals cancel out.
    """
    positions, normals, sigma = np.empty((sums.shape[0], 3)), np.zeros((sums.shape[0], 3)), np.empty(sums.shape[0])
    for n in range(sums.shape[0]):
        length = np.sqrt(sums[n, 3] ** 2 + sums[n, 4] ** 2 + sums[n, 5] ** 2)
        normals[n, 2] = 1.0
        for k in range(3):
            positions[n, k] = sums[n, k] / sums[n, 6]
            if length > 1e-6:
                normals[n, k] = sums[n, 3 + k] / length
        sigma[n] = 1.0 / np.sqrt(sums[n, 7] + 1.0 / PRIOR_SIGMA_M**2)
    return positions, normals, sigma


@kernel
def _middle(before: float, before_px: int, after: float, after_px: int) -> float:
    """Return the depth at 0 px of the plane through two depths; NaN if one has no return.

    before_px <= 0 <= after_px: their pixels.
    """
    share = before_px / min(before_px - after_px, -1)
    return 1.0 / ((1.0 - share) / before + share / after)


@kernel
def _look(
    depth: F32, lens: F64, rotation: F64, eye: F64, noise: float, low: F64, cell: float, cube: I32, sums: F64, seen: I32,
    view: int, count: int,
) -> int:  # fmt: skip
    """Add an image to sums; return the new number of surface elements."""
    height, width = depth.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    for v in range(height):
        for u in range(width):
            z = np.float64(depth[v, u])
            if not z > 0.0:
                continue
            du = min(max(int(fx * NORMAL_BASE_M / z), 1), 40)
            dv = min(max(int(fy * NORMAL_BASE_M / z), 1), 40)
            u0, u1, v0, v1 = max(u - du, 0), min(u + du, width - 1), max(v - dv, 0), min(v + dv, height - 1)
            za, zb = np.float64(depth[v, u0]), np.float64(depth[v, u1])
            zc, zd = np.float64(depth[v0, u]), np.float64(depth[v1, u])
            edge = MAX_RELATIVE_DEPTH_STEP * z
            # a plane at a small angle, as a ceiling seen from below it, is no edge: the inverse depth of a plane is even
            if not (abs(_middle(za, u0 - u, zb, u1 - u) - z) < edge and abs(_middle(zc, v0 - v, zd, v1 - v) - z) < edge):
                continue
            x, y = (u - cx) / fx, (v - cy) / fy
            ax, ay, az = (u1 - cx) / fx * zb - (u0 - cx) / fx * za, y * (zb - za), zb - za
            bx, by, bz = x * (zd - zc), (v1 - cy) / fy * zd - (v0 - cy) / fy * zc, zd - zc
            nx, ny, nz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax  # towards the camera
            norm = np.sqrt(nx * nx + ny * ny + nz * nz)
            if norm <= 0.0:
                continue
            facing = -(nx * x + ny * y + nz) / (norm * np.sqrt(x * x + y * y + 1.0))
            px = rotation[0, 0] * x * z + rotation[0, 1] * y * z + rotation[0, 2] * z + eye[0]
            py = rotation[1, 0] * x * z + rotation[1, 1] * y * z + rotation[1, 2] * z + eye[1]
            pz = rotation[2, 0] * x * z + rotation[2, 1] * y * z + rotation[2, 2] * z + eye[2]
            i, j, k = (
                int(np.floor((px - low[0]) / cell)),
                int(np.floor((py - low[1]) / cell)),
                int(np.floor((pz - low[2]) / cell)),
            )
            if i < 0 or j < 0 or k < 0 or i >= cube.shape[0] or j >= cube.shape[1] or k >= cube.shape[2]:
                continue
            n = cube[i, j, k]
            if n < 0:
                n = count
                cube[i, j, k] = np.int32(count)
                count += 1
            weight = (max(facing, SMALLEST_COSINE) / (noise * z * z)) ** 2
            if seen[n] != view:
                seen[n] = np.int32(view)
                sums[n, 7] += weight
            sums[n, 0] += weight * px
            sums[n, 1] += weight * py
            sums[n, 2] += weight * pz
            scale = weight / norm
            sums[n, 3] += scale * (rotation[0, 0] * nx + rotation[0, 1] * ny + rotation[0, 2] * nz)
            sums[n, 4] += scale * (rotation[1, 0] * nx + rotation[1, 1] * ny + rotation[1, 2] * nz)
            sums[n, 5] += scale * (rotation[2, 0] * nx + rotation[2, 1] * ny + rotation[2, 2] * nz)
            sums[n, 6] += weight
    return count
