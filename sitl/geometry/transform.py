"""Rigid transforms of the simulator: 4x4 matrices target_from_source, quaternions wxyz.

Quaternions are Hamilton. World is ENU (z up), body FLU, camera optical RDF. Not shared with the product's pose algebra
on purpose, so that one mistake cannot hide in both.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Matrix = NDArray[np.float64]


def rigid(rotation: ArrayLike, translation_m: ArrayLike) -> Matrix:
    """Return the 4x4 matrix of a rotation (3, 3) and a translation (3,), m."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation_m
    return matrix


def inverse(target_from_source: Matrix) -> Matrix:
    """Return source_from_target (4, 4)."""
    rotation = target_from_source[:3, :3]
    return rigid(rotation.T, -rotation.T @ target_from_source[:3, 3])


def rotation_from_yaw(yaw_rad: float) -> Matrix:
    """Return the rotation (3, 3) about z by yaw_rad, counter-clockwise seen from above."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def world_from_body(position_m: ArrayLike, yaw_rad: float) -> Matrix:
    """Return the pose (4, 4) of a level body at position_m (3,) in the world."""
    return rigid(rotation_from_yaw(yaw_rad), position_m)


def rotation_from_quat(quat_wxyz: ArrayLike) -> Matrix:
    """Return the rotation (3, 3) of a quaternion (4,), which is normalised first."""
    q = np.asarray(quat_wxyz, np.float64)
    w, x, y, z = q / np.sqrt(q @ q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def body_from_camera(position_m: ArrayLike, pitch_down_rad: float) -> Matrix:
    """Return the pose (4, 4) of the camera (RDF) in the body (FLU).

    The camera looks forward, tilted down by pitch_down_rad, with its centre at position_m (3,).
    """
    c, s = math.cos(pitch_down_rad), math.sin(pitch_down_rad)
    right, down, forward = (0.0, -1.0, 0.0), (-s, 0.0, -c), (c, 0.0, -s)
    return rigid(np.array([right, down, forward]).T, position_m)
