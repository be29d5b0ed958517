"""Points of a depth image, and their distances to the surfaces of keyframes."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import fast_kernel, kernel
from uav_recon.localization.slam.keyframe_map import NEAREST_M, Keyframes
from uav_recon.types.frames import AnyArray

SURFACE_M = 0.2  # a point farther from the surface of a keyframe belongs to another one
# standard deviation of a depth: _FLOOR_M, and _PER_M2 times the square of the range (a D435i's is 3.5 mm at 1 m)
_FLOOR_M = 0.008
_PER_M2 = 0.003
_ROBUST_SIGMAS = 2.0  # scale of the robust weight
_ROBUST_M = 0.02  # its minimum
_INLIER_M = 0.08  # a residual below it is that of the same surface
_MOST_DEEP_M = 0.6  # along the axis: a point farther behind a surface is hidden by it, in whatever direction that faces


@fast_kernel
def add_depth_equations(
    points: AnyArray,
    rotation: AnyArray,
    place_m: AnyArray,
    keyframes: Keyframes,
    doubt: AnyArray,
    share: float,
    wider: float,
    information: AnyArray,
    gradient: AnyArray,
) -> tuple[int, int]:
    """Add the normal equations of points (N, 3) against the surfaces of keyframes.

    rotation (3, 3), place_m (3,): pose of the depth imager in odom. doubt (M, 3, 3): a surface of a keyframe is unknown if this
    is more than 1 along its normal.

    information (M, >= 6, >= 6) and gradient (M, >= 6): of a small rotation in odom axes about the camera and of its
    translation, in units of standard deviations, from each keyframe. share: weight of one point, since the errors of neighbours
    are alike; the keyframes that show the same point divide it. wider: factor on the scale of the robust weight. Returns the
    number of points in known space, and of those that lie on a known surface. A point behind a surface is hidden, which says
    nothing; one in front of it is in known space.
    """
    known, inliers, most = 0, 0, keyframes.number.shape[0]
    turn, moved_m = _poses_in(keyframes, rotation, place_m)
    row, off_m, normal, number = np.empty(6), np.empty(most), np.empty((most, 3)), np.empty(most, np.int64)
    for n in range(points.shape[0]):
        p, q, r = points[n, 0], points[n, 1], points[n, 2]
        found, is_known, is_inlier = _surfaces_at(p, q, r, turn, moved_m, keyframes, doubt, off_m, normal, number)
        known += int(is_known)
        inliers += int(is_inlier)
        x = rotation[0, 0] * p + rotation[0, 1] * q + rotation[0, 2] * r
        y = rotation[1, 0] * p + rotation[1, 1] * q + rotation[1, 2] * r
        z = rotation[2, 0] * p + rotation[2, 1] * q + rotation[2, 2] * r
        sigma_m = _FLOOR_M + _PER_M2 * r * r
        scale = wider * max(_ROBUST_M, _ROBUST_SIGMAS * sigma_m)
        for m in range(found):
            shrink, k = 1.0 / (1.0 + (off_m[m] / scale) ** 2), number[m]
            nx, ny, nz = normal[m, 0], normal[m, 1], normal[m, 2]
            row[0], row[1], row[2] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
            row[3], row[4], row[5] = nx, ny, nz
            w = share / found * shrink * shrink / (sigma_m * sigma_m)
            for a in range(6):
                gradient[k, a] -= w * row[a] * off_m[m]
                for b in range(6):
                    information[k, a, b] += w * row[a] * row[b]
    return known, inliers


@kernel
def _along(matrix: AnyArray, normal: AnyArray) -> float:
    """Return the value of a quadratic form (3, 3) for a direction (3,)."""
    out = 0.0
    for a in range(3):
        for b in range(3):
            out += normal[a] * matrix[a, b] * normal[b]
    return out


@fast_kernel
def _surfaces_at(
    p: float,
    q: float,
    r: float,
    turn: AnyArray,
    moved_m: AnyArray,
    keyframes: Keyframes,
    doubt: AnyArray,
    off_m: AnyArray,
    normal: AnyArray,
    number: AnyArray,
) -> tuple[int, bool, bool]:
    """Write the distances of a point to surfaces of keyframes.

    off_m (M,): distances. normal (M, 3): of the surfaces, in odom. number (M,): of their keyframes.
    p, q, r: the point in the frame of the depth imager. turn, moved_m: of _poses_in(). doubt: of add_depth_equations(). Returns
    how many surfaces there are, whether the point is in known space, and whether it lies on a surface.
    """
    found, in_front, on_surface = 0, False, False
    for m in range(keyframes.number.shape[0]):
        deep = turn[m, 2, 0] * p + turn[m, 2, 1] * q + turn[m, 2, 2] * r + moved_m[m, 2]
        if deep < NEAREST_M:
            continue
        across = turn[m, 0, 0] * p + turn[m, 0, 1] * q + turn[m, 0, 2] * r + moved_m[m, 0]
        down = turn[m, 1, 0] * p + turn[m, 1, 1] * q + turn[m, 1, 2] * r + moved_m[m, 1]
        fx, fy, cx, cy = keyframes.camera[m, 0], keyframes.camera[m, 1], keyframes.camera[m, 2], keyframes.camera[m, 3]
        u, v = int(np.floor(across / deep * fx + cx + 0.5)), int(np.floor(down / deep * fy + cy + 0.5))
        if not (0 <= v < keyframes.depth_m.shape[1] and 0 <= u < keyframes.depth_m.shape[2]):
            continue
        k = keyframes.number[m]
        z = float(keyframes.depth_m[k, v, u])
        nx, ny, nz = keyframes.normal[k, v, u, 0], keyframes.normal[k, v, u, 1], keyframes.normal[k, v, u, 2]
        if z <= 0.0 or nz == 0.0 or deep - z > _MOST_DEEP_M:
            continue
        off = nx * (across - (u - cx) / fx * z) + ny * (down - (v - cy) / fy * z) + nz * (deep - z)
        towards = nx * (moved_m[m, 0] - across) + ny * (moved_m[m, 1] - down) + nz * (moved_m[m, 2] - deep)
        in_front = in_front or (off > SURFACE_M and doubt[m, 0, 0] + doubt[m, 1, 1] + doubt[m, 2, 2] == 0.0)
        if abs(off) > SURFACE_M or towards < 0.0:  # hidden, or the other side of a thin wall
            continue
        off_m[found], number[found] = off, m
        for a in range(3):
            turned = keyframes.rotation[m, a]
            normal[found, a] = turned[0] * nx + turned[1] * ny + turned[2] * nz
        if _along(doubt[m], normal[found]) > 1.0:
            continue
        on_surface = on_surface or abs(off) < _INLIER_M
        found += 1
    return found, found > 0 or in_front, on_surface


@kernel
def _poses_in(keyframes: Keyframes, rotation: AnyArray, place_m: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return rotation (M, 3, 3) and place (M, 3) of a depth imager in the frames of keyframes."""
    most = keyframes.number.shape[0]
    turn, moved_m = np.zeros((most, 3, 3)), np.zeros((most, 3))
    for m in range(most):
        for a in range(3):
            for c in range(3):
                moved_m[m, a] += keyframes.rotation[m, c, a] * (place_m[c] - keyframes.place_m[m, c])
                for b in range(3):
                    turn[m, a, b] += keyframes.rotation[m, c, a] * rotation[c, b]
    return turn, moved_m
