"""Points of a depth image, and their distances to the surfaces of keyframes."""

from __future__ import annotations

from typing import NamedTuple

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
_KNOWN, _ON_SURFACE = 1, 2  # what is known of a point
_MOMENT, _NORMAL, _OFF, _RANGE, _ROWS = 0, 3, 6, 7, 8  # rows of Matches.of


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
    turning: bool = True,
) -> tuple[int, int]:
    """Add the normal equations of points (N, 3) against the surfaces of keyframes.

    rotation (3, 3), place_m (3,): pose of the depth imager in odom. doubt (M, 3, 3): a surface of a keyframe is unknown if this
    is more than 1 along its normal.

    information (M, >= 6, >= 6) and gradient (M, >= 6): of a small rotation in odom axes about the camera and of its
    translation, in units of standard deviations, from each keyframe. share: weight of one point, since the errors of neighbours
    are alike; the keyframes that show the same point divide it. wider: factor on the scale of the robust weight. turning: False
    leaves out the rotation. Returns the number of points in known space, and of those that lie on a known surface. A point
    behind a surface is hidden, which says nothing; one in front of it is in known space.
    """
    most, many = keyframes.number.shape[0], points.shape[0]
    rows, which, found = np.empty((most, _ROWS, many)), np.empty((most, many), np.int32), np.zeros(most, np.int64)
    showing, seen, whole = np.zeros(many, np.int64), np.zeros(many, np.int64), np.zeros((7, 7))
    for m in range(most):
        matches = Matches(rows[m], which[m], showing, seen)
        found[m] = _match(points, rotation, place_m, keyframes, m, doubt[m], matches)
    for m in range(most):
        _sum_products(rows[m], found[m], which[m], showing, share, wider, _MOMENT if turning else _NORMAL, whole)
        _add_turned(whole, keyframes.rotation[m], information[m], gradient[m])
    known = inliers = 0
    for n in range(many):
        known += int(seen[n] & _KNOWN != 0)
        inliers += int(seen[n] & _ON_SURFACE != 0)
    return known, inliers


class Matches(NamedTuple):
    """Points that lie near the surface of a keyframe, for kernels.

    of (8, N): of each match the turning moment of its normal about the camera, the normal, the distance to the surface, in the
    axes of the keyframe, and the depth (m) of the point. which (N,): numbers of the points. showing (P,): number of keyframes
    that show each point. seen (P,): what is known of each point, _KNOWN and _ON_SURFACE.
    """

    of: AnyArray
    which: AnyArray
    showing: AnyArray
    seen: AnyArray


@fast_kernel
def _match(
    points: AnyArray, rotation: AnyArray, place_m: AnyArray, keyframes: Keyframes, m: int, doubt: AnyArray, matches: Matches
) -> int:
    """Write the points (P, 3) that lie near the surface of keyframe m; return their number.

    Other arguments: as of add_depth_equations().
    """
    t00, t01, t02, t10, t11, t12, t20, t21, t22, a0, b0, c0 = _pose_in(
        keyframes.rotation[m], keyframes.place_m[m], rotation, place_m
    )
    fx, fy, cx, cy = keyframes.camera[m, 0], keyframes.camera[m, 1], keyframes.camera[m, 2], keyframes.camera[m, 3]
    depth_m, normal = keyframes.depth_m[keyframes.number[m]], keyframes.normal[keyframes.number[m]]
    height, width = depth_m.shape
    of, which, showing, seen = matches.of, matches.which, matches.showing, matches.seen
    doubted = doubt[0, 0] + doubt[1, 1] + doubt[2, 2] > 0.0
    found = 0
    for n in range(points.shape[0]):
        p, q, r = points[n, 0], points[n, 1], points[n, 2]
        z = t20 * p + t21 * q + t22 * r
        deep = z + c0
        if deep < NEAREST_M:
            continue
        x, y = t00 * p + t01 * q + t02 * r, t10 * p + t11 * q + t12 * r
        across, down = x + a0, y + b0
        u, v = int(np.floor(across / deep * fx + cx + 0.5)), int(np.floor(down / deep * fy + cy + 0.5))
        if not (0 <= v < height and 0 <= u < width):
            continue
        there = float(depth_m[v, u])
        nx, ny, nz = float(normal[v, u, 0]), float(normal[v, u, 1]), float(normal[v, u, 2])
        if there <= 0.0 or nz == 0.0 or deep - there > _MOST_DEEP_M:
            continue
        off = nx * (across - (u - cx) / fx * there) + ny * (down - (v - cy) / fy * there) + nz * (deep - there)
        if off > SURFACE_M and not doubted:
            seen[n] |= _KNOWN
        if abs(off) > SURFACE_M or nx * x + ny * y + nz * z > 0.0:  # hidden, or the other side of a thin wall
            continue
        if doubted and _along(doubt, keyframes.rotation[m], nx, ny, nz) > 1.0:
            continue
        seen[n] |= _KNOWN | _ON_SURFACE if abs(off) < _INLIER_M else _KNOWN
        showing[n] += 1
        of[0, found], of[1, found], of[2, found] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
        of[3, found], of[4, found], of[5, found] = nx, ny, nz
        of[6, found], of[7, found], which[found] = off, r, n
        found += 1
    return found


@fast_kernel
def _sum_products(
    of: AnyArray, number: int, which: AnyArray, showing: AnyArray, share: float, wider: float, first: int, out: AnyArray
) -> None:
    """Write the weighted sums (7, 7) of the products of the first seven rows of matches (8, N).

    Or of those rows from ``first`` on. Other arguments: as of add_depth_equations() and Matches.
    """
    weight, scaled = np.empty(number), np.empty(number)
    for i in range(number):
        sigma_m = _FLOOR_M + _PER_M2 * of[_RANGE, i] * of[_RANGE, i]
        off = of[_OFF, i] / (wider * max(_ROBUST_M, _ROBUST_SIGMAS * sigma_m))
        shrink = 1.0 / ((1.0 + off * off) * sigma_m)
        weight[i] = share * shrink * shrink / showing[which[i]]
    for a in range(first, 7):
        one = of[a]
        for i in range(number):
            scaled[i] = weight[i] * one[i]
        for b in range(a, 7):
            other, total = of[b], 0.0
            for i in range(number):
                total += scaled[i] * other[i]
            out[a, b] = out[b, a] = total


@kernel
def _add_turned(whole: AnyArray, turn: AnyArray, information: AnyArray, gradient: AnyArray) -> None:
    """Add equations in the axes of a keyframe, turned (3, 3) into those of odom.

    whole (7, 7): of _sum_products().
    """
    half = np.empty((6, 7))
    for a in range(6):
        first = a // 3 * 3
        for b in range(7):
            half[a, b] = (
                turn[a - first, 0] * whole[first, b]
                + turn[a - first, 1] * whole[first + 1, b]
                + turn[a - first, 2] * whole[first + 2, b]
            )
    for a in range(6):
        gradient[a] -= half[a, _OFF]
        for b in range(6):
            first = b // 3 * 3
            for c in range(3):
                information[a, b] += half[a, first + c] * turn[b - first, c]


@kernel
def _along(matrix: AnyArray, turn: AnyArray, nx: float, ny: float, nz: float) -> float:
    """Return the value of a quadratic form (3, 3) for a direction.

    The form is in odom, the direction in the axes of a keyframe. turn (3, 3): from these to odom.
    """
    out = 0.0
    for a in range(3):
        for b in range(3):
            one, other = (
                turn[a, 0] * nx + turn[a, 1] * ny + turn[a, 2] * nz,
                turn[b, 0] * nx + turn[b, 1] * ny + turn[b, 2] * nz,
            )
            out += one * matrix[a, b] * other
    return out


@kernel
def _pose_in(turn: AnyArray, origin_m: AnyArray, rotation: AnyArray, place_m: AnyArray) -> tuple[float, ...]:
    """Return rotation (9 elements) and place (3) of a depth imager in the frame of a keyframe.

    turn (3, 3), origin_m (3,): pose of the keyframe in odom. rotation (3, 3), place_m (3,): that of the depth imager.
    """
    x, y, z = place_m[0] - origin_m[0], place_m[1] - origin_m[1], place_m[2] - origin_m[2]
    r = np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            r[a, b] = turn[0, a] * rotation[0, b] + turn[1, a] * rotation[1, b] + turn[2, a] * rotation[2, b]
    return (
        r[0, 0], r[0, 1], r[0, 2], r[1, 0], r[1, 1], r[1, 2], r[2, 0], r[2, 1], r[2, 2],
        turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z,
        turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z,
        turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z,
    )  # fmt: skip
