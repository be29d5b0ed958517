"""Depth image of the tracker: smaller, with the normal of the surface at each pixel."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from uav_recon.geometry.jit import fast_kernel, kernel
from uav_recon.types.camera import Frame
from uav_recon.types.frames import AnyArray, FloatArray

WIDTH = 216  # largest width; the depths of square cells are averaged
REACH_M = 4.5  # farther depth is too noisy
_SAME_SHARE = 0.02  # depths of a cell that differ from the nearest one by less are of its surface, ...
_SAME_M = 0.01  # ... with this beside it
_HALF_PX = 2  # a normal is fitted to pixels up to this far from its own
_MIN_PAIRS_SHARE = 0.6  # of the pairs of opposite pixels that must be of one surface
_MEAN_PX = 13  # square around a pixel whose mean normal counts
_ALIKE_COS = 0.87  # between a normal and the mean around it that differ by noise only
_MIN_COS = 0.08  # a surface at a more grazing angle has no normal
# inverse depths that bend by more are those of two objects
_MAX_BEND_PER_M = 0.03
_MAX_BEND_SHARE = 0.04


class DepthImage(NamedTuple):
    """Depth image (H, W) of at most WIDTH columns.

    depth_m (H, W) float32: along the optical axis, 0 = no return. camera (4,): fx, fy, cx, cy of it.
    """

    depth_m: AnyArray
    camera: FloatArray

    @staticmethod
    def of(frame: Frame) -> DepthImage:
        """Return the depth image of a frame. About 0.2 ms for 424x240."""
        height, width = frame.depth_m.shape
        cell = max(-(-width // WIDTH), 1)
        depth_m = cell_depths(frame.depth_m, cell, np.empty((height // cell, width // cell), np.float32))
        camera = frame.depth_intrinsics.pinhole_px()
        return DepthImage(depth_m, np.concatenate((camera[:2] / cell, (camera[2:] + 0.5) / cell - 0.5)))


@kernel
def cell_depths(depth_m: AnyArray, cell: int, out: AnyArray) -> AnyArray:
    """Write the mean depth (h, w) of cells of an image.

    Of two surfaces in a cell the nearer one counts.
    """
    width, none = out.shape[1], np.float32(np.inf)
    of, nearest = np.empty((cell * cell, width), np.float32), np.empty(width, np.float32)
    for v in range(out.shape[0]):
        nearest[:] = none
        for k in range(cell * cell):
            row, first = depth_m[v * cell + k // cell], k % cell
            for u in range(width):
                z = row[u * cell + first]
                of[k, u] = z if z > 0.0 else none
        for k in range(cell * cell):
            for u in range(width):
                nearest[u] = of[k, u] if of[k, u] < nearest[u] else nearest[u]
        for u in range(width):
            total, number, most = 0.0, 0.0, nearest[u] * (1.0 + _SAME_SHARE) + _SAME_M
            for k in range(cell * cell):
                same = of[k, u] <= most
                total, number = total + (of[k, u] if same else 0.0), number + (1.0 if same else 0.0)
            out[v, u] = total / number if nearest[u] <= REACH_M else 0.0
    return out


def write_normals(depth_m: AnyArray, camera: AnyArray, out: AnyArray) -> None:
    """Write the unit normals (H, W, 3) of the surfaces of a depth image. About 2 ms.

    Zero where there is no surface. A normal that is like the mean around it, but for noise, is this mean: a plain wall whose
    normals scatter would seem to show the place along it.
    """
    write_fitted_normals(depth_m, camera, out)
    take_means(out, cv2.blur(out, (_MEAN_PX, _MEAN_PX)))


@fast_kernel
def take_means(normal: AnyArray, mean: AnyArray) -> None:
    """Replace normals (H, W, 3) by the directions of means (H, W, 3), where these differ little."""
    for v in range(normal.shape[0]):
        for u in range(normal.shape[1]):
            x, y, z = mean[v, u, 0], mean[v, u, 1], mean[v, u, 2]
            length = np.sqrt(x * x + y * y + z * z)
            along = normal[v, u, 0] * x + normal[v, u, 1] * y + normal[v, u, 2] * z
            if along > _ALIKE_COS * length:
                normal[v, u, 0], normal[v, u, 1], normal[v, u, 2] = x / length, y / length, z / length


@fast_kernel
def write_fitted_normals(depth_m: AnyArray, camera: AnyArray, out: AnyArray) -> None:
    """Write the unit normals (H, W, 3) of the surfaces of a depth image, towards the camera.

    Zero where there is no surface: at edges, and without a return. The inverse depth of a plane is a linear function of the
    pixel, 1/z = a x + b y + c, and (a, b, c) is its normal; a and b are fitted to pairs of opposite pixels around each one.
    """
    height, width = depth_m.shape
    out[:] = 0.0
    inverse = np.zeros((height, width))
    for v in range(height):
        for u in range(width):
            if depth_m[v, u] > 0.0:
                inverse[v, u] = 1.0 / depth_m[v, u]
    for v in range(_HALF_PX, height - _HALF_PX):
        for u in range(_HALF_PX, width - _HALF_PX):
            here = inverse[v, u]
            if here <= 0.0:
                continue
            a, b, found = _fitted_slope(inverse, v, u)
            a, b = a * camera[0], b * camera[1]
            c = here - a * (u - camera[2]) / camera[0] - b * (v - camera[3]) / camera[1]
            length = np.sqrt(a * a + b * b + c * c)
            if found and here / length >= _MIN_COS:
                out[v, u, 0], out[v, u, 1], out[v, u, 2] = -a / length, -b / length, -c / length


@fast_kernel
def _fitted_slope(inverse: AnyArray, v: int, u: int) -> tuple[float, float, bool]:
    """Return the growth of the inverse depth (H, W) by column and by row around a pixel.

    The third value is True if it shows one surface.
    """
    here = inverse[v, u]
    most = _MAX_BEND_PER_M + _MAX_BEND_SHARE * here
    uu = vv = uv = ua = va = 0.0
    number = 0
    for dv in range(_HALF_PX + 1):
        for du in range(-_HALF_PX if dv else 1, _HALF_PX + 1):
            one, other = inverse[v + dv, u + du], inverse[v - dv, u - du]
            if one > 0.0 and other > 0.0 and abs(one + other - 2.0 * here) < most:
                rise = one - other
                uu, vv, uv = uu + du * du, vv + dv * dv, uv + du * dv
                ua, va = ua + du * rise, va + dv * rise
                number += 1
    spread = uu * vv - uv * uv
    if number < _MIN_PAIRS_SHARE * 2 * _HALF_PX * (_HALF_PX + 1) or spread <= 0.0:
        return 0.0, 0.0, False
    return 0.5 * (vv * ua - uv * va) / spread, 0.5 * (uu * va - uv * ua) / spread, True


@fast_kernel
def grid_points(depth_m: AnyArray, camera: AnyArray, most: int) -> AnyArray:
    """Return at most ``most`` points (N, 3) of a depth image in its own frame.

    They are on a grid of pixels.
    """
    height, width = depth_m.shape
    step = max(int(np.ceil(np.sqrt(height * width / most))), 1)
    out, number = np.empty(((height // step + 1) * (width // step + 1), 3)), 0
    for v in range(step // 2, height, step):
        for u in range(step // 2, width, step):
            z = float(depth_m[v, u])
            if z > 0.0:
                out[number, 0], out[number, 1], out[number, 2] = (
                    (u - camera[2]) / camera[0] * z,
                    (v - camera[3]) / camera[1] * z,
                    z,
                )
                number += 1
    return out[:number]
