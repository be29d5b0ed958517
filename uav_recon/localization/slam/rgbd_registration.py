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
_SEARCH_STARTS = 4  # of a search, those that fit best
_APART_M = 0.1  # between places that are not the same
_STILL_M = 2e-4
_STILL_RAD = 1e-4
_WIDER = (4.0, 2.0, 1.0)  # scale of the robust weight of depth in the first rounds: a far start must be pulled, too
_DEPTH_SHARE = 0.3  # weight of a depth point: the errors of neighbours are alike
# shares of known points on known surfaces below which depth says nothing, and above which it counts in full
_UNFIT = 0.55
_FITTING = 0.85
_ENOUGH_POINTS = 250  # points on known surfaces from which on depth counts in full
_FEWEST_LANDMARKS = 4
_AGREEING_SHARE = 0.5
_POSE = slice(0, 6)
_ALL = np.empty((0, 3))
_FEWEST_FACING = 25  # points on surfaces that face a weak direction, from which on they count in it
# Depth tells nothing of a direction in which it has less than this share of its information: along a plane the noise of the
# field would hold the camera to where it was.
_WEAK_SHARE = 0.005
# Landmarks tell nothing of a direction in which they have less than this share of the information of perfect corners: all of
# them are on edges then, and follow the prediction along these.
_EDGES_SHARE = 0.12
_TINY = 1e-9
# Variances of an error that all landmarks of an image share: rows are read one after the other, and colour is not exactly where
# the calibration says. Small as it is, it would say much where the images show a translation at a flat angle only.
_SHARED_ERROR = np.diag([0.0005**2] * 3 + [0.003**2] * 3 + [0.0] * 2)
_LEAST_SHOWN = 1.0  # keeps the shares finite in directions that no landmark could show


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
    this frame. depth_sigma_m: of the place by depth alone, in its worst direction; infinite if depth does not determine it.
    match: sum of the weights of depth, larger for a better fit.
    """

    odom_from_depth: Pose
    covariance: FloatArray
    points: int
    known: int
    inliers: int
    landmarks: int
    slow: FloatArray
    slow_covariance: FloatArray
    depth_sigma_m: float
    match: float

    @property
    def coverage(self) -> float:
        """Share of the depth points that lie in known space."""
        return self.known / max(self.points, 1)

    @property
    def fit(self) -> float:
        """Share of the points in known space that lie on a known surface."""
        return self.inliers / max(self.known, 1)


def search(view: RgbdView, volume: TsdfVolume, prior: MotionPrior, reach_m: float) -> tuple[list[Registration], float]:
    """Return poses at which depth alone fits the map, near the predicted one, the best first. About 25 ms.

    The second value is the match of the best other place, as a share of the best one's. reach_m: of the search along each axis.
    From a far start most points lie off their surfaces: this says nothing against depth there.
    """
    place_m, rotation = prior.odom_from_depth.translation_m, prior.odom_from_depth.rotation()
    shifts_m = reach_m * _SHIFTS
    fitting = np.array([_inliers(view, volume, rotation, place_m + shift_m) for shift_m in shifts_m])
    starts: list[FloatArray] = []
    for number in np.argsort(-fitting, kind="stable"):
        if all(np.linalg.norm(shifts_m[number] - start_m) > _APART_M for start_m in starts):
            starts.append(shifts_m[number])
        if len(starts) == _SEARCH_STARTS:
            break
    ends = [_converge(view, volume, Landmarks.none(), prior, start_m) for start_m in starts]
    ends.sort(key=lambda end: -end.match)
    best = ends[0]
    there_m = best.odom_from_depth.translation_m
    others = [end.match for end in ends if np.linalg.norm(end.odom_from_depth.translation_m - there_m) > _APART_M]
    return ends, max(others, default=0.0) / max(best.match, _TINY)


def confirm(
    view: RgbdView, volume: TsdfVolume, landmarks: Landmarks, prior: MotionPrior, there: Registration
) -> Registration | None:
    """Return the pose near a place that a search has found, if enough landmarks agree."""
    found = _converge(view, volume, landmarks, prior, there.odom_from_depth.translation_m - prior.odom_from_depth.translation_m)
    return found if _agree(found, landmarks) else None


def register(view: RgbdView, volume: TsdfVolume, landmarks: Landmarks, prior: MotionPrior) -> Registration:
    """Return the pose at which the frame fits the map, from the predicted one on. About 2 ms.

    Landmarks of which too few agree are those of a view without texture, and left out.
    """
    found = _converge(view, volume, landmarks, prior)
    if len(landmarks.place_m) and not _agree(found, landmarks):
        return _converge(view, volume, Landmarks.none(), prior)
    return found


def _agree(found: Registration, landmarks: Landmarks) -> bool:
    return found.landmarks >= max(_FEWEST_LANDMARKS, _AGREEING_SHARE * len(landmarks.place_m))


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
    information, match, depth_sigma_m = np.zeros((SIZE, SIZE)), 0.0, math.inf
    rounds = _ROUNDS + _FAR_ROUNDS if far else _ROUNDS
    for number in range(rounds):
        wide = _WIDER[0] if number < rounds - _ROUNDS else _WIDER[min(number - rounds + _ROUNDS, len(_WIDER) - 1)]
        information, gradient = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
        depth = (
            view.points, rotation, place_m, volume.index, volume.distance, volume.weight, _DEPTH_SHARE, wide,
        )  # fmt: skip
        known, inliers = add_depth_equations(*depth, _ALL, information, gradient)
        match = float(np.trace(information[3:6, 3:6]))
        support = 1.0 if far and number < _FAR_ROUNDS else _support(known, inliers)
        information *= support
        gradient *= support
        weak, depth_sigma_m = _weak_directions(information, prior.turn_sigma_rad)
        if weak.size:
            facing_information, facing_gradient = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
            _, facing = add_depth_equations(*depth, np.ascontiguousarray(weak.T), facing_information, facing_gradient)
            if facing < _FEWEST_FACING:
                facing_information[:], facing_gradient[:] = 0.0, 0.0
            facing_information *= support
            facing_gradient *= support
            depth_sigma_m = _leave_directions(weak, information, gradient, facing_information, facing_gradient)
        eye = rotation @ view.depth_from_rgb.rotation(), rotation @ view.depth_from_rgb.translation_m + place_m
        landmark_information, landmark_gradient, shown = np.zeros((SIZE, SIZE)), np.zeros(SIZE), np.zeros((3, 3))
        fitting = add_landmark_equations(
            landmarks.place_m, landmarks.slope, landmarks.texture, landmarks.at_px, view.camera, *eye, place_m, motion, slow,
            slow - prior.slow, landmark_information, landmark_gradient, shown,
        )  # fmt: skip
        _leave_edges(landmark_information, landmark_gradient, shown)
        shared = np.eye(SIZE) + landmark_information @ _SHARED_ERROR
        information += np.linalg.solve(shared, landmark_information)
        gradient += np.linalg.solve(shared, landmark_gradient)
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
        depth_sigma_m, match,
    )  # fmt: skip


def _inliers(view: RgbdView, volume: TsdfVolume, rotation: FloatArray, place_m: FloatArray) -> int:
    """Return the number of depth points on a known surface from a pose."""
    unused = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    seen = view.points, rotation, place_m, volume.index, volume.distance, volume.weight
    return int(add_depth_equations(*seen, _DEPTH_SHARE, _WIDER[0], _ALL, *unused)[1])


def _support(known: int, inliers: int) -> float:
    """Return the weight 0 to 1 of depth as a whole.

    It is little where little is known, or where much of it does not fit.
    """
    fit = inliers / max(known, 1)
    fitting = min(max((fit - _UNFIT) / (_FITTING - _UNFIT), 0.0), 1.0)
    return max(fitting**2 * min(inliers / _ENOUGH_POINTS, 1.0) ** 2, 1e-6)


def _weak_directions(information: FloatArray, turn_sigma_rad: float) -> tuple[FloatArray, float]:
    """Return the translations (3, K) that depth does not determine, and the standard deviation of the worst other one.

    Zhang, Kaess and Singh 2016, On Degeneracy of Optimization-based State Estimation Problems.
    """
    turn = information[:3, :3] + np.eye(3) * turn_sigma_rad**-2
    alone = information[3:6, 3:6] - information[3:6, :3] @ np.linalg.solve(turn, information[:3, 3:6])
    values, directions = np.linalg.eigh(0.5 * (alone + alone.T))
    weak = values < _WEAK_SHARE * values[-1]
    return directions[:, weak], float(max(values[~weak].min(initial=values[-1]), _TINY)) ** -0.5


def _leave_directions(
    weak: FloatArray, information: FloatArray, gradient: FloatArray, facing: FloatArray, facing_gradient: FloatArray
) -> float:
    """Remove weak translations (3, K) from the equations of depth, but for the surfaces that face them.

    facing, facing_gradient: the share of those surfaces. Returns the standard deviation of the worst of the translations.
    """
    kept = np.eye(SIZE)
    kept[3:6, 3:6] -= weak @ weak.T
    information[:] = kept @ (information - facing) @ kept + facing
    gradient[:] = kept @ (gradient - facing_gradient) + facing_gradient
    least = float(np.linalg.eigvalsh(weak.T @ facing[3:6, 3:6] @ weak)[0])
    return 1.0 / math.sqrt(max(least, _TINY))


def _leave_edges(information: FloatArray, gradient: FloatArray, shown: FloatArray) -> None:
    """Remove from the equations of landmarks the translations along which all of them lie on edges.

    shown (3, 3): of add_landmark_equations().
    """
    perfect = shown + _LEAST_SHOWN * np.eye(3)
    root = np.linalg.inv(np.linalg.cholesky(perfect))
    values, vectors = np.linalg.eigh(root @ information[3:6, 3:6] @ root.T)
    along = root.T @ vectors[:, values < _EDGES_SHARE]
    if not along.size:
        return
    kept = np.eye(SIZE)
    kept[3:6, 3:6] -= along @ along.T @ perfect
    information[:] = kept.T @ information @ kept
    gradient[:] = kept.T @ gradient
