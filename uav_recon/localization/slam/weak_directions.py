"""Weak directions: translations of which a frame has information on paper only.

Normals of a bare wall scatter, edges of an image lean, and what walls and edges leave undetermined is never exactly parallel.
The kernels change the equations of a frame: information (M, SIZE, SIZE) and gradient (M, SIZE) against each of M keyframes,
whose first six elements are the turn of the camera in odom axes and its place.
Zhang, Kaess and Singh 2016, On Degeneracy of Optimization-based State Estimation Problems.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.small_matrices import product, solve_in_place, symmetric_eigen
from uav_recon.localization.slam.depth_points import add_depth_equations
from uav_recon.localization.slam.keyframe_map import Keyframes
from uav_recon.types.frames import AnyArray

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
TRIED_SCALE = 4.0  # of the robust weight: a wall that pulls back pulls from there, too
_UNKNOWN_M2 = 100.0  # variance of a place of which nothing is known


class TriedDepth(NamedTuple):
    """Depth with which weak directions are tried, for kernels.

    points (N, 3), rotation (3, 3), place_m (3,), keyframes, doubt (M, 3, 3), share: as of add_depth_equations().
    """

    points: AnyArray
    rotation: AnyArray
    place_m: AnyArray
    keyframes: Keyframes
    doubt: AnyArray
    share: float


@kernel
def noise_of_normals(
    information: AnyArray, leaning: AnyArray, turn_sigma_rad: float, depth: TriedDepth, tried: bool, out: AnyArray
) -> None:
    """Write the noise (M, 3, 3) of the place of each keyframe, m², by its normals.

    Where the normals of a bare wall scatter, the equations are those of a wall that shows the place along it; but a camera that
    is moved along it, to either side, is not pulled back. tried: it is moved; far from the pose this says nothing.
    leaning (M,): variance (m²) of a distance to a surface of each keyframe by its normal, which is off.
    Zhang, Kaess and Singh 2016, On Degeneracy of Optimization-based State Estimation Problems.
    """
    most = information.shape[0]
    values, directions, left = np.empty((most, 3)), np.empty((most, 3, 3)), np.empty((most, 3))
    for m in range(most):
        values[m], directions[m] = _place_alone(information[m], turn_sigma_rad)
        for k in range(3):
            left[m, k] = max(values[m, k], 0.0)
    for k in range(2):
        weak = values[:, k] < _DOUBTED_SHARE * values[:, 2]
        if not (tried and weak.any()):
            break
        ahead, back = _pulled(depth, directions[:, :, k], _TRIED_M), _pulled(depth, directions[:, :, k], -_TRIED_M)
        for m in range(most):
            if weak[m]:
                left[m, k] = min(max(min(ahead[m], back[m]), 0.0), left[m, k])
    for m in range(most):
        out[m] = _noise(values[m], left[m], directions[m])
        for a in range(3):
            out[m, a, a] += leaning[m]


@kernel
def _pulled(depth: TriedDepth, directions: AnyArray, moved_m: float) -> AnyArray:
    """Return the information (M,) with which depth pulls a moved camera back.

    It is moved in a direction (M, 3) of each keyframe.
    """
    most, frames = directions.shape[0], depth.keyframes
    away = Keyframes(
        frames.number, frames.depth_m, frames.normal, frames.camera, frames.rotation,
        frames.place_m - moved_m * directions, frames.variance,
    )  # fmt: skip
    unused, gradient, out = np.zeros((most, 6, 6)), np.zeros((most, 6)), np.zeros(most)
    add_depth_equations(
        depth.points, depth.rotation, depth.place_m, away, depth.doubt, depth.share, TRIED_SCALE, unused, gradient, False
    )
    for m in range(most):
        for a in range(3):
            out[m] -= gradient[m, 3 + a] * directions[m, a] / moved_m
    return out


@kernel
def _place_alone(information: AnyArray, turn_sigma_rad: float) -> tuple[AnyArray, AnyArray]:
    """Return eigenvalues (3,) and directions (3, 3) of the information on the place alone.

    Of information (SIZE, SIZE). The turn is eliminated. Smallest value first, directions in columns.
    """
    turn, gain = information[:3, :3].copy(), information[:3, 3:6].copy()
    for a in range(3):
        turn[a, a] += turn_sigma_rad**-2
    solve_in_place(turn, gain)
    alone = information[3:6, 3:6] - product(information[3:6, :3], gain)
    return symmetric_eigen(0.5 * (alone + alone.T))


@kernel
def _noise(values: AnyArray, left: AnyArray, directions: AnyArray) -> AnyArray:
    """Return the noise (3, 3), m², with which less information is left.

    values (3,): information without the noise, along directions (3, 3) in columns; left (3,): with it.
    """
    out = np.zeros((3, 3))
    for k in range(3):
        noise = min(1.0 / max(left[k], _TINY) - 1.0 / max(values[k], _TINY), _UNKNOWN_M2)
        for a in range(3):
            for b in range(3):
                out[a, b] += noise * directions[a, k] * directions[b, k]
    return out


@kernel
def leave_weak_directions(information: AnyArray, gradient: AnyArray, turn_sigma_rad: float, support: float) -> float:
    """Remove the translations that all keyframes together do not determine.

    From the equations of depth, or of all.
    support: weight of depth as a whole. Returns the standard deviation of the worst translation.
    """
    values, directions = _place_alone(information.sum(axis=0), turn_sigma_rad)
    left = np.empty(3)
    for k in range(3):
        left[k] = max(values[k] - max(_WEAK_SHARE * values[2], support * _WEAK_M**-2), 0.0)
    noise = np.empty((information.shape[0], 3, 3))
    noise[:] = _noise(values, left, directions)
    add_noise(information, gradient, noise)
    return float(1.0 / np.sqrt(max(left[0], _TINY)))


@kernel
def add_noise(information: AnyArray, gradient: AnyArray, noise: AnyArray) -> None:
    """Let the place of each keyframe be off by noise (M, 3, 3), m².

    In what a frame says of it.
    The offset is an unknown that is eliminated from the equations.
    """
    for m in range(information.shape[0]):
        # gain = information[:, place] @ noise @ inv(1 + place @ noise), with the noise symmetric
        spread, gain = product(noise[m], information[m, 3:6, 3:6]), product(noise[m], information[m, 3:6, :])
        for a in range(3):
            spread[a, a] += 1.0
        solve_in_place(spread, gain)
        gradient[m] -= product(gradient[m, 3:6].reshape(1, 3), gain)[0]
        less = product(information[m, :, 3:6], gain)
        information[m] -= 0.5 * (less + less.T)


@kernel
def leave_edges(information: AnyArray, gradient: AnyArray, shown: AnyArray) -> None:
    """Remove from the equations of landmarks the translations along their edges.

    Of each keyframe on its own.
    The direction of an edge in an image is known to some degrees only. shown (M, 3, 3): of add_landmark_equations().
    """
    size = information.shape[1]
    for m in range(information.shape[0]):
        if not shown[m].any():
            continue
        perfect, kept = shown[m].copy(), np.eye(size)
        for a in range(3):
            perfect[a, a] += _LEAST_SHOWN
        values, vectors = symmetric_eigen(perfect)
        root = vectors / np.sqrt(values)
        shares, axes = symmetric_eigen(product(root.T, product(information[m, 3:6, 3:6], root)))
        along = product(root, axes)
        across = product(along.T, perfect)
        for k in range(3):
            if shares[k] < _EDGES_SHARE:
                for a in range(3):
                    for b in range(3):
                        kept[3 + a, 3 + b] -= along[a, k] * across[k, b]
        information[m] = product(kept.T, product(information[m], kept))
        gradient[m] = product(gradient[m].reshape(1, size), kept)[0]
