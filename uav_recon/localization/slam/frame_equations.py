"""Gauss-Newton equations of a frame against keyframes: depth, landmarks and prediction.

The unknowns are a small rotation in odom axes about the camera, its place, delay and width of the colour image, the place
lately, and the places of M keyframes: SIZE + 3 + 3 M.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.small_matrices import product, solve_in_place, symmetric_eigen
from uav_recon.localization.slam.depth_points import add_depth_equations
from uav_recon.localization.slam.keyframe_map import Keyframes
from uav_recon.localization.slam.landmarks import SIZE, Landmarks, MovingImager, add_landmark_equations
from uav_recon.localization.slam.weak_directions import (
    TriedDepth,
    add_noise,
    leave_edges,
    leave_weak_directions,
    noise_of_normals,
)
from uav_recon.types.frames import AnyArray

_ROUNDS = 10
_FAR_ROUNDS = 8  # before them, from a far start
_WIDER = (4.0, 2.0, 1.0)  # scale of the robust weights in the first rounds: a far start must be pulled, too
_TRIED_ROUNDS = (0, 2)  # near the pose, in which weak directions of depth are tried
DEPTH_SHARE = 0.3  # weight of a depth point: the errors of neighbours are alike
# shares of known points on known surfaces below which depth says nothing, and above which it counts in full
_UNFIT = 0.55
_FITTING = 0.85
_ENOUGH_POINTS = 250  # points on known surfaces from which on depth counts in full
_STILL_M = 2e-4
_STILL_RAD = 1e-4


class ComparedFrame(NamedTuple):
    """A frame, and what it is compared with, for kernels.

    points (N, 3): of depth. camera (4,): of the colour image. rotation (3, 3), offset_m (3,): pose of the colour imager in the
    frame of the depth imager. motion (6,): as in MovingImager. doubt (M, 3, 3): as in add_depth_equations(). leaning (M,):
    as in noise_of_normals(). landmark_share: weight of a landmark. turn_sigma_rad: of the predicted turn, per axis.
    """

    points: AnyArray
    camera: AnyArray
    rotation: AnyArray
    offset_m: AnyArray
    motion: AnyArray
    keyframes: Keyframes
    landmarks: Landmarks
    doubt: AnyArray
    leaning: AnyArray
    landmark_share: float
    turn_sigma_rad: float


class Predicted(NamedTuple):
    """Information of the prediction, for kernels.

    attitude (3, 3), slow (2, 2), places (6 + 3 M, 6 + 3 M): of the turn, of delay and width, which are predicted as slow_was
    (2,), and of the joint places.
    """

    attitude: AnyArray
    slow: AnyArray
    places: AnyArray
    slow_was: AnyArray


class PoseEstimate(NamedTuple):
    """Pose of a frame during Gauss-Newton; the kernels change its elements.

    rotation (3, 3), place_m (3,): in odom. turned_rad (3,): against the predicted pose. slow (2,). moved_m (6 + 3 M,): as in
    Registration.
    """

    rotation: AnyArray
    place_m: AnyArray
    turned_rad: AnyArray
    slow: AnyArray
    moved_m: AnyArray


class Equations(NamedTuple):
    """Normal equations of a frame against M keyframes; the kernels write its elements.

    information (M, SIZE, SIZE), gradient (M, SIZE). noise (M, 3, 3): of noise_of_normals(). fitting (M,): as in Registration.
    """

    information: AnyArray
    gradient: AnyArray
    noise: AnyArray
    fitting: AnyArray

    @staticmethod
    def empty(most: int) -> Equations:
        """Return room for the equations against this number of keyframes."""
        return Equations(np.zeros((most, SIZE, SIZE)), np.zeros((most, SIZE)), np.zeros((most, 3, 3)), np.zeros(most, np.int64))


@kernel
def write_equations(
    compared: ComparedFrame, at: PoseEstimate, slow_was: AnyArray, wide: float, far: bool, tried: bool, out: Equations
) -> tuple[int, int, float, float]:
    """Write the equations of depth and landmarks at an estimate; return what depth alone says.

    That is the numbers of known points and of inliers, the standard deviation of the place in its worst direction, and the
    match, as in Registration.

    slow_was (2,): delay and width when the places of the landmarks were right. wide: factor on the scale of the robust weights.
    far: depth counts in full wherever it is. tried: the noise of normals is found here, else it is that of an earlier round.
    """
    information, gradient, keyframes = out.information, out.gradient, compared.keyframes
    most = information.shape[0]
    information[:], gradient[:], out.fitting[:] = 0.0, 0.0, 0
    moved_m = at.moved_m[6:].reshape(most, 3)
    moved = Keyframes(
        keyframes.number, keyframes.depth_m, keyframes.normal, keyframes.camera, keyframes.rotation,
        keyframes.place_m + moved_m, keyframes.variance,
    )  # fmt: skip
    known, inliers = add_depth_equations(
        compared.points, at.rotation, at.place_m, moved, compared.doubt, DEPTH_SHARE, wide, information, gradient
    )
    match = 0.0
    for m in range(most):
        for a in range(3, 6):
            match += information[m, a, a]
    support = 1.0 if far else _support(known, inliers)
    information *= support
    gradient *= support
    if far or tried:
        depth = TriedDepth(compared.points, at.rotation, at.place_m, moved, compared.doubt, support * DEPTH_SHARE)
        noise_of_normals(information, compared.leaning, compared.turn_sigma_rad, depth, not far, out.noise)
    add_noise(information, gradient, out.noise)
    depth_sigma_m = leave_weak_directions(information, gradient, compared.turn_sigma_rad, support)
    _add_corners(compared, at, moved_m, slow_was, wide, out)
    leave_weak_directions(information, gradient, compared.turn_sigma_rad, support)
    return known, inliers, depth_sigma_m, match


@kernel
def _add_corners(
    compared: ComparedFrame, at: PoseEstimate, moved_m: AnyArray, slow_was: AnyArray, wide: float, out: Equations
) -> None:
    """Add the equations of landmarks.

    moved_m (M, 3): of the keyframes. Other arguments: as of write_equations().
    """
    most, landmarks = moved_m.shape[0], compared.landmarks
    if not landmarks.keyframe.shape[0]:
        return
    place_m = landmarks.place_m.copy()
    for n in range(place_m.shape[0]):
        place_m[n] += moved_m[landmarks.keyframe[n]]
    there = Landmarks(place_m, landmarks.slope, landmarks.at_px, landmarks.texture, landmarks.keyframe, landmarks.corner)
    eye_m = product(at.rotation, compared.offset_m.reshape(3, 1))[:, 0] + at.place_m
    imager = MovingImager(compared.camera, product(at.rotation, compared.rotation), eye_m, at.place_m, compared.motion, at.slow)
    corners, pull = np.zeros((most, SIZE, SIZE)), np.zeros((most, SIZE))
    shown, leaning = np.zeros((most, 3, 3)), np.zeros((most, 3, 3))
    add_landmark_equations(there, imager, at.slow - slow_was, compared.landmark_share, wide, corners, pull, shown, out.fitting)
    leave_edges(corners, pull, shown)
    for m in range(most):
        for a in range(3):
            leaning[m, a, a] = compared.leaning[m]
    add_noise(corners, pull, leaning)
    information, gradient = out.information, out.gradient
    information += corners
    gradient += pull


@kernel
def _support(known: int, inliers: int) -> float:
    """Return the weight 0 to 1 of depth as a whole.

    It is little where little is known, or where much of it does not fit.
    """
    fit = inliers / max(known, 1)
    fitting = min(max((fit - _UNFIT) / (_FITTING - _UNFIT), 0.0), 1.0)
    return float(max(fitting**2 * min(inliers / _ENOUGH_POINTS, 1.0) ** 2, 1e-6))


@kernel
def take_step(equations: Equations, predicted: Predicted, at: PoseEstimate, whole: AnyArray) -> bool:
    """Go to the solution of the equations and the prediction.

    Return True if the pose has hardly moved. whole: information of all unknowns, which is written.
    """
    pull = np.zeros((whole.shape[0], 1))
    _write_whole(equations, predicted, at, whole, pull)
    solve_in_place(whole.copy(), pull)
    step = pull[:, 0]
    at.rotation[:] = product(_rotation(step[:3]), at.rotation)
    at.turned_rad[:] += step[:3]
    at.place_m[:] += step[3:6]
    at.slow[:] += step[6:SIZE]
    at.moved_m[:3] += step[3:6]
    at.moved_m[3:] += step[SIZE:]
    moved_m2, turned2 = 0.0, 0.0
    for a in range(3):
        moved_m2, turned2 = moved_m2 + step[3 + a] ** 2, turned2 + step[a] ** 2
    return bool(moved_m2 < _STILL_M**2 and turned2 < _STILL_RAD**2)


@kernel
def _write_whole(equations: Equations, predicted: Predicted, at: PoseEstimate, whole: AnyArray, pull: AnyArray) -> None:
    """Write information (K, K) and gradient (K, 1) of all unknowns."""
    information, gradient = equations.information, equations.gradient
    whole[:], pull[:] = 0.0, 0.0
    whole[:SIZE, :SIZE], pull[:SIZE, 0] = information.sum(axis=0), gradient.sum(axis=0)
    for m in range(information.shape[0]):
        first, last = SIZE + 3 + 3 * m, SIZE + 6 + 3 * m  # a keyframe that moves is a camera that moves back
        whole[first:last, :SIZE], whole[:SIZE, first:last] = -information[m, 3:6], -information[m, :, 3:6]
        whole[first:last, first:last], pull[first:last, 0] = information[m, 3:6, 3:6], -gradient[m, 3:6]
    places = np.arange(SIZE - 3, whole.shape[0])
    places[:3] = np.arange(3, 6)
    _add_prior(whole, pull, np.arange(3), predicted.attitude, at.turned_rad)
    _add_prior(whole, pull, np.arange(6, SIZE), predicted.slow, at.slow - predicted.slow_was)
    _add_prior(whole, pull, places, predicted.places, at.moved_m)


@kernel
def _add_prior(whole: AnyArray, pull: AnyArray, elements: AnyArray, information: AnyArray, off: AnyArray) -> None:
    """Add what is predicted of some of the unknowns (N,), which are off by (N,) from it."""
    for a in range(elements.shape[0]):
        for b in range(elements.shape[0]):
            whole[elements[a], elements[b]] += information[a, b]
            pull[elements[a], 0] -= information[a, b] * off[b]


@kernel
def _rotation(turn_rad: AnyArray) -> AnyArray:
    """Return the rotation matrix (3, 3) of a rotation vector (3,)."""
    angle = np.sqrt(turn_rad[0] ** 2 + turn_rad[1] ** 2 + turn_rad[2] ** 2)
    half = 0.5 * np.sin(0.5 * angle) / (0.5 * angle) if angle > 1e-9 else 0.5
    w, x, y, z = np.cos(0.5 * angle), half * turn_rad[0], half * turn_rad[1], half * turn_rad[2]
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return out


@kernel
def converge(
    compared: ComparedFrame, predicted: Predicted, at: PoseEstimate, equations: Equations, whole: AnyArray, far: bool
) -> tuple[int, int, float, float]:
    """Run Gauss-Newton from an estimate, which becomes the pose of the frame.

    Writes the equations and the information of all unknowns of the last round. far: from a far start; depth counts at first
    even where it does not fit. Returns what write_equations() returns.
    """
    before = _FAR_ROUNDS if far else 0
    known, inliers, depth_sigma_m, match = 0, 0, 0.0, 0.0
    for number in range(-before, _ROUNDS):
        wide = _WIDER[min(max(number, 0), len(_WIDER) - 1)]
        known, inliers, depth_sigma_m, match = write_equations(
            compared, at, predicted.slow_was, wide, number < 0, number in _TRIED_ROUNDS, equations
        )
        if take_step(equations, predicted, at, whole) and number >= len(_WIDER) - 1:
            break
    return known, inliers, depth_sigma_m, match


@kernel
def determined_share(equations: Equations, predicted: Predicted) -> AnyArray:
    """Return the share (3, 3) of the place that a frame has determined, against the prediction.

    Its eigenvalues are between 0 and 1.
    """
    shown, others = equations.information.sum(axis=0), np.array([0, 1, 2, 6, 7])
    known, across = np.empty((5, 5)), np.empty((5, 3))
    for a in range(5):
        across[a] = shown[others[a], 3:6]
        for b in range(5):
            known[a, b] = shown[others[a], others[b]]
    known[:3, :3] += predicted.attitude
    known[3:, 3:] += predicted.slow
    gain, before, left = across.copy(), np.eye(3), np.eye(3)
    solve_in_place(known, gain)
    place = shown[3:6, 3:6] - product(across.T, gain)
    solve_in_place(predicted.places[:3, :3].copy(), before)
    values, axes = symmetric_eigen(before)
    root = product(axes * np.sqrt(np.maximum(values, 0.0)), axes.T)
    solve_in_place(np.eye(3) + product(root, product(place, root)), left)
    return np.eye(3) - left
