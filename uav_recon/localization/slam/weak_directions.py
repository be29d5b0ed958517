"""Weak directions: translations of which a frame has information on paper only.

Normals of a bare wall scatter, edges of an image lean, and what walls and edges leave undetermined is never exactly parallel.
All functions change the equations of a frame: information (M, SIZE, SIZE) and gradient (M, SIZE) against each of M keyframes,
whose first six elements are the turn of the camera in odom axes and its place.
Zhang, Kaess and Singh 2016, On Degeneracy of Optimization-based State Estimation Problems.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from uav_recon.localization.slam.landmarks import SIZE
from uav_recon.types.frames import FloatArray

_PLACE = slice(3, 6)
# A frame tells less of each direction by this share of its information in the best one: along a plane the noise of the normals
# would hold the camera to where it was.
_WEAK_SHARE = 0.005
_WEAK_M = 0.03  # a frame tells nothing of a direction that it shows less well than this
_DOUBTED_SHARE = 0.1  # directions with less of the information in the best one are tried ...
_TRIED_M = 0.04  # ... by moving the camera by this to both sides
# Landmarks tell nothing of a direction in which they have less than this share of the information of perfect corners: all of
# them are on edges then, and follow the prediction along these.
_EDGES_SHARE = 0.05
_LEAST_SHOWN = 1.0  # keeps the shares finite in directions that no landmark could show
_TINY = 1e-9
_UNKNOWN_M2 = 100.0  # variance of a place of which nothing is known


def noise_of_normals(
    information: FloatArray, leaning: FloatArray, turn_sigma_rad: float, pull_at: Callable[[FloatArray], FloatArray] | None
) -> FloatArray:
    """Return the noise (M, 3, 3) of the place of each keyframe, m², by its normals.

    Where the normals of a bare wall scatter, the equations are those of a wall that shows the place along it; but a camera that
    is moved along it, to either side, is not pulled back. pull_at(ahead_m): gradient (M, 3) on the place from places farther by
    (M, 3), one for each keyframe; None far from the pose, where it says nothing.
    leaning (M,): as in _equations().
    Zhang, Kaess and Singh 2016, On Degeneracy of Optimization-based State Estimation Problems.
    """
    turn = information[:, :3, :3] + np.eye(3) * turn_sigma_rad**-2
    across = information[:, :3, _PLACE]
    alone = information[:, _PLACE, _PLACE] - np.swapaxes(across, 1, 2) @ np.linalg.solve(turn, across)
    values, directions = np.linalg.eigh(alone)
    left = np.maximum(values, 0.0)
    for k in range(2):
        weak = values[:, k] < _DOUBTED_SHARE * values[:, -1]
        if pull_at is None or not weak.any():
            break
        ahead_m = _TRIED_M * directions[:, :, k]
        there, back = (np.einsum("ma,ma->m", pull_at(side * ahead_m), ahead_m) for side in (1.0, -1.0))
        pulled = np.clip(np.minimum(-there, back) / _TRIED_M**2, 0.0, left[:, k])
        left[:, k] = np.where(weak, pulled, left[:, k])
    noise = _noise(values, left) + leaning[:, None]
    return np.asarray((directions * noise[:, None]) @ np.swapaxes(directions, 1, 2))


def _noise(values: FloatArray, left: FloatArray) -> FloatArray:
    """Return the variances (..., 3) of noise with which less information is left.

    values (..., 3): information without the noise; left (..., 3): with it.
    """
    return np.asarray(np.minimum(1.0 / np.maximum(left, _TINY) - 1.0 / np.maximum(values, _TINY), _UNKNOWN_M2))


def leave_weak_directions(information: FloatArray, gradient: FloatArray, turn_sigma_rad: float, support: float) -> float:
    """Remove the translations that all keyframes together do not determine.

    From the equations of depth, or of all.
    support: weight of depth as a whole. Returns the standard deviation of the worst translation.
    """
    both = information.sum(axis=0)
    turn = both[:3, :3] + np.eye(3) * turn_sigma_rad**-2
    alone = both[3:6, 3:6] - both[3:6, :3] @ np.linalg.solve(turn, both[:3, 3:6])
    values, directions = np.linalg.eigh(0.5 * (alone + alone.T))
    left = np.maximum(values - max(_WEAK_SHARE * values[-1], support * _WEAK_M**-2), 0.0)
    noise = (directions * _noise(values, left)) @ directions.T
    add_noise(information, gradient, np.tile(noise, (len(information), 1, 1)))
    return 1.0 / math.sqrt(max(float(left[0]), _TINY))


def add_noise(information: FloatArray, gradient: FloatArray, noise: FloatArray) -> None:
    """Let the place of each keyframe be off by noise (M, 3, 3), m².

    In what a frame says of it.
    The offset is an unknown that is eliminated from the equations.
    """
    place = information[:, _PLACE, _PLACE]
    gain = information[:, :, _PLACE] @ noise @ np.linalg.inv(np.eye(3) + place @ noise)
    gradient -= np.einsum("mab,mb->ma", gain, gradient[:, _PLACE])
    left = information - gain @ information[:, _PLACE]
    information[:] = 0.5 * (left + np.swapaxes(left, 1, 2))


def leave_edges(information: FloatArray, gradient: FloatArray, shown: FloatArray) -> None:
    """Remove from the equations of landmarks the translations along their edges.

    Of each keyframe on its own.
    The direction of an edge in an image is known to some degrees only. shown (M, 3, 3): of add_landmark_equations().
    """
    for m in np.flatnonzero(shown.any(axis=(1, 2))).tolist():
        perfect = shown[m] + _LEAST_SHOWN * np.eye(3)
        root = np.linalg.inv(np.linalg.cholesky(perfect))
        values, vectors = np.linalg.eigh(root @ information[m, _PLACE, _PLACE] @ root.T)
        along = root.T @ vectors[:, values < _EDGES_SHARE]
        if along.size:
            kept = np.eye(SIZE)
            kept[_PLACE, _PLACE] -= along @ along.T @ perfect
            information[m] = kept.T @ information[m] @ kept
            gradient[m] = gradient[m] @ kept
