"""Information of a view: standard deviation of the place by the surface that it shows.

Depth tells the distance along the normals, corners of the image tell both directions across the view. The turn of the camera is
known by its gyro to a fraction of a degree, and eliminated. Zhang and Scaramuzza 2020, Fisher Information Field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.localizability import SurfaceCells

_COLUMNS, _ROWS = 32, 24  # of the image of distances by which near cells hide far ones
# a cell that is farther than the nearest one in its direction by more is hidden: a length, and a share of its distance, because
# one direction shows a floor from near to far
_BEHIND_M, _BEHIND_SHARE = 0.35, 0.1
_NEAREST_M, _FARTHEST_M = 0.3, 4.0  # of surface that shows something
_KNOWN_M = 8.0  # surface that is farther leaves a direction open
_ALONG_COSINE = 0.1  # of the angle between view and normal; a surface that is seen flatter shows nothing
_UNEVEN = 0.1  # spread from which a cell shows something from every side
_HALF_CELL_M = 0.1
_PATCHES = 53.0  # across the width of the image: one patch is one measurement of depth, or one corner
_DEPTH_SHARE = 0.3  # of an independent measurement, that a patch of depth is
_DEPTH_M, _DEPTH_PER_M2 = 0.003, 0.0019  # standard deviation of depth, and its growth with the square of the distance
_CORNER_RAD = 1.0 / 380.0  # standard deviation of a corner
_FEW_CORNERS, _MANY_CORNERS = 6.0, 20.0  # in view: the smaller number says nothing, the larger one all it can
_TURN_RAD = math.radians(0.15)  # of the turn of the camera since the frame before
_WEAK_SHARE = 0.03  # of the information of the best direction, below which a direction is not shown
_WEAK_M = 0.03  # nor if it is shown less well than this
#: plan: standard deviation of a view of space that no camera has seen: about that of a usual view, else none leads there
_UNKNOWN_M = 0.006
GOOD_M = 0.004  # standard deviation of a view that shows its place well
BLIND_M = 0.012  #: plan: a view that shows its place less well is no goal, and a way past it is long
MOST_M = 1.0  # standard deviation of a direction that is not shown


@dataclass(frozen=True, slots=True)
class Eye:
    """A camera on a body that hovers.

    half_tan: tangents of half its angles of view, horizontal and vertical. position_body_m: (x, y, z) on the body.
    """

    half_tan: tuple[float, float]
    position_body_m: tuple[float, float, float]


class ViewSigmas(NamedTuple):
    """Standard deviations of the place by what views show of it.

    sigma_m (N,): standard deviation in the worst direction, at most MOST_M. open_share (N,): share of the image in which no
    surface is known within 8 m.
    """

    sigma_m: FloatArray
    open_share: FloatArray

    def expected_m(self) -> FloatArray:
        """Return the standard deviations (N,) with what surface may show that is not known yet."""
        return np.asarray(1.0 / np.sqrt(self.sigma_m**-2 + self.open_share * _UNKNOWN_M**-2))


def view_sigmas(cells: SurfaceCells, eye: Eye, position_world: FloatArray, angles_rad: FloatArray) -> ViewSigmas:
    """Return how well N views show their place.

    position_world (N, 3): of the body. angles_rad (N, 2): its yaw, and how far the camera looks down. About 40 µs a view.
    """
    sigma_m, open_share = np.full(len(position_world), MOST_M), np.ones(len(position_world))
    if len(cells.area_m2) and len(position_world):
        views = np.ascontiguousarray(np.column_stack([position_world, angles_rad]), dtype=np.float64)
        _fill(
            cells.position_world, cells.normal_world, cells.spread, cells.area_m2, cells.corners,
            np.array([*eye.half_tan, *eye.position_body_m]), views, sigma_m, open_share,
        )  # fmt: skip
    return ViewSigmas(sigma_m, open_share)


@kernel
def _fill(
    place: AnyArray,
    normal: AnyArray,
    spread: AnyArray,
    area_m2: AnyArray,
    corners: AnyArray,
    eye: AnyArray,
    views: AnyArray,
    sigma_m: AnyArray,
    open_share: AnyArray,
) -> None:
    """Write the result of view_sigmas() for views (N, 5): position, yaw, and tilt of the camera."""
    seen, shown, nearest = np.empty((place.shape[0], 3)), np.empty(place.shape[0], np.int64), np.empty((_ROWS, _COLUMNS))
    at, information = np.empty(7), np.empty((3, 3))
    for n in range(views.shape[0]):
        at[3], at[4], at[5], at[6] = math.cos(views[n, 3]), math.sin(views[n, 3]), math.cos(views[n, 4]), math.sin(views[n, 4])
        at[0] = views[n, 0] + at[3] * eye[2] - at[4] * eye[3]
        at[1] = views[n, 1] + at[4] * eye[2] + at[3] * eye[3]
        at[2] = views[n, 2] + eye[4]
        count = _in_view(place, eye, at, seen, shown, nearest)
        open_share[n] = np.sum(nearest == np.inf) / (_ROWS * _COLUMNS)
        count, followed = _visible(corners, eye, seen, shown, count, nearest)
        _information(place, normal, spread, area_m2, followed * corners, eye, at, seen, shown[:count], information)
        least, greatest = _ends(information)
        left = least - max(_WEAK_SHARE * greatest, _WEAK_M**-2)
        sigma_m[n] = min(1.0 / math.sqrt(left), MOST_M) if left > 0.0 else MOST_M


@kernel
def _visible(
    corners: AnyArray, eye: AnyArray, seen: AnyArray, shown: AnyArray, count: int, nearest: AnyArray
) -> tuple[int, float]:
    """Keep the cells in view that are near and not hidden; return their number.

    And the share of their corners that a tracker follows: a few of them do not determine its place.
    """
    kept, total = 0, 0.0
    for k in range(count):
        right, down, deep = seen[k, 0], seen[k, 1], seen[k, 2]
        column, row = int((0.5 + 0.5 * right / (deep * eye[0])) * _COLUMNS), int((0.5 + 0.5 * down / (deep * eye[1])) * _ROWS)
        before = nearest[min(row, _ROWS - 1), min(column, _COLUMNS - 1)]
        if deep <= _FARTHEST_M and deep <= before + _BEHIND_M + _BEHIND_SHARE * deep:
            seen[kept, 2], shown[kept] = deep, shown[k]
            kept += 1
            total += corners[shown[k]]
    return kept, min(max(total - _FEW_CORNERS, 0.0) / (_MANY_CORNERS - _FEW_CORNERS), 1.0)


@kernel
def _information(
    place: AnyArray,
    normal: AnyArray,
    spread: AnyArray,
    area_m2: AnyArray,
    corners: AnyArray,
    eye: AnyArray,
    at: AnyArray,
    seen: AnyArray,
    shown: AnyArray,
    out: AnyArray,
) -> None:
    """Write the information (3, 3) of a view on its place.

    The view shows cells (M,) at depths seen[:, 2].
    A cell weighs level I + plane n n' + along p p' for an offset p and a normal n: on the place as it is, on the turn of the
    camera through p x.
    """
    a00 = a01 = a02 = a11 = a12 = a22 = 0.0  # on the place
    b00 = b01 = b02 = b10 = b11 = b12 = b20 = b21 = b22 = 0.0  # on turn and place
    c01 = c02 = c12 = 0.0  # on the turn
    c00 = c11 = c22 = _TURN_RAD**-2
    for k in range(shown.shape[0]):
        cell, deep = shown[k], seen[k, 2]
        x, y, z = place[cell, 0] - at[0], place[cell, 1] - at[1], place[cell, 2] - at[2]
        nx, ny, nz = normal[cell, 0], normal[cell, 1], normal[cell, 2]
        far2 = x * x + y * y + z * z
        facing = -(nx * x + ny * y + nz * z) / math.sqrt(far2)
        if facing < _ALONG_COSINE and spread[cell] < _UNEVEN:
            continue
        patches = area_m2[cell] / (deep * 2.0 * eye[0] / _PATCHES) ** 2
        one = 1.0 / (_DEPTH_M + _DEPTH_PER_M2 * deep * deep) ** 2
        held = min(corners[cell], patches)
        across, depth = held / (_CORNER_RAD * deep) ** 2, _DEPTH_SHARE * patches * one
        along = (held * one - across) / far2
        level, plane = depth * spread[cell] + across, depth * (1.0 - 3.0 * spread[cell])
        a00, a11, a22 = a00 + level, a11 + level, a22 + level
        a00, a01, a02 = (
            a00 + plane * nx * nx + along * x * x,
            a01 + plane * nx * ny + along * x * y,
            a02 + plane * nx * nz + along * x * z,
        )
        a11, a12, a22 = (
            a11 + plane * ny * ny + along * y * y,
            a12 + plane * ny * nz + along * y * z,
            a22 + plane * nz * nz + along * z * z,
        )
        mx, my, mz = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
        b00, b01, b02 = b00 + plane * mx * nx, b01 + plane * mx * ny - level * z, b02 + plane * mx * nz + level * y
        b10, b11, b12 = b10 + plane * my * nx + level * z, b11 + plane * my * ny, b12 + plane * my * nz - level * x
        b20, b21, b22 = b20 + plane * mz * nx - level * y, b21 + plane * mz * ny + level * x, b22 + plane * mz * nz
        c00, c11, c22 = c00 + level * (far2 - x * x), c11 + level * (far2 - y * y), c22 + level * (far2 - z * z)
        c00, c01, c02 = c00 + plane * mx * mx, c01 + plane * mx * my - level * x * y, c02 + plane * mx * mz - level * x * z
        c11, c12, c22 = c11 + plane * my * my, c12 + plane * my * mz - level * y * z, c22 + plane * mz * mz
    both = np.array(((b00, b01, b02), (b10, b11, b12), (b20, b21, b22)))
    inverse = np.array(((c11 * c22 - c12 * c12, c02 * c12 - c01 * c22, c01 * c12 - c02 * c11),
                        (c02 * c12 - c01 * c22, c00 * c22 - c02 * c02, c01 * c02 - c00 * c12),
                        (c01 * c12 - c02 * c11, c01 * c02 - c00 * c12, c00 * c11 - c01 * c01)))  # fmt: skip
    inverse /= c00 * inverse[0, 0] + c01 * inverse[0, 1] + c02 * inverse[0, 2]
    out[0, 0], out[0, 1], out[0, 2], out[1, 0], out[1, 1], out[1, 2] = a00, a01, a02, a01, a11, a12
    out[2, 0], out[2, 1], out[2, 2] = a02, a12, a22
    for i in range(3):  # without what the turn explains
        for j in range(3):
            for k in range(3):
                for m in range(3):
                    out[i, j] -= both[k, i] * inverse[k, m] * both[m, j]


@kernel
def _ends(of: AnyArray) -> tuple[float, float]:
    """Return the least and the greatest eigenvalue of a symmetric matrix (3, 3) (Smith 1961)."""
    off2 = of[0, 1] ** 2 + of[0, 2] ** 2 + of[1, 2] ** 2
    mean = (of[0, 0] + of[1, 1] + of[2, 2]) / 3.0
    x, y, z = of[0, 0] - mean, of[1, 1] - mean, of[2, 2] - mean
    size = math.sqrt((x * x + y * y + z * z + 2.0 * off2) / 6.0)
    if size == 0.0:
        return mean, mean
    determinant = (
        x * (y * z - of[1, 2] ** 2)
        - of[0, 1] * (of[0, 1] * z - of[1, 2] * of[0, 2])
        + of[0, 2] * (of[0, 1] * of[1, 2] - y * of[0, 2])
    )
    angle = math.acos(min(max(determinant / (2.0 * size**3), -1.0), 1.0)) / 3.0
    return mean + 2.0 * size * math.cos(angle + 2.0 * math.pi / 3.0), mean + 2.0 * size * math.cos(angle)


@kernel
def _in_view(place: AnyArray, eye: AnyArray, at: AnyArray, seen: AnyArray, shown: AnyArray, nearest: AnyArray) -> int:
    """Write the cells in view; return their number.

    seen, shown, nearest: in the frame of the camera, their numbers, and the nearest distance in each
    direction. at (7,): position of the camera, cosine and sine of its heading and of its tilt.
    """
    cos, sin, pitch_cos, pitch_sin = at[3], at[4], at[5], at[6]
    right_scale, down_scale = 0.5 * _COLUMNS / eye[0], 0.5 * _ROWS / eye[1]
    nearest[:] = np.inf
    count = 0
    for n in range(place.shape[0]):
        x, y, z = place[n, 0] - at[0], place[n, 1] - at[1], place[n, 2] - at[2]
        ahead = cos * x + sin * y
        deep = pitch_cos * ahead - pitch_sin * z
        if deep < _NEAREST_M or deep > _KNOWN_M:
            continue
        right, down = sin * x - cos * y, -pitch_sin * ahead - pitch_cos * z
        if abs(right) >= deep * eye[0] or abs(down) >= deep * eye[1]:
            continue
        seen[count, 0], seen[count, 1], seen[count, 2] = right, down, deep
        shown[count] = n
        count += 1
        column, row, reach = right_scale * right / deep, down_scale * down / deep, right_scale * _HALF_CELL_M / deep
        left, upper = int(0.5 * _COLUMNS + column - reach), int(0.5 * _ROWS + row - reach)
        for j in range(max(upper, 0), min(int(0.5 * _ROWS + row + reach) + 1, _ROWS)):
            for i in range(max(left, 0), min(int(0.5 * _COLUMNS + column + reach) + 1, _COLUMNS)):
                nearest[j, i] = min(nearest[j, i], deep)
    return count


def warm_up() -> None:
    """Compile the kernels."""
    one = SurfaceCells(0.2, np.array([[1.0, 0.0, 0.0]]), np.array([[-1.0, 0.0, 0.0]]), np.zeros(1), np.ones(1), np.ones(1))
    view_sigmas(one, Eye((1.0, 1.0), (0.0, 0.0, 0.0)), np.zeros((1, 3)), np.zeros((1, 2)))
