"""How much of the way that was flown lay where the camera looked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from uav_recon.types.camera import body_from_camera
from uav_recon.types.frames import BoolArray, FloatArray

COLUMN_M = 0.5  # about the pad: take-off and landing go through the column that the operator declares
MOVING_MPS = 0.05
STEP_S = 0.05


@dataclass(frozen=True, slots=True)
class PathVisibility:
    """Shares of the way by length: into what the camera saw at the time, and into what a level vehicle that turns its nose
    along the way would see; the rest is steeper than the picture is high. None for a vehicle that did not go anywhere.
    """

    seen: float | None
    nose_first: float | None


def path_visibility(
    stamp_s: FloatArray, position_m: FloatArray, quat_wxyz: FloatArray, pitch_down_rad: float, fov_rad: tuple[float, float]
) -> PathVisibility:
    """Of a way with stamps (N,), places (N, 3) from the pad and attitudes (N, 4) of the body in a level world, but for the
    column over the pad; a camera that looks ahead and so far down, with a horizontal and a vertical angle of view.
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
