"""Registration of an RGB-D frame: Gauss-Newton on depth, landmarks and motion together."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.localization.slam.depth_points import add_depth_equations
from uav_recon.localization.slam.landmarks import SIZE, Landmarks, add_landmark_equations
from uav_recon.localization.slam.rgbd_view import RgbdView
from uav_recon.localization.slam.tsdf_volume import TsdfVolume
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

_ROUNDS = 10
_FAR_ROUNDS = 8  # before them, from a far start
_STEPS = (-1.0, -0.5, 0.0, 0.5, 1.0)  # of a search along an axis, in shares of its reach
_SHIFTS = np.array([(x, y, z) for x in _STEPS for y in _STEPS for z in _STEPS])
_STILL_M = 2e-4
_STILL_RAD = 1e-4
_WIDER = (4.0, 2.0, 1.0)  # scale of the robust weight of depth in the first rounds: a far start must be pulled, too
_DEPTH_SHARE = 0.3  # weight of a depth point: the errors of neighbours are alike
# shares of known points on known surfaces below which depth says nothing, and above which it counts in full
_UNFIT = 0.55
_FITTING = 0.85
_ENOUGH_POINTS = 250  # points on known surfaces from which on depth counts in full
_FEWEST_LANDMARKS = 12
_AGREEING_SHARE = 0.5
_POSE = slice(0, 6)
# Depth tells nothing of a direction in which it has less than this share of its information: along a plane the noise of the
# field would hold the camera to where it was.
_WEAK_SHARE = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class MotionPrior:
    """The predicted pose of the depth imager, and how well it is known.

    covariance (6, 6): of a rotation in odom axes about the camera, and of its place. turn_sigma_rad: of the turn since the
    newest frame, per axis. rate_radps (3,), velocity_mps (3,): of the camera in odom. slow (2,): delay and width of the colour
    image (landmarks.DELAY, WIDTH); slow_covariance (2, 2).
    """

    odom_from_depth: Pose
    covariance: FloatArray
    turn_sigma_rad: float
    rate_radps: FloatArray
    velocity_mps: FloatArray
    slow: FloatArray
    slow_covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The pose of a frame, and what supports it.

    covariance (6, 6): of a rotation in odom axes about the camera, and of its place. points, known, inliers: depth points,
    those in known space, those on a known surface. landmarks: number that fit. slow, slow_covariance: as in MotionPrior, after
    this frame.
    """

    odom_from_depth: Pose
    covariance: FloatArray
    points: int
    known: int
    inliers: int
    landmarks: int
    slow: FloatArray
    slow_covariance: FloatArray

    @property
    def coverage(self) -> float:
        """Share of the depth points that lie in known space."""
        return self.known / max(self.points, 1)

    @property
    def fit(self) -> float:
        """Share of the points in known space that lie on a known surface."""
        return self.inliers / max(self.known, 1)


def search(view: RgbdView, volume: TsdfVolume, prior: MotionPrior, reach_m: float) -> Registration:
    """Return the pose at which depth alone fits the map, near the predicted one. About 20 ms.

    reach_m: of the search along each axis. From a far start most points lie off their surfaces: this says nothing against
    depth there.
    """
    place_m, rotation = prior.odom_from_depth.translation_m, prior.odom_from_depth.rotation()
    fitting = [_inliers(view, volume, rotation, place_m + reach_m * shift) for shift in _SHIFTS]
    return _converge(view, volume, Landmarks.none(), prior, reach_m * _SHIFTS[int(np.argmax(fitting))])


def register(view: RgbdView, volume: TsdfVolume, landmarks: Landmarks, prior: MotionPrior) -> Registration:
    """Return the pose at which the frame fits the map, from the predicted one on. About 2 ms.

    Landmarks of which too few agree are those of a view without texture, and left out.
    """
    found = _converge(view, volume, landmarks, prior)
    followed = len(landmarks.place_m)
    if followed and found.landmarks < max(_FEWEST_LANDMARKS, _AGREEING_SHARE * followed):
        return _converge(view, volume, Landmarks.none(), prior)
    return found


def _converge(
    view: RgbdView, volume: TsdfVolume, landmarks: Landmarks, prior: MotionPrior, shift_m: FloatArray | None = None
) -> Registration:
    """Run Gauss-Newton from the predicted pose.

    shift_m (3,): from a place farther by this instead; depth counts at first even where it does not fit.
    """
    rotation = prior.odom_from_depth.rotation()
    far, moved_m = shift_m is not None, np.zeros(3) if shift_m is None else shift_m
    place_m = prior.odom_from_depth.translation_m + moved_m
    turned_rad, slow = np.zeros(3), prior.slow.copy()
    predicted = np.linalg.inv(prior.covariance)
    slow_information = np.linalg.inv(prior.slow_covariance)
    motion = np.concatenate((prior.rate_radps, prior.velocity_mps))
    known = inliers = fitting = 0
    information = np.zeros((SIZE, SIZE))
    rounds = _ROUNDS + _FAR_ROUNDS if far else _ROUNDS
    for number in range(rounds):
        wide = _WIDER[0] if number < rounds - _ROUNDS else _WIDER[min(number - rounds + _ROUNDS, len(_WIDER) - 1)]
        information, gradient = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
        known, inliers = add_depth_equations(
            view.points, rotation, place_m, volume.index, volume.distance, volume.weight, _DEPTH_SHARE, wide,
            information, gradient,
        )  # fmt: skip
        support = 1.0 if far and number < _FAR_ROUNDS else _support(known, inliers)
        information *= support
        gradient *= support
        _leave_weak_directions(information, gradient, prior.turn_sigma_rad)
        eye = rotation @ view.depth_from_rgb.rotation(), rotation @ view.depth_from_rgb.translation_m + place_m
        fitting = add_landmark_equations(
            landmarks.place_m, landmarks.slope, landmarks.texture, landmarks.at_px, view.camera, *eye, place_m, motion, slow,
            slow - prior.slow, information, gradient,
        )  # fmt: skip
        whole = information.copy()
        whole[_POSE, _POSE] += predicted
        whole[6:, 6:] += slow_information
        gradient[_POSE] -= predicted @ np.concatenate((turned_rad, moved_m))
        gradient[6:] -= slow_information @ (slow - prior.slow)
        step = np.asarray(np.linalg.solve(whole, gradient), dtype=np.float64)
        rotation = Pose.from_rotation_vector(step[:3], np.zeros(3)).rotation() @ rotation
        place_m = place_m + step[3:6]
        turned_rad, moved_m, slow = turned_rad + step[:3], moved_m + step[3:6], slow + step[6:]
        if (
            wide == 1.0
            and number >= rounds - _ROUNDS + len(_WIDER) - 1
            and math.hypot(*step[3:6].tolist()) < _STILL_M
            and math.hypot(*step[:3].tolist()) < _STILL_RAD
        ):
            break
    covariance = np.asarray(np.linalg.inv(whole), dtype=np.float64)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, place_m
    return Registration(
        Pose.from_matrix(matrix), covariance[_POSE, _POSE], len(view.points), known, inliers, fitting, slow, covariance[6:, 6:],
    )  # fmt: skip


def _inliers(view: RgbdView, volume: TsdfVolume, rotation: FloatArray, place_m: FloatArray) -> int:
    """Return the number of depth points on a known surface from a pose."""
    unused = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    seen = view.points, rotation, place_m, volume.index, volume.distance, volume.weight
    return int(add_depth_equations(*seen, _DEPTH_SHARE, _WIDER[0], *unused)[1])


def _support(known: int, inliers: int) -> float:
    """Return the weight 0 to 1 of depth as a whole.

    It is little where little is known, or where much of it does not fit.
    """
    fit = inliers / max(known, 1)
    fitting = min(max((fit - _UNFIT) / (_FITTING - _UNFIT), 0.0), 1.0)
    return max(fitting**2 * min(inliers / _ENOUGH_POINTS, 1.0) ** 2, 1e-6)


def _leave_weak_directions(information: FloatArray, gradient: FloatArray, turn_sigma_rad: float) -> None:
    """Remove from the equations of depth the translations that it does not determine.

    Zhang, Kaess and Singh 2016, On Degeneracy of Optimization-based State Estimation Problems.
    """
    turn = information[:3, :3] + np.eye(3) * turn_sigma_rad**-2
    alone = information[3:6, 3:6] - information[3:6, :3] @ np.linalg.solve(turn, information[:3, 3:6])
    values, directions = np.linalg.eigh(0.5 * (alone + alone.T))
    weak = directions[:, values < _WEAK_SHARE * values[-1]]
    if not weak.size:
        return
    kept = np.eye(SIZE)
    kept[3:6, 3:6] -= weak @ weak.T
    information[:] = kept @ information @ kept
    gradient[:] = kept @ gradient
