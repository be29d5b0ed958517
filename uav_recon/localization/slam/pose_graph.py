"""Pose graph of keyframes: what each pair says of its relative pose, and the poses that fit all of it best.

Grisetti, Kuemmerle, Stachniss and Burgard 2010, A Tutorial on Graph-Based SLAM. The variance of a place is the effective
resistance between it and the first keyframe, with the information of the pairs as conductances: exact where the errors of the
axes are independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.pose import Pose

_ROUNDS = 4
_STILL_M = 1e-4
_FIXED = 1e12  # information on the first pose
_PLACED_M2 = 0.01**2  # variance of what a pair says beside its noise: by the calibration of the camera
_TURN_RAD = np.radians(0.1)  # standard deviation of a relative attitude, by the gyro
_UNKNOWN_M = 1.0  # a pair says nothing of a direction that it leaves less certain than this


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What each of M keyframes alone says of the pose of a frame.

    number (M,): of the keyframes. information (M, 6, 6): on a rotation in odom axes about the camera, and on its place. step
    (M, 6): by which the pose that it shows differs from that of the registration. before (M,): True for keyframes from before.
    """

    number: IntArray
    information: FloatArray
    step: FloatArray
    before: BoolArray


class PoseGraph:
    """Edges between keyframes. Not thread-safe."""

    def __init__(self) -> None:
        self._first: list[int] = []
        self._second: list[int] = []
        self._turn: list[FloatArray] = []
        self._moved_m: list[FloatArray] = []
        self._information: list[FloatArray] = []

    def add(self, first: int, second: int, odom_from_first: Pose, odom_from_second: Pose, information: FloatArray) -> None:
        """Add the measured relative pose of two keyframes.

        information (6, 6): on a rotation of the second one in odom axes about its camera, and on its place.
        """
        first_from_second = odom_from_first.inverse() @ odom_from_second
        axes = _both(odom_from_first.rotation()[None])[0]
        self._first.append(first)
        self._second.append(second)
        self._turn.append(first_from_second.rotation())
        self._moved_m.append(first_from_second.translation_m)
        self._information.append(axes.T @ information @ axes)

    def solve(self, rotation: FloatArray, place_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the poses (N, 3, 3), (N, 3) that fit best, from these on; the first one stays. 20 ms for 300 keyframes."""
        first, second = self._ends()
        turn, moved_m, information = np.array(self._turn), np.array(self._moved_m), np.array(self._information)
        rotation, place_m = rotation.copy(), place_m.copy()
        for _ in range(_ROUNDS):
            arm_m = np.einsum("eab,eb->ea", rotation[first], moved_m)
            there = rotation[first] @ turn
            off = np.hstack(
                (
                    _logarithms(rotation[second] @ np.swapaxes(there, 1, 2)),
                    place_m[second] - place_m[first] - arm_m,
                )
            )
            axes = _both(rotation[first])
            weight = axes @ information @ np.swapaxes(axes, 1, 2)
            by_first = np.tile(-np.eye(6), (len(first), 1, 1))
            by_first[:, 3:, :3] = _crosses(arm_m)
            step = _solved(first, second, by_first, weight, off, len(place_m))
            rotation = _exponentials(step[:, :3]) @ rotation
            place_m = place_m + step[:, 3:]
            if np.abs(step[:, 3:]).max() < _STILL_M:
                break
        return rotation, place_m

    def variances(self, rotation: FloatArray) -> FloatArray:
        """Return the variances (N, 3) of the places along the axes of odom, against the first. 10 ms for 300 keyframes."""
        first, second = self._ends()
        axes = _both(rotation[first])
        weight = axes @ np.array(self._information) @ np.swapaxes(axes, 1, 2)
        turn = weight[:, :3, :3] + _TURN_RAD**-2 * np.eye(3)
        place = weight[:, 3:, 3:] - weight[:, 3:, :3] @ np.linalg.solve(turn, weight[:, :3, 3:])
        spread = np.diagonal(np.linalg.inv(place + _UNKNOWN_M**-2 * np.eye(3)), axis1=1, axis2=2)
        conductance = 1.0 / (spread + _PLACED_M2)
        out = np.zeros((len(rotation), 3))
        for axis in range(3):
            whole = np.zeros((len(rotation), len(rotation)))
            np.add.at(whole, (first, first), conductance[:, axis])
            np.add.at(whole, (second, second), conductance[:, axis])
            np.add.at(whole, (first, second), -conductance[:, axis])
            np.add.at(whole, (second, first), -conductance[:, axis])
            out[1:, axis] = np.diagonal(np.linalg.inv(whole[1:, 1:]))
        return out

    def _ends(self) -> tuple[IntArray, IntArray]:
        return np.array(self._first), np.array(self._second)


def _solved(
    first: IntArray, second: IntArray, by_first: FloatArray, weight: FloatArray, off: FloatArray, count: int
) -> FloatArray:
    """Return the step (N, 6) of Gauss-Newton."""
    across = weight @ by_first
    down = np.swapaxes(by_first, 1, 2)
    blocks = np.concatenate((weight, down @ across, across, np.swapaxes(across, 1, 2)))
    row, column = np.concatenate((second, first, second, first)), np.concatenate((second, first, first, second))
    rows = (6 * row[:, None, None] + np.arange(6)[None, :, None]) + np.zeros((1, 1, 6), np.int64)
    columns = (6 * column[:, None, None] + np.arange(6)[None, None, :]) + np.zeros((1, 6, 1), np.int64)
    size = 6 * count
    whole = coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size)).tocsc()
    fixed = np.zeros(size)
    fixed[:6] = _FIXED
    whole.setdiag(whole.diagonal() + fixed + 1e-6)
    pull = np.zeros((count, 6))
    np.add.at(pull, second, -np.einsum("eab,eb->ea", weight, off))
    np.add.at(pull, first, -np.einsum("eab,eb->ea", down @ weight, off))
    return np.asarray(splu(whole).solve(pull.ravel()).reshape(count, 6))


def _both(turn: FloatArray) -> FloatArray:
    """Return the matrices (E, 6, 6) that turn rotation and place."""
    out = np.zeros((len(turn), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = turn
    return out


def _crosses(vector: FloatArray) -> FloatArray:
    """Return the matrices (E, 3, 3) of the cross products with vectors (E, 3)."""
    out = np.zeros((len(vector), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -vector[:, 2], vector[:, 1], -vector[:, 0]
    return np.asarray(out - np.swapaxes(out, 1, 2))


def _logarithms(turn: FloatArray) -> FloatArray:
    """Return the rotation vectors (E, 3) of rotations (E, 3, 3) of less than a half turn."""
    axis = np.stack((turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]), axis=1)
    double_sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(double_sine, np.trace(turn, axis1=1, axis2=2) - 1.0)
    return np.asarray(axis * (angle / np.maximum(double_sine, 1e-12))[:, None])


def _exponentials(vector: FloatArray) -> FloatArray:
    """Return the rotations (N, 3, 3) of rotation vectors (N, 3)."""
    angle = np.linalg.norm(vector, axis=1)[:, None, None]
    cross = _crosses(vector)
    sine = np.sinc(angle / np.pi)
    half = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.asarray(np.eye(3) + sine * cross + half * (cross @ cross))
