"""Information of a view: how well a camera would know its place by the surface that it shows.

Depth tells the distance along the normals, corners of the image tell both directions across the view. The turn of the camera is
known by its gyro to a fraction of a degree, and eliminated. Zhang and Scaramuzza 2020, Fisher Information Field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.localizability import SurfaceCells

_COLUMNS, _ROWS = 40, 30  # of the image of distances by which near cells hide far ones
_BEHIND_M = 0.35  # a cell that is farther than the nearest one in its direction by more is hidden
_NEAREST_M, _FARTHEST_M = 0.3, 4.0
_ALONG_COSINE = 0.1  # of the angle between view and normal; a surface that is seen flatter shows nothing
_UNEVEN = 0.1  # spread from which a cell shows something from every side
_HALF_CELL_M = 0.1
_PATCHES = 53.0  # across the width of the image: one patch is one measurement of depth, or one corner
_DEPTH_SHARE = 0.3  # of an independent measurement, that a patch of depth is
_DEPTH_M, _DEPTH_PER_M2 = 0.003, 0.0019  # standard deviation of depth, and its growth with the square of the distance
_CORNER_RAD = 1.0 / 380.0  # standard deviation of a corner
_TURN_RAD = math.radians(0.15)  # of the turn of the camera since the frame before
_WEAK_SHARE = 0.005  # of the information of the best direction, below which a direction is not shown
_WEAK_M = 0.03  # nor if it is shown less well than this
_MOST_M = 1.0  # standard deviation of a direction that is not shown


@dataclass(frozen=True, slots=True)
class Eye:
    """A camera on a body that hovers.

    half_tan: tangents of half its angles of view. position_body_m (3,): on the body. pitch_down_rad: its tilt.
    """

    half_tan: tuple[float, float]
    position_body_m: tuple[float, float, float]
    pitch_down_rad: float


def place_sigmas_m(cells: SurfaceCells, eye: Eye, position_world: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Return how well views show their place (N,): the standard deviation in the worst direction, m, at most 1.

    position_world (N, 3), yaw_rad (N,): of the body. About 40 µs a view.
    """
    out = np.full(len(yaw_rad), _MOST_M)
    if len(cells.area_m2):
        numbers = np.array([*eye.half_tan, *eye.position_body_m, eye.pitch_down_rad])
        view_sigmas(
            cells.position_world, cells.normal_world, cells.spread, cells.area_m2, cells.corners, numbers,
            np.ascontiguousarray(position_world, dtype=np.float64), np.ascontiguousarray(yaw_rad, dtype=np.float64), out,
        )  # fmt: skip
    return out


@kernel
def view_sigmas(
    place: AnyArray,
    normal: AnyArray,
    spread: AnyArray,
    area_m2: AnyArray,
    corners: AnyArray,
    eye: AnyArray,
    position: AnyArray,
    yaw_rad: AnyArray,
    out: AnyArray,
) -> None:
    """Write the standard deviation of the place in its worst direction for each view."""
    seen = np.empty((place.shape[0], 3))
    for n in range(yaw_rad.shape[0]):
        information = view_information(place, normal, spread, area_m2, corners, eye, position[n], yaw_rad[n], seen)
        values = np.linalg.eigvalsh(information)
        left = values[0] - max(_WEAK_SHARE * values[2], _WEAK_M**-2)
        out[n] = min(1.0 / math.sqrt(left), _MOST_M) if left > 0.0 else _MOST_M


@kernel
def view_information(
    place: AnyArray,
    normal: AnyArray,
    spread: AnyArray,
    area_m2: AnyArray,
    corners: AnyArray,
    eye: AnyArray,
    position: AnyArray,
    yaw_rad: float,
    seen: AnyArray,
) -> AnyArray:
    """Return the information (3, 3) of a view on its place, in world axes.

    seen (N, 3): room for the cells in the frame of the camera.
    """
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    at = np.array((position[0] + cos * eye[2] - sin * eye[3], position[1] + sin * eye[2] + cos * eye[3], position[2] + eye[4]))
    nearest = _nearest(place, eye, at, cos, sin, seen)
    of_place, of_turn, both, weight = np.zeros((3, 3)), np.eye(3) * _TURN_RAD**-2, np.zeros((3, 3)), np.empty((3, 3))
    for n in range(place.shape[0]):
        if not _in_sight(seen[n], eye, nearest):
            continue
        x, y, z = place[n, 0] - at[0], place[n, 1] - at[1], place[n, 2] - at[2]
        far, deep = math.sqrt(x * x + y * y + z * z), seen[n, 2]
        facing = -(normal[n, 0] * x + normal[n, 1] * y + normal[n, 2] * z) / far
        if facing < _ALONG_COSINE and spread[n] < _UNEVEN:
            continue
        patches = area_m2[n] / (deep * 2.0 * eye[0] / _PATCHES) ** 2
        depth = patches / (_DEPTH_M + _DEPTH_PER_M2 * deep * deep) ** 2
        across = corners[n] * patches / (_CORNER_RAD * deep) ** 2
        along = (corners[n] * depth - across) / (far * far)
        level, plane = _DEPTH_SHARE * depth * spread[n] + across, _DEPTH_SHARE * depth * (1.0 - 3.0 * spread[n])
        arm = (x, y, z)
        for k in range(3):
            for j in range(3):
                weight[k, j] = plane * normal[n, k] * normal[n, j] + along * arm[k] * arm[j]
            weight[k, k] += level
        _add_point(x, y, z, weight, of_place, both, of_turn)
    return of_place - np.ascontiguousarray(both.T) @ np.linalg.solve(of_turn, both)


@kernel
def _add_point(x: float, y: float, z: float, weight: AnyArray, of_place: AnyArray, both: AnyArray, of_turn: AnyArray) -> None:
    """Add a point that is known with an information (3, 3): on the place, on turn and place, and on the turn of the camera."""
    for k in range(3):
        w0, w1, w2 = weight[k, 0], weight[k, 1], weight[k, 2]
        for j in range(3):
            of_place[k, j] += weight[k, j]
        weight[k, 0], weight[k, 1], weight[k, 2] = w2 * y - w1 * z, w0 * z - w2 * x, w1 * x - w0 * y  # by the turn
    for j in range(3):
        w0, w1, w2 = weight[0, j], weight[1, j], weight[2, j]
        both[j, 0], both[j, 1], both[j, 2] = both[j, 0] + w0, both[j, 1] + w1, both[j, 2] + w2
        of_turn[0, j] += w2 * y - w1 * z
        of_turn[1, j] += w0 * z - w2 * x
        of_turn[2, j] += w1 * x - w0 * y


@kernel
def _nearest(place: AnyArray, eye: AnyArray, at: AnyArray, cos: float, sin: float, seen: AnyArray) -> AnyArray:
    """Write the cells (N, 3) in the frame of a camera; return the distance of the nearest one in each direction."""
    pitch_cos, pitch_sin = math.cos(eye[5]), math.sin(eye[5])
    nearest = np.full((_ROWS, _COLUMNS), np.inf)
    for n in range(place.shape[0]):
        x, y, z = place[n, 0] - at[0], place[n, 1] - at[1], place[n, 2] - at[2]
        ahead = cos * x + sin * y
        right, down, deep = sin * x - cos * y, -pitch_sin * ahead - pitch_cos * z, pitch_cos * ahead - pitch_sin * z
        seen[n, 0], seen[n, 1], seen[n, 2] = right, down, deep
        if deep < _NEAREST_M:
            continue
        column = int((0.5 + 0.5 * right / (deep * eye[0])) * _COLUMNS)
        row = int((0.5 + 0.5 * down / (deep * eye[1])) * _ROWS)
        reach = int(_HALF_CELL_M / deep / eye[0] * 0.5 * _COLUMNS)
        for j in range(max(row - reach, 0), min(row + reach + 1, _ROWS)):
            for i in range(max(column - reach, 0), min(column + reach + 1, _COLUMNS)):
                nearest[j, i] = min(nearest[j, i], deep)
    return nearest


@kernel
def _in_sight(seen: AnyArray, eye: AnyArray, nearest: AnyArray) -> bool:
    """Return True if a cell (3,) in the frame of the camera is in view and not hidden."""
    right, down, deep = seen
    if deep < _NEAREST_M or deep > _FARTHEST_M or abs(right) >= deep * eye[0] or abs(down) >= deep * eye[1]:
        return False
    column = int((0.5 + 0.5 * right / (deep * eye[0])) * _COLUMNS)
    row = int((0.5 + 0.5 * down / (deep * eye[1])) * _ROWS)
    return bool(deep <= nearest[min(row, _ROWS - 1), min(column, _COLUMNS - 1)] + _BEHIND_M)
