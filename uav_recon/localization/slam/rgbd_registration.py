"""Registration of an RGB-D frame: Gauss-Newton on depth, landmarks and motion together.

Prediction and landmarks are where the track has brought them, and share its error. Depth shows surfaces from before, whose
places may be known better. So the error of the track is one of the unknowns: a shift of prediction and landmarks together.
Its variance is that by which the track is less certain than the surfaces in view.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.localization.slam.depth_points import add_depth_equations
from uav_recon.localization.slam.landmarks import ROBUST_PX, SIZE, Landmarks, MovingImager, add_landmark_equations
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.localization.slam.tsdf_volume import TsdfVolume
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

_ROUNDS = 10
_FAR_ROUNDS = 8  # before them, from a far start
_STEP_M = 0.12  # between the starts of a search along an axis
_MOST_STEPS = (5, 2, 2)  # to each side, of a search along one, two or three axes
_SEARCH_STARTS = 4  # of a search, those that fit best
_APART_M = 0.1  # between places that are not the same
_STILL_M = 2e-4
_STILL_RAD = 1e-4
_WIDER = (4.0, 2.0, 1.0)  # scale of the robust weight in the first rounds: a far start must be pulled, too
_DEPTH_SHARE = 0.3  # weight of a depth point: the errors of neighbours are alike
# shares of known points on known surfaces below which depth says nothing, and above which it counts in full
_UNFIT = 0.55
_FITTING = 0.85
_ENOUGH_POINTS = 250  # points on known surfaces from which on depth counts in full
_FEWEST_LANDMARKS = 6
_AGREEING_SHARE = 0.5
_POSE = slice(0, 6)
# Depth tells less of each direction by this share of its information in the best one: along a plane the noise of the field
# would hold the camera to where it was.
_WEAK_SHARE = 0.005
# Landmarks tell nothing of a direction in which they have less than this share of the information of perfect corners: all of
# them are on edges then, and follow the prediction along these.
_EDGES_SHARE = 0.05
_LEAST_SHOWN = 1.0  # keeps the shares finite in directions that no landmark could show
_SHIFT = slice(SIZE, SIZE + 3)
_PLACE = slice(3, 6)
_UNSHIFTED_M2 = 1e-4**2  # variance of a track that is as certain as the surfaces
_DETERMINED_M = 0.02  # standard deviation of a place that depth alone determines
_DETERMINED_FIT_SHARE = 0.85  # of its points in known space, those on a known surface
_DETERMINED_POINTS = 250  # number of its points on known surfaces
_TINY = 1e-9
_NO_SURFACE = 0.01**-2  # weight of the track's own variance in that of the surfaces, which few or none may show


@dataclass(frozen=True, slots=True, eq=False)
class MotionPrior:
    """The predicted pose of the depth imager, and how well it is known.

    covariance (6, 6): of a rotation in odom axes about the camera, and of its place. turn_sigma_rad: of the turn since the
    newest frame, per axis. rate_radps (3,), velocity_mps (3,): of the camera in odom. slow (2,): delay and width of the colour
    image (landmarks.DELAY, WIDTH); slow_covariance (2, 2). track_variance (3,): of the place of the track itself, m² along the
    axes of odom, which the covariance does not contain.
    """

    odom_from_depth: Pose
    covariance: FloatArray
    turn_sigma_rad: float
    rate_radps: FloatArray
    velocity_mps: FloatArray
    slow: FloatArray
    slow_covariance: FloatArray
    track_variance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The pose of a frame, and what supports it.

    covariance (6, 6): of a rotation in odom axes about the camera, and of its place, against the track. shift_m (3,): of the
    track, which the pose contains. track_variance (3,): as in MotionPrior, after this frame. points, known, inliers: depth
    points, those in known space, those on a known surface. landmarks: number that fit. slow, slow_covariance: as in
    MotionPrior, after this frame. depth_sigma_m: of the place by depth alone, in its worst direction; infinite where depth does
    not determine it. match: sum of the weights of depth, larger for a better fit.
    """

    odom_from_depth: Pose
    covariance: FloatArray
    shift_m: FloatArray
    track_variance: FloatArray
    points: int
    known: int
    inliers: int
    landmarks: int
    slow: FloatArray
    slow_covariance: FloatArray
    depth_sigma_m: float
    match: float

    @property
    def variance(self) -> FloatArray:
        """Variance (3,) of the place, m² along the axes of odom."""
        return np.asarray(np.diagonal(self.covariance)[_PLACE] + self.track_variance)

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the place in its worst direction."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance[_PLACE, _PLACE] + np.diag(self.track_variance))[-1]))

    @property
    def sigma_against_track_m(self) -> float:
        """Standard deviation of the place against the track, in its worst direction."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance[_PLACE, _PLACE])[-1]))

    @property
    def coverage(self) -> float:
        """Share of the depth points that lie in known space."""
        return self.known / max(self.points, 1)

    @property
    def fit(self) -> float:
        """Share of the points in known space that lie on a known surface."""
        return self.inliers / max(self.known, 1)

    @property
    def determined(self) -> bool:
        """True if depth alone shows the place."""
        return self.depth_sigma_m <= _DETERMINED_M and self.fit >= _DETERMINED_FIT_SHARE and self.inliers >= _DETERMINED_POINTS

    @property
    def quality(self) -> int:
        """Quality 1 to 100 of an accepted frame."""
        support = min(1.0, self.known / 400.0) * self.fit + min(1.0, self.landmarks / 60.0)
        return int(np.clip(round(100.0 * min(1.0, support)), 1, 100))

    def surprise(self, prior: MotionPrior) -> float:
        """Return the squared innovation of the place, in standard deviations."""
        moved_m = self.odom_from_depth.translation_m - prior.odom_from_depth.translation_m - self.shift_m
        return float(moved_m @ np.linalg.solve(prior.covariance[_PLACE, _PLACE], moved_m))


def search(
    view: PreparedView, volume: TsdfVolume, prior: MotionPrior, reach_m: FloatArray, most_variance: float = math.inf
) -> tuple[Registration, float]:
    """Return the pose at which depth alone fits the map best, and the share of the next best.

    It looks near the predicted pose. The share is that of the match of the best pose elsewhere. reach_m (3,): of the search
    along each axis of odom. most_variance: of the surfaces that count, m². From a far start most points lie off their surfaces:
    this says nothing against depth there. About 20 ms.
    """
    place_m, rotation = prior.odom_from_depth.translation_m, prior.odom_from_depth.rotation()
    shifts_m = _shifts_m(reach_m)
    fitting = np.array([_inliers(view, volume, rotation, place_m + shift_m, most_variance) for shift_m in shifts_m])
    starts: list[FloatArray] = []
    for number in np.argsort(-fitting, kind="stable"):
        if all(np.linalg.norm(shifts_m[number] - start_m) > _APART_M for start_m in starts):
            starts.append(shifts_m[number])
        if len(starts) == _SEARCH_STARTS:
            break
    ends = [_converge(view, volume, Landmarks.none(), prior, start_m, most_variance) for start_m in starts]
    best = max(ends, key=lambda end: end.match)
    there_m = best.odom_from_depth.translation_m
    others = [end.match for end in ends if np.linalg.norm(end.odom_from_depth.translation_m - there_m) > _APART_M]
    return best, max(others, default=0.0) / max(best.match, _TINY)


def _shifts_m(reach_m: FloatArray) -> FloatArray:
    """Return the shifts (N, 3) of the starts of a search."""
    steps = np.ceil(reach_m / _STEP_M - 0.5).clip(0).astype(int)
    steps = np.minimum(steps, _MOST_STEPS[max(int(np.count_nonzero(steps)) - 1, 0)])
    ends = zip(reach_m.tolist(), steps.tolist(), strict=True)
    axes = [np.linspace(-reach, reach, 2 * number + 1) if number else np.zeros(1) for reach, number in ends]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def register(view: PreparedView, volume: TsdfVolume, landmarks: Landmarks, prior: MotionPrior) -> Registration:
    """Return the pose at which the frame fits the map, from the predicted one on. About 2 ms.

    Landmarks of which too few agree are those of a view without texture, and left out.
    """
    found = _converge(view, volume, landmarks, prior)
    followed = len(landmarks.place_m)
    if followed and found.landmarks < max(_FEWEST_LANDMARKS, _AGREEING_SHARE * followed):
        return _converge(view, volume, Landmarks.none(), prior)
    return found


def _converge(
    view: PreparedView,
    volume: TsdfVolume,
    landmarks: Landmarks,
    prior: MotionPrior,
    shift_m: FloatArray | None = None,
    most_variance: float = math.inf,
) -> Registration:
    """Run Gauss-Newton from the predicted pose.

    shift_m (3,): from a place farther by this instead; depth counts at first even where it does not fit. most_variance: of the
    surfaces that count.
    """
    rotation = prior.odom_from_depth.rotation()
    far, moved_m = shift_m is not None, np.zeros(3) if shift_m is None else shift_m
    place_m = prior.odom_from_depth.translation_m + moved_m
    turned_rad, slow, shifted_m = np.zeros(3), prior.slow.copy(), np.zeros(3)
    predicted = np.linalg.inv(prior.covariance)
    slow_information = np.linalg.inv(prior.slow_covariance)
    motion = np.concatenate((prior.rate_radps, prior.velocity_mps))
    blocks, depth_from_rgb = volume.blocks, view.depth_from_rgb.rotation()
    known = inliers = fitting = 0
    match, depth_sigma_m = 0.0, math.inf
    whole, track, surfaces = np.eye(_SHIFT.stop), prior.track_variance, prior.track_variance
    # that of landmarks is wider where the turn is not known: without a gyro
    turned_px = max(prior.turn_sigma_rad * float(view.camera[0]) / ROBUST_PX, 1.0)
    rounds = _ROUNDS + _FAR_ROUNDS if far else _ROUNDS
    for number in range(rounds):
        wide = _WIDER[0] if number < rounds - _ROUNDS else _WIDER[min(number - rounds + _ROUNDS, len(_WIDER) - 1)]
        information, gradient, errors = np.zeros((SIZE, SIZE)), np.zeros(SIZE), np.zeros((2, 3))
        known, inliers = add_depth_equations(
            view.points, rotation, place_m, blocks, track, most_variance, _DEPTH_SHARE, wide, information, gradient, errors
        )
        match = float(np.trace(information[_PLACE, _PLACE]))
        support = 1.0 if far and number < _FAR_ROUNDS else _support(known, inliers)
        information *= support
        gradient *= support
        depth_sigma_m = _leave_weak_directions(information, gradient, prior.turn_sigma_rad)
        tracked, pull, shown = np.zeros((SIZE, SIZE)), np.zeros(SIZE), np.zeros((3, 3))
        imager = MovingImager(
            camera=view.camera, rotation=rotation @ depth_from_rgb,
            eye_m=rotation @ view.depth_from_rgb.translation_m + place_m, turn_m=place_m, motion=motion, slow=slow,
        )  # fmt: skip
        fitting = add_landmark_equations(
            landmarks.place_m + shifted_m, landmarks.slope, landmarks.texture, landmarks.at_px, imager, slow - prior.slow,
            min(wide, turned_px), tracked, pull, shown,
        )  # fmt: skip
        _leave_edges(tracked, pull, shown)
        track = _track_variance(np.diagonal(tracked)[_PLACE], landmarks, np.diagonal(predicted)[_PLACE], prior.track_variance)
        surfaces = (errors[0] + _NO_SURFACE * track) / (errors[1] + _NO_SURFACE)
        tracked[_POSE, _POSE] += predicted
        tracked[6:, 6:] += slow_information
        pull[_POSE] -= predicted @ np.concatenate((turned_rad, moved_m - shifted_m))
        pull[6:] -= slow_information @ (slow - prior.slow)
        steady = 1.0 / (np.maximum(track - surfaces, 0.0) + _UNSHIFTED_M2)
        whole = _with_shift(information, tracked, steady)
        step = np.linalg.solve(whole, np.concatenate((gradient + pull, -pull[_PLACE] - steady * shifted_m)))
        rotation = Pose.from_rotation_vector(step[:3], np.zeros(3)).rotation() @ rotation
        place_m = place_m + step[_PLACE]
        turned_rad, moved_m, slow = turned_rad + step[:3], moved_m + step[_PLACE], slow + step[6:SIZE]
        shifted_m = shifted_m + step[_SHIFT]
        if (
            wide == 1.0
            and number >= rounds - _ROUNDS + len(_WIDER) - 1
            and math.hypot(*step[_PLACE].tolist()) < _STILL_M
            and math.hypot(*step[:3].tolist()) < _STILL_RAD
        ):
            break
    covariance = np.asarray(np.linalg.inv(whole), dtype=np.float64)
    left = np.minimum(track, surfaces) + np.diagonal(covariance)[_SHIFT]
    covariance = _against_track(covariance)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, place_m
    return Registration(
        Pose.from_matrix(matrix), covariance[_POSE, _POSE], shifted_m, left, len(view.points), known, inliers, fitting, slow,
        covariance[6:, 6:], depth_sigma_m, match,
    )  # fmt: skip


def _track_variance(shown: FloatArray, landmarks: Landmarks, predicted: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the variance (3,) of the track: of landmarks and prediction, by their information.

    shown, predicted (3,): information of both. variance (3,): of the prediction.
    """
    if not len(landmarks.variance):
        return variance
    return np.asarray((shown * landmarks.variance.mean(axis=0) + predicted * variance) / (shown + predicted))


def _with_shift(surfaces: FloatArray, track: FloatArray, steady: FloatArray) -> FloatArray:
    """Return the information (SIZE + 3, SIZE + 3) of pose, slow parameters and shift.

    surfaces, track (SIZE, SIZE): information of both on the pose. steady (3,): of the track on its own shift.
    """
    out = np.zeros((_SHIFT.stop, _SHIFT.stop))
    out[:SIZE, :SIZE] = surfaces + track
    out[_SHIFT, :SIZE], out[:SIZE, _SHIFT] = -track[_PLACE], -track[:, _PLACE]
    out[_SHIFT, _SHIFT] = track[_PLACE, _PLACE] + np.diag(steady)
    return out


def _against_track(covariance: FloatArray) -> FloatArray:
    """Return the covariance (SIZE, SIZE) of the pose against the track, of that with its shift."""
    change = np.eye(_SHIFT.stop)[:SIZE]
    change[_PLACE, _SHIFT] = -np.eye(3)
    return np.asarray(change @ covariance @ change.T)


def _inliers(view: PreparedView, volume: TsdfVolume, rotation: FloatArray, place_m: FloatArray, most_variance: float) -> int:
    """Return the number of depth points on a known surface from a pose."""
    unused = np.zeros((SIZE, SIZE)), np.zeros(SIZE), np.zeros((2, 3))
    seen = view.points, rotation, place_m, volume.blocks, np.zeros(3), most_variance
    return int(add_depth_equations(*seen, _DEPTH_SHARE, _WIDER[0], *unused)[1])


def _support(known: int, inliers: int) -> float:
    """Return the weight 0 to 1 of depth as a whole.

    It is little where little is known, or where much of it does not fit.
    """
    fit = inliers / max(known, 1)
    fitting = min(max((fit - _UNFIT) / (_FITTING - _UNFIT), 0.0), 1.0)
    return max(fitting**2 * min(inliers / _ENOUGH_POINTS, 1.0) ** 2, 1e-6)


def _leave_weak_directions(information: FloatArray, gradient: FloatArray, turn_sigma_rad: float) -> float:
    """Remove from the equations of depth the translations that it does not determine.

    Returns the standard deviation of the worst translation.
    Zhang, Kaess and Singh 2016, On Degeneracy of Optimization-based State Estimation Problems.
    """
    turn = information[:3, :3] + np.eye(3) * turn_sigma_rad**-2
    alone = information[3:6, 3:6] - information[3:6, :3] @ np.linalg.solve(turn, information[:3, 3:6])
    values, directions = np.linalg.eigh(0.5 * (alone + alone.T))
    left = np.maximum(values - _WEAK_SHARE * values[-1], 0.0)
    kept = np.eye(SIZE)
    kept[_PLACE, _PLACE] = directions @ np.diag(np.sqrt(left / np.maximum(values, _TINY))) @ directions.T
    information[:] = kept @ information @ kept
    gradient[:] = kept @ kept @ gradient
    return 1.0 / math.sqrt(max(float(left[0]), _TINY))


def _leave_edges(information: FloatArray, gradient: FloatArray, shown: FloatArray) -> None:
    """Remove from the equations of landmarks the translations along their edges.

    The direction of an edge in an image is known to some degrees only. shown (3, 3): of add_landmark_equations().
    """
    perfect = shown + _LEAST_SHOWN * np.eye(3)
    root = np.linalg.inv(np.linalg.cholesky(perfect))
    values, vectors = np.linalg.eigh(root @ information[_PLACE, _PLACE] @ root.T)
    along = root.T @ vectors[:, values < _EDGES_SHARE]
    if not along.size:
        return
    kept = np.eye(SIZE)
    kept[_PLACE, _PLACE] -= along @ along.T @ perfect
    information[:] = kept.T @ information @ kept
    gradient[:] = kept.T @ gradient
