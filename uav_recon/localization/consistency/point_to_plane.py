"""Point-to-plane distance between two depth images, along the rays of the second."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, FloatArray

MIN_POINTS = 60  # min. points that both see
# points of an image
_ROWS = 18
_COLUMNS = 24
_NEAREST_M = 0.1  # a point nearer than this, or behind, is in no image
MOST = _ROWS * _COLUMNS
_SPAN_PX = 2  # distance from a point to the pixels that give its normal
# limit of a zero residual, plus a share of the range: noise and pose error together
_FIT_M = 0.06
_FIT_SHARE = 0.03
_WITHIN = 0.8  # share of the farthest point's depth: beyond, a point may leave the sensor's range
_PRIOR = 0.03  # share of the points: the weight of a prior for zero shift in each direction
_ROUNDS = 4
# two images a moment apart agree to this, plus this times the square of the range
_SHARP_M = 0.04
_SHARP_PER_M = 0.010
_SUSPICIOUS = 0.01  # share of misfits below which no shift is searched for
# shifts, as shares of width or height; smaller ones look like drift
_STEP = 0.04
_ACROSS = 2
_DOWN = 3
_FARTHEST = 6
_HALF = 9  # min. number of shifts that can be evaluated
_SOME = 5  # points; a smaller gain is noise: of 130 on a floor, up to 3 in valid images


@kernel
def surface(depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, place: AnyArray) -> AnyArray:
    """Return points on surfaces and their normals, (N, 6).

    They are in the frame in which the camera has this rotation and position.

    depth_m (H, W), NaN = no return; camera fx, fy, cx, cy.
    """
    height, width = depth_m.shape
    out, number = np.empty((MOST, 6)), 0
    rows, columns = min(_ROWS, height - 2 * _SPAN_PX), min(_COLUMNS, width - 2 * _SPAN_PX)
    corners = np.empty((4, 3))
    for row in range(rows):
        v = _SPAN_PX + row * (height - 1 - 2 * _SPAN_PX) // max(rows - 1, 1)
        for column in range(columns):
            u = _SPAN_PX + column * (width - 1 - 2 * _SPAN_PX) // max(columns - 1, 1)
            for n in range(4):
                across = _SPAN_PX * (1 - 2 * n) if n < 2 else 0
                down = _SPAN_PX * (5 - 2 * n) if n >= 2 else 0
                z = float(depth_m[v + down, u + across])
                corners[n, 0] = (u + across - camera[2]) / camera[0] * z
                corners[n, 1] = (v + down - camera[3]) / camera[1] * z
                corners[n, 2] = z
            a, b = corners[0] - corners[1], corners[2] - corners[3]
            nx, ny, nz = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
            length, z = np.sqrt(nx * nx + ny * ny + nz * nz), float(depth_m[v, u])
            if not (np.isfinite(z) and np.isfinite(length) and length > 0.0):
                continue
            x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
            for i in range(3):
                out[number, i] = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z + place[i]
                out[number, 3 + i] = (rotation[i, 0] * nx + rotation[i, 1] * ny + rotation[i, 2] * nz) / length
            number += 1
    return out[:number]


@kernel
def seen_at(point: AnyArray, camera: AnyArray, rotation: AnyArray, place: AnyArray) -> tuple[int, int, float]:
    """Return column and row at which a point is seen, and its depth (m); -1, -1 if in no image."""
    dx, dy, dz = point[0] - place[0], point[1] - place[1], point[2] - place[2]
    deep = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
    if deep < _NEAREST_M:
        return -1, -1, deep
    u = int(np.rint((rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz) / deep * camera[0] + camera[2]))
    v = int(np.rint((rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz) / deep * camera[1] + camera[3]))
    return u, v, deep


@kernel
def _off_m(point: AnyArray, u: int, v: int, z: float, camera: AnyArray, rotation: AnyArray, place: AnyArray) -> float:
    """Return the distance of a return from the surface through a point (6,), along its normal.

    z: depth (m) of the return on the ray of the pixel.
    """
    x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
    off_m = 0.0
    for i in range(3):
        there = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z + place[i]
        off_m += (there - point[i]) * point[3 + i]
    return off_m


@kernel
def residuals(
    points: AnyArray, depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, place: AnyArray
) -> tuple[AnyArray, int]:
    """Return the residuals (M, 6) of the points (N, 6) of another image that this one sees.

    Columns: residual (m), limit up to which it counts as zero (m), how much farther than the point the return is (m), normal
    (3). Also returns the number of points well within range for which this image has no return.
    """
    height, width = depth_m.shape
    out, number, gone, reach_m = np.empty((points.shape[0], 6)), 0, 0, _reach_m(points, rotation, place)
    for n in range(points.shape[0]):
        u, v, deep = seen_at(points[n], camera, rotation, place)
        if not (0 <= u < width and 0 <= v < height):
            continue
        z = float(depth_m[v, u])
        if not np.isfinite(z):
            gone += int(deep <= reach_m)
            continue
        off_m = _off_m(points[n], u, v, z, camera, rotation, place)
        out[number, 0], out[number, 1], out[number, 2] = off_m, _FIT_M + _FIT_SHARE * z, z - deep
        for k in range(3, points.shape[1]):
            out[number, k] = points[n, k]
        number += 1
    return out[:number], gone


@kernel
def _reach_m(points: AnyArray, rotation: AnyArray, place: AnyArray) -> float:
    """Return the depth (m) up to which a point of another image is well within range."""
    reach_m = 0.0
    for n in range(points.shape[0]):
        dx, dy, dz = points[n, 0] - place[0], points[n, 1] - place[1], points[n, 2] - place[2]
        reach_m = max(reach_m, _WITHIN * (rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz))
    return reach_m


@kernel
def contradicted_points(points: AnyArray, depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, place: AnyArray) -> AnyArray:
    """Return those of the points (N, 6) of another image that this one contradicts, (M, 6).

    They are in view with a return that does not fit, or well within range without a return.
    """
    height, width = depth_m.shape
    out, number, reach_m = np.empty(points.shape), 0, _reach_m(points, rotation, place)
    for n in range(points.shape[0]):
        u, v, deep = seen_at(points[n], camera, rotation, place)
        if not (0 <= u < width and 0 <= v < height):
            continue
        z = float(depth_m[v, u])
        if np.isfinite(z):
            wrong = abs(_off_m(points[n], u, v, z, camera, rotation, place)) > _SHARP_M + _SHARP_PER_M * z * z
        else:
            wrong = deep <= reach_m
        if wrong:
            out[number] = points[n]
            number += 1
    return out[:number]


@kernel
def fit_counts(points: AnyArray, depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, place: AnyArray) -> tuple[int, int]:
    """Return the number of points (N, 6) in view, and of those with a return that fits."""
    height, width = depth_m.shape
    in_view = fitting = 0
    for n in range(points.shape[0]):
        u, v, _ = seen_at(points[n], camera, rotation, place)
        if not (0 <= u < width and 0 <= v < height):
            continue
        in_view += 1
        z = float(depth_m[v, u])
        if np.isfinite(z):
            fitting += int(abs(_off_m(points[n], u, v, z, camera, rotation, place)) <= _SHARP_M + _SHARP_PER_M * z * z)
    return in_view, fitting


@kernel
def shift_gain(points: AnyArray, depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, place: AnyArray) -> float:
    """Return the gain of an image's best shift: missing points less misfits after it.

    Both are shares of the points (N, 6) of another image. A shift reads the image some columns or rows aside. The gain is zero
    for an image that is not shifted.

    Only returns farther than expected count as evidence of a shift: something that comes into view stands in front of
    something. A wall seen squarely and the floor look the same when shifted: they are no evidence for or against, but noise may
    be.
    """
    _, straight, _, _ = _misfit(points, depth_m, camera, rotation, place, 0, 0)
    return max(0.0, _asides(points, depth_m, camera, rotation, place)[:, 0].max()) if straight > _SUSPICIOUS else 0.0


@kernel
def shift_loss(points: AnyArray, depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, place: AnyArray) -> float:
    """Return the least loss of a shift: the share of the points (N, 6) that fit less.

    A shift reads the image some columns or rows aside. The loss is zero if few shifts can be evaluated or if a shift would not
    be noticed, and negative if a shifted image fits better.
    """
    asides = _asides(points, depth_m, camera, rotation, place)
    return asides[:, 1].min() if len(asides) >= _HALF else 0.0


@kernel
def _asides(points: AnyArray, depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, place: AnyArray) -> AnyArray:
    """Return shift_gain and shift_loss of each shift, (M, 2).

    A single row of zeros if too little is seen at both positions.
    """
    out, number = np.zeros((4 * _FARTHEST, 2)), 0
    for n in range(-_FARTHEST, _FARTHEST + 1):
        for k in range(2):
            if abs(n) >= (_ACROSS if k == 0 else _DOWN):
                aside = int(np.rint(n * _STEP * depth_m.shape[1 - k]))
                count, gone, here, there = _misfit(points, depth_m, camera, rotation, place, (1 - k) * aside, k * aside)
                if np.isfinite(there):
                    out[number, 0] = gone - there if np.rint((gone - there) * count) >= _SOME else 0.0
                    out[number, 1] = there - here
                    number += 1
    return out[: max(number, 1)]


@kernel
def _misfit(
    points: AnyArray, depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, place: AnyArray, across: int, down: int
) -> tuple[int, float, float, float]:
    """Return the number of points with a return at both positions, and their shares of misfits.

    The positions are the expected one, and one shifted by ``across`` columns and ``down`` rows. Shares: misfits at the expected
    position with a farther return; all misfits there; all misfits at the shifted one. NaN if there are too few points.
    """
    height, width = depth_m.shape
    count, gone, off = 0, 0, np.zeros(2)
    for n in range(points.shape[0]):
        u, v, deep = seen_at(points[n], camera, rotation, place)
        if not (0 <= u < width and 0 <= v < height and 0 <= u + across < width and 0 <= v + down < height):
            continue
        if not np.isfinite(depth_m[v, u] + depth_m[v + down, u + across]):
            continue
        count += 1
        for k in range(2):
            z = float(depth_m[v + k * down, u + k * across])
            misfit = abs(_off_m(points[n], u, v, z, camera, rotation, place)) > _SHARP_M + _SHARP_PER_M * z * z
            off[k] += int(misfit)
            gone += int(misfit and k == 0 and z > deep)
    return (count, gone / count, off[0] / count, off[1] / count) if count >= MIN_POINTS else (count, np.nan, np.nan, np.nan)


@kernel
def shift_of(found: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return the translation (3,) that explains most of the residuals (M, 6).

    Least squares, repeated with a falling limit for outliers. Also returns how well each direction is determined, (3, 3), as a
    share of the points.

    A prior keeps the shift at zero in a direction that few surfaces face.
    """
    shift, held = np.zeros(3), np.zeros((3, 3))
    for n in range(_ROUNDS):
        reach = 2.0 ** (_ROUNDS - 1 - n)
        normal, wanted = _PRIOR * len(found) * np.eye(3), np.zeros(3)
        for m in range(len(found)):
            a = found[m, 3:]
            if abs(found[m, 0] - (a[0] * shift[0] + a[1] * shift[1] + a[2] * shift[2])) > reach * found[m, 1]:
                continue
            for i in range(3):
                wanted[i] += a[i] * found[m, 0]
                for j in range(3):
                    normal[i, j] += a[i] * a[j]
        shift = _solved(normal, wanted)
        held = normal / len(found) - _PRIOR * np.eye(3)
    return shift, held


@kernel
def shares(found: AnyArray, shift: AnyArray) -> tuple[float, float, float]:
    """Return the shares of residuals (M, 6) that are zero, nearer, and explained by a shift."""
    fitting, nearer, explained = 0, 0, 0
    for m in range(len(found)):
        left = found[m, 0] - (found[m, 3] * shift[0] + found[m, 4] * shift[1] + found[m, 5] * shift[2])
        fits = abs(found[m, 0]) <= found[m, 1]
        fitting += int(fits)
        nearer += int(not fits and found[m, 2] < 0.0)
        explained += int(abs(left) <= found[m, 1])
    return fitting / len(found), nearer / len(found), explained / len(found)


@kernel
def _solved(m: FloatArray, b: FloatArray) -> FloatArray:
    """Solve a positive definite (3, 3) system by cofactors."""
    x = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    y = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    z = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    out = np.empty(3)
    out[0] = b[0] * x + b[1] * y + b[2] * z
    out[1] = b[0] * y + b[1] * (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]) + b[2] * (m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1])
    out[2] = b[0] * z + b[1] * (m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1]) + b[2] * (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0])
    out /= m[0, 0] * x + m[0, 1] * y + m[0, 2] * z
    return out
