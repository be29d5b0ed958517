"""Planar patches of surface in depth images, and their displacement between images.

The plane of a patch is fitted to inverse depth, over a span that grows with the range: a normal from few pixels is noise at
5 m. What is not planar, such as an edge or a rim, is no patch.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uav_recon.geometry.camera_error_row import error_row
from uav_recon.geometry.jit import kernel
from uav_recon.localization.consistency.point_to_plane import seen_at
from uav_recon.types.frames import AnyArray

# patches of an image
_ROWS = 18
_COLUMNS = 24
_NARROWEST_PX = 2  # min. distance from the middle of a patch to its rim
# that distance as a share of the image width: per metre of range, and at most
_SPAN_PER_M = 0.007
_WIDEST = 0.03
_UNEVEN = 0.012  # 1/m, max. deviation from the plane; noise has 0.004
_UNEVEN_SHARE = 0.01  # ... plus this share of the inverse depth
_FACING_COS = 0.15  # a patch seen at a flatter angle, or from behind, is not compared
_SAME_COS = 0.8  # min. cosine between normals of the same surface
_FAR_M = 3.0  # stereo noise grows with the square of the range: at this range the weight is 1/2, at twice as far 1/17
# max. distance from the expected surface, plus a share of the range: noise and pose
REACH_M = 0.06
REACH_SHARE = 0.03


@kernel
def patches(depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, place: AnyArray) -> AnyArray:
    """Return the positions and normals of patches, (N, 6).

    The normals point away from the camera. Both are in the frame in which the camera has this rotation and position.

    depth_m (H, W), NaN = no return; camera fx, fy, cx, cy.
    """
    height, width = depth_m.shape
    out, number, room = np.empty((_ROWS * _COLUMNS, 6)), 0, np.empty(9)
    for row in range(_ROWS):
        v = (2 * row + 1) * height // (2 * _ROWS)
        for column in range(_COLUMNS):
            u = (2 * column + 1) * width // (2 * _COLUMNS)
            z, nx, ny, nz = _patch(depth_m, camera, u, v, room)
            if z <= 0.0:
                continue
            x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
            for i in range(3):
                out[number, i] = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z + place[i]
                out[number, 3 + i] = rotation[i, 0] * nx + rotation[i, 1] * ny + rotation[i, 2] * nz
            number += 1
    return out[:number]


@kernel
def weight_at(range_m: Any) -> Any:
    """Return the weight of points at a range (m), one or many, from the variance of its depth."""
    return 1.0 / (1.0 + (range_m / _FAR_M) ** 4)


@kernel
def normal_equations(  # noqa: C901
    then: AnyArray,
    rows_then: AnyArray,
    depth_m: AnyArray,
    camera: AnyArray,
    rotation: AnyArray,
    place: AnyArray,
    velocity: AnyArray,
    rate: AnyArray,
    age_s: float,
    expected: AnyArray,
) -> tuple[int, int, AnyArray, AnyArray]:
    """Return the normal equations for drift and camera errors between two images.

    then: (N, 6), patches of the other image; rows_then: (N, 9), their error_row. expected: (12,), state that predicts the
    displacements.

    Result: the number of patches that this image sees too; the number of these within reach of the prediction; and for the
    latter the sums of row times row (12, 12) and of row times displacement (12,).
    """
    seen, within, held, moved, room = 0, 0, np.zeros((12, 12)), np.zeros(12), np.empty(9)
    row = np.empty(12)
    for n in range(then.shape[0]):
        away, facing = 0.0, 0.0
        for i in range(3):
            away += (then[n, i] - place[i]) ** 2
            facing += (then[n, i] - place[i]) * then[n, 3 + i]
        if facing < _FACING_COS * math.sqrt(away):
            continue
        u, v, _ = seen_at(then[n], camera, rotation, place)
        if not (0 <= u < depth_m.shape[1] and 0 <= v < depth_m.shape[0]):
            continue
        z, nx, ny, nz = _patch(depth_m, camera, u, v, room)
        if z <= 0.0:
            continue
        seen += 1
        x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
        off_m, alike = 0.0, 0.0
        for i in range(3):
            there = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z + place[i]
            off_m += (there - then[n, i]) * then[n, 3 + i]
            alike += (rotation[i, 0] * nx + rotation[i, 1] * ny + rotation[i, 2] * nz) * then[n, 3 + i]
            row[i] = age_s * then[n, 3 + i]
        row[3:] = error_row(then[n, 3:], then[n, :3], rotation, place, velocity, rate) - rows_then[n]
        left_m = off_m
        for i in range(12):
            left_m -= row[i] * expected[i]
        if alike < _SAME_COS or abs(left_m) > REACH_M + REACH_SHARE * z:
            continue
        within += 1
        weight = weight_at(z)
        for i in range(12):
            moved[i] += weight * row[i] * off_m
            for k in range(12):
                held[i, k] += weight * row[i] * row[k]
    return seen, within, held, moved


@kernel
def error_rows(then: AnyArray, rotation: AnyArray, place: AnyArray, velocity: AnyArray, rate: AnyArray) -> AnyArray:
    """Return the error_row (N, 9) of each patch (N, 6), seen by a camera with this motion."""
    out = np.empty((then.shape[0], 9))
    for n in range(then.shape[0]):
        out[n] = error_row(then[n, 3:], then[n, :3], rotation, place, velocity, rate)
    return out


@kernel
def _patch(depth_m: AnyArray, camera: AnyArray, u: int, v: int, room: AnyArray) -> tuple[float, float, float, float]:
    """Return the depth (m) of a patch, 0.0 if there is none, and its normal in the camera frame.

    room: (9,), working memory of the kernel. 1 / z of a plane is linear in the pixels; near the image's rim the patch is
    shifted inwards.
    """
    height, width = depth_m.shape
    z = float(depth_m[v, u])
    if not np.isfinite(z):
        return 0.0, 0.0, 0.0, 0.0
    span = int(max(_NARROWEST_PX, min(_SPAN_PER_M * z, _WIDEST) * width))
    at_u, at_v = min(max(u, span), width - 1 - span), min(max(v, span), height - 1 - span)
    middle, across, down = 0.0, 0.0, 0.0
    for i in range(3):
        for k in range(3):
            inverse = 1.0 / depth_m[at_v + (i - 1) * span, at_u + (k - 1) * span]
            room[3 * i + k] = inverse
            middle, across, down = middle + inverse / 9.0, across + (k - 1) * inverse / 6.0, down + (i - 1) * inverse / 6.0
    most = _UNEVEN + _UNEVEN_SHARE * middle
    for i in range(3):
        for k in range(3):
            if not abs(room[3 * i + k] - middle - (k - 1) * across - (i - 1) * down) <= most:  # also True for NaN
                return 0.0, 0.0, 0.0, 0.0
    middle += ((u - at_u) * across + (v - at_v) * down) / span
    if middle <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    x, y = across / span * camera[0], down / span * camera[1]
    deep = middle - (u - camera[2]) / camera[0] * x - (v - camera[3]) / camera[1] * y
    length = math.sqrt(x * x + y * y + deep * deep)
    return 1.0 / middle, x / length, y / length, deep / length


def warm_up() -> None:
    """Compile every kernel, for the read-only arrays of a frame and a pose."""
    depth_m, place = np.full((24, 32), 2.0, dtype=np.float32), np.zeros(3)
    for array in (depth_m, place):
        array.setflags(write=False)
    camera, rotation = np.array([20.0, 20.0, 15.5, 11.5]), np.eye(3)
    seen, rest = patches(depth_m, camera, rotation, place), np.zeros(3)
    rows = error_rows(seen, rotation, place, rest, rest)
    normal_equations(seen, rows, depth_m, camera, rotation, place, rest, rest, 1.0, np.zeros(12))
    weight_at(np.ones(1))
