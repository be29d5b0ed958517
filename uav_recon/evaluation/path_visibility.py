"""Share of the flown path that lay in the camera's field of view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from uav_recon.types.camera import body_from_camera
from uav_recon.types.frames import BoolArray, FloatArray

COLUMN_M = 0.5  # radius around the pad: take-off and landing use the column that the operator declares free
MOVING_MPS = 0.05
STEP_S = 0.05


@dataclass(frozen=True, slots=True)
class PathVisibility:
    """Shares of the path by length; None for a vehicle that did not move.

    seen: the motion was into the camera's view at the time. nose_first: it would be, for a level vehicle that yaws into the
    direction of motion; the rest is steeper than the vertical field of view.
    """

    seen: float | None
    nose_first: float | None


def path_visibility(
    stamp_s: FloatArray, position_m: FloatArray, quat_wxyz: FloatArray, pitch_down_rad: float, fov_rad: tuple[float, float]
) -> PathVisibility:
    """Return the visibility of a path, without the column above the pad.

    stamp_s (N,); position_m (N, 3) from the pad; quat_wxyz (N, 4): attitude of the body in a level world. The camera looks
    forward, pitch_down_rad downwards; fov_rad: horizontal and vertical field of view.
    """
    if len(stamp_s) < 2:
        return PathVisibility(None, None)
    thin = np.unique(np.searchsorted(stamp_s, np.arange(stamp_s[0], stamp_s[-1], STEP_S)))
    step_m, step_s = np.diff(position_m[thin], axis=0), np.diff(stamp_s[thin])
    length_m = np.linalg.norm(step_m, axis=1)
    away = np.hypot(position_m[thin, 0], position_m[thin, 1]) > COLUMN_M
    moving = (length_m > MOVING_MPS * step_s) & away[:-1]
    if not moving.any():
        return PathVisibility(None, None)
    step_m, length_m = step_m[moving], length_m[moving]
    in_body = Rotation.from_quat(np.roll(quat_wxyz[thin[:-1]][moving], -1, axis=1)).inv().apply(step_m)
    nose_first = np.stack([np.hypot(step_m[:, 0], step_m[:, 1]), np.zeros(len(step_m)), step_m[:, 2]], axis=1)
    body_from_depth = body_from_camera(np.zeros(3), pitch_down_rad).rotation()
    seen, could = (_in_view(way @ body_from_depth, fov_rad) for way in (in_body, nose_first))
    return PathVisibility(float(length_m[seen].sum() / length_m.sum()), float(length_m[could].sum() / length_m.sum()))


def _in_view(way: FloatArray, fov_rad: tuple[float, float]) -> BoolArray:
    half = np.tan(np.array(fov_rad) / 2.0)
    return np.asarray((way[:, 2:] > 0.0).all(axis=1) & (np.abs(way[:, :2]) <= way[:, 2:] * half).all(axis=1))
