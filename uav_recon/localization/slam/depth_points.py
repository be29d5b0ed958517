"""Points of a depth image, and their distances to the surfaces of a map."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.localization.slam.tsdf_volume import REACH_M, TRUNCATION_M, TsdfBlocks, sample
from uav_recon.types.frames import AnyArray

ROWS = 30
COLUMNS = 48
# standard deviation of a depth: _FLOOR_M, and _PER_M2 times the square of the range (a D435i's is 3.5 mm at 1 m)
_FLOOR_M = 0.012
_PER_M2 = 0.004
_ROBUST_SIGMAS = 2.0  # scale of the robust weight
_ROBUST_M = 0.03  # its minimum
_INLIER_SHARE = 0.5  # of the truncation: a residual below it is that of the same surface
# a surface is placed worse than what the camera is otherwise compared with if its variance is larger by this factor, and this
_WORSE = 1.5
_ALIKE_M2 = 0.01**2
_ALIKE_POINTS = 100.0  # points whose surfaces have the same error of place
_FACING_COS = 0.3  # of a normal to an axis: with less, noise of the normal says more about the axis than the surface does
# length of the gradient of a field that is a distance; elsewhere it is the average of two surfaces
_MIN_SLOPE = 0.35
_MAX_SLOPE = 1.5


@kernel
def depth_points(depth_m: AnyArray, camera: AnyArray) -> AnyArray:
    """Return points (N, 3) of a depth image (H, W) in its own frame, from a grid of pixels."""
    height, width = depth_m.shape
    rows, columns = min(ROWS, height), min(COLUMNS, width)
    out, number = np.empty((rows * columns, 3)), 0
    for row in range(rows):
        v = (2 * row + 1) * height // (2 * rows)
        for column in range(columns):
            u = (2 * column + 1) * width // (2 * columns)
            z = float(depth_m[v, u])
            if not 0.0 < z <= REACH_M:
                continue
            out[number, 0], out[number, 1], out[number, 2] = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z, z
            number += 1
    return out[:number]


@kernel
def add_depth_equations(
    points: AnyArray,
    rotation: AnyArray,
    place_m: AnyArray,
    blocks: TsdfBlocks,
    known_variance: AnyArray,
    most_variance: float,
    share: float,
    wider: float,
    information: AnyArray,
    gradient: AnyArray,
    errors: AnyArray,
) -> tuple[int, int]:
    """Add the normal equations of points (N, 3) against the field.

    rotation (3, 3), place_m (3,): pose of the depth imager in odom. known_variance (3,): of what the camera is otherwise
    compared with; a surface whose place has a larger error counts less. most_variance: a block with a larger one is unknown.
    errors (2, 3): sums of the variances of the surfaces, weighted by what they say along each axis, and of these weights.

    information (>= 6, >= 6) and gradient (>= 6): of a small rotation in odom axes about the camera and of its translation, in
    units of standard deviations. share: weight of one point, since the errors of neighbours are alike. wider: factor on the
    scale of the robust weight.
    Returns the number of points in known space, and of those that lie on a known surface.
    """
    index, distance, weight, variance = blocks.block_index, blocks.distance, blocks.weight, blocks.variance
    known, inliers = 0, 0
    point, found, row = np.empty(3), np.empty(5), np.empty(6)
    for n in range(points.shape[0]):
        for a in range(3):
            point[a] = (
                rotation[a, 0] * points[n, 0] + rotation[a, 1] * points[n, 1] + rotation[a, 2] * points[n, 2] + place_m[a]
            )
        if not sample(point, index, distance, weight, found):
            continue
        block = int(found[4])
        if max(variance[block, 0], variance[block, 1], variance[block, 2]) > most_variance:
            continue
        slope = np.sqrt(found[1] * found[1] + found[2] * found[2] + found[3] * found[3])
        if not _MIN_SLOPE < slope < _MAX_SLOPE:  # free space: no surface is there
            known += 1
            continue
        towards = (place_m[0] - point[0]) * found[1] + (place_m[1] - point[1]) * found[2] + (place_m[2] - point[2]) * found[3]
        if towards < 0.0:  # the other side of a thin wall
            continue
        known += 1
        off_m = found[0] / slope
        inliers += int(abs(off_m) < _INLIER_SHARE * TRUNCATION_M)
        z = points[n, 2]
        sigma_m = _FLOOR_M + _PER_M2 * z * z
        scale = wider * max(_ROBUST_M, _ROBUST_SIGMAS * sigma_m)
        shrink = 1.0 / (1.0 + (off_m / scale) ** 2)
        nx, ny, nz = found[1] / slope, found[2] / slope, found[3] / slope
        row[3], row[4], row[5] = nx, ny, nz
        w = share * shrink * shrink / (sigma_m * sigma_m + _ALIKE_POINTS * _worse(row[3:], variance[block], known_variance))
        _add_errors(row[3:], w, variance[block], errors)
        x, y, z = point[0] - place_m[0], point[1] - place_m[1], point[2] - place_m[2]
        row[0], row[1], row[2] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
        for a in range(6):
            gradient[a] -= w * row[a] * off_m
            for b in range(6):
                information[a, b] += w * row[a] * row[b]
    return known, inliers


@kernel
def _worse(normal: AnyArray, variance: AnyArray, known_variance: AnyArray) -> float:
    """Return by how much a variance (3,), along a normal (3,), exceeds what is known."""
    worse = 0.0
    for a in range(3):
        worse += normal[a] * normal[a] * max(variance[a] - _WORSE * known_variance[a] - _ALIKE_M2, 0.0)
    return worse


@kernel
def _add_errors(normal: AnyArray, w: float, variance: AnyArray, errors: AnyArray) -> None:
    """Add a surface to the sums (2, 3) along the axes that its normal (3,) faces."""
    for a in range(3):
        if abs(normal[a]) > _FACING_COS:
            errors[0, a] += w * normal[a] * normal[a] * variance[a]
            errors[1, a] += w * normal[a] * normal[a]
