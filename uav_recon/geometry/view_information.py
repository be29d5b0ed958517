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
_WEAK_SHARE = 0.015  # of the information of the best direction, below which a direction is not shown
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
    information, both, of_turn = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    at = np.empty(7)
    for n in range(views.shape[0]):
        at[3], at[4], at[5], at[6] = math.cos(views[n, 3]), math.sin(views[n, 3]), math.cos(views[n, 4]), math.sin(views[n, 4])
        at[0] = views[n, 0] + at[3] * eye[2] - at[4] * eye[3]
        at[1] = views[n, 1] + at[4] * eye[2] + at[3] * eye[3]
        at[2] = views[n, 2] + eye[4]
        count = _in_view(place, eye, at, seen, shown, nearest)
        information[:], both[:], of_turn[:] = 0.0, 0.0, 0.0
        for k in range(3):
            of_turn[k, k] = _TURN_RAD**-2
        followed = _followed(corners, seen, shown, count, eye, nearest)
        for k in range(count):
            cell = shown[k]
            if seen[k, 2] <= _FARTHEST_M and not _hidden(seen[k], eye, nearest):
                x, y, z = place[cell, 0] - at[0], place[cell, 1] - at[1], place[cell, 2] - at[2]
                surface = (spread[cell], area_m2[cell], followed * corners[cell])
                _add_cell(x, y, z, seen[k, 2], normal[cell], surface, eye[0], information, both, of_turn)
        least, greatest = _ends(_without_turn(information, both, of_turn))
        left = least - max(_WEAK_SHARE * greatest, _WEAK_M**-2)
        sigma_m[n] = min(1.0 / math.sqrt(left), MOST_M) if left > 0.0 else MOST_M
        open_share[n] = np.sum(nearest == np.inf) / (_ROWS * _COLUMNS)


@kernel
def _followed(corners: AnyArray, seen: AnyArray, shown: AnyArray, count: int, eye: AnyArray, nearest: AnyArray) -> float:
    """Return the share of the corners in view that a tracker follows.

    A few of them do not determine its place.
    """
    total = 0.0
    for k in range(count):
        if seen[k, 2] <= _FARTHEST_M and not _hidden(seen[k], eye, nearest):
            total += corners[shown[k]]
    return min(max(total - _FEW_CORNERS, 0.0) / (_MANY_CORNERS - _FEW_CORNERS), 1.0)


@kernel
def _add_cell(
    x: float,
    y: float,
    z: float,
    deep: float,
    normal: AnyArray,
    surface: tuple[float, float, float],
    half_tan: float,
    of_place: AnyArray,
    both: AnyArray,
    of_turn: AnyArray,
) -> None:
    """Add the information of a cell at an offset in world.

    of_place, both, of_turn (3, 3): on the place, on turn and place, and on the turn of the camera.
    surface: spread, area and corners of the cell.
    """
    spread, area_m2, corners = surface
    far2 = x * x + y * y + z * z
    facing = -(normal[0] * x + normal[1] * y + normal[2] * z) / math.sqrt(far2)
    if facing < _ALONG_COSINE and spread < _UNEVEN:
        return
    patches = area_m2 / (deep * 2.0 * half_tan / _PATCHES) ** 2
    corners = min(corners, patches)
    one = (_DEPTH_M + _DEPTH_PER_M2 * deep * deep) ** -2
    depth, across = patches * one, corners / (_CORNER_RAD * deep) ** 2
    along = (corners * one - across) / far2
    level, plane = _DEPTH_SHARE * depth * spread + across, _DEPTH_SHARE * depth * (1.0 - 3.0 * spread)
    # level I + plane n n' + along p p', and its products with the turn's derivative: for a vector v those are p x v
    nx, ny, nz = normal[0], normal[1], normal[2]
    mx, my, mz = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
    for k in range(3):
        n_k, p_k, m_k = (nx, ny, nz)[k], (x, y, z)[k], (mx, my, mz)[k]
        of_place[k, 0] += plane * n_k * nx + along * p_k * x
        of_place[k, 1] += plane * n_k * ny + along * p_k * y
        of_place[k, 2] += plane * n_k * nz + along * p_k * z
        of_place[k, k] += level
        both[k, 0] += plane * m_k * nx
        both[k, 1] += plane * m_k * ny
        both[k, 2] += plane * m_k * nz
        of_turn[k, 0] += plane * m_k * mx - level * p_k * x
        of_turn[k, 1] += plane * m_k * my - level * p_k * y
        of_turn[k, 2] += plane * m_k * mz - level * p_k * z
        of_turn[k, k] += level * far2
    both[0, 1], both[0, 2], both[1, 2] = both[0, 1] - level * z, both[0, 2] + level * y, both[1, 2] - level * x
    both[1, 0], both[2, 0], both[2, 1] = both[1, 0] + level * z, both[2, 0] - level * y, both[2, 1] + level * x


@kernel
def _without_turn(of_place: AnyArray, both: AnyArray, of_turn: AnyArray) -> AnyArray:
    """Return the information (3, 3) on the place alone, while the turn is known as of_turn says."""
    a, b, c, d, e, f = of_turn[0, 0], of_turn[0, 1], of_turn[0, 2], of_turn[1, 1], of_turn[1, 2], of_turn[2, 2]
    inverse = np.empty((3, 3))
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    inverse[1, 1], inverse[1, 2], inverse[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    inverse[1, 0], inverse[2, 0], inverse[2, 1] = inverse[0, 1], inverse[0, 2], inverse[1, 2]
    determinant = a * inverse[0, 0] + b * inverse[0, 1] + c * inverse[0, 2]
    left = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total += both[k, i] * inverse[k, m] * both[m, j]
            left[i, j] = of_place[i, j] - total / determinant
    return left


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


@kernel
def _hidden(seen: AnyArray, eye: AnyArray, nearest: AnyArray) -> bool:
    """Return True if a nearer cell hides one (3,) in the frame of the camera."""
    right, down, deep = seen
    column, row = int((0.5 + 0.5 * right / (deep * eye[0])) * _COLUMNS), int((0.5 + 0.5 * down / (deep * eye[1])) * _ROWS)
    return bool(deep > nearest[min(row, _ROWS - 1), min(column, _COLUMNS - 1)] + _BEHIND_M + _BEHIND_SHARE * deep)


def warm_up() -> None:
    """Compile the kernels."""
    one = SurfaceCells(0.2, np.array([[1.0, 0.0, 0.0]]), np.array([[-1.0, 0.0, 0.0]]), np.zeros(1), np.ones(1), np.ones(1))
    view_sigmas(one, Eye((1.0, 1.0), (0.0, 0.0, 0.0)), np.zeros((1, 3)), np.zeros((1, 2)))
