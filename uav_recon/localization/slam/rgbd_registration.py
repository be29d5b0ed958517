"""Registration of an RGB-D frame: Gauss-Newton on depth, landmarks and motion together.

Prediction and new keyframes are where the track has brought them, and share its error. Keyframes from before may be known
better. So the error of the track is one of the unknowns: a shift of prediction and new keyframes together. Its variance is that
by which the track is less certain than the keyframes from before that the view shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.localization.slam.depth_points import add_depth_equations
from uav_recon.localization.slam.keyframe_map import KeyframeMap, Keyframes
from uav_recon.localization.slam.landmarks import SIZE, Landmarks, MovingImager, add_landmark_equations
from uav_recon.localization.slam.pose_graph import Measured
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.pose import Pose

_ROUNDS = 10
_FAR_ROUNDS = 8  # before them, from a far start
_STEP_M = 0.12  # between the starts of a search along an axis
_MOST_STEPS = (5, 2, 2)  # to each side, of a search along one, two or three axes
_SEARCH_STARTS = 4  # of a search, those that fit best
_APART_M = 0.1  # between places that are not the same
_STILL_M = 2e-4
_STILL_RAD = 1e-4
_WIDER = (4.0, 2.0, 1.0)  # scale of the robust weights in the first rounds: a far start must be pulled, too
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
# a keyframe with less than this share of the variance of the track, less this, is from before
_BEFORE_SHARE = 0.5
_ALIKE_M2 = 0.01**2
_UNSHIFTED_M2 = 1e-4**2  # variance of a track that is as certain as the surfaces
_DETERMINED_M = 0.02  # standard deviation of a place that depth alone determines
_DETERMINED_FIT_SHARE = 0.85  # of its points in known space, those on a known surface
_CONFIRMING_LANDMARKS = 20  # number of landmarks that must fit at a place that was recognised
_DETERMINED_POINTS = 250  # number of its points on known surfaces
_LEAST_INFORMATION = 1.0  # a keyframe says nothing of a direction with less
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
    not determine it. match: sum of the weights of depth, larger for a better fit. measured: what each keyframe alone says.
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
    measured: Measured

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

    def confirmed(self, followed: int) -> bool:
        """Return True if landmarks and depth both show the place. followed: number of landmarks."""
        seen = self.landmarks >= max(_CONFIRMING_LANDMARKS, _AGREEING_SHARE * followed)
        return seen and self.fit >= _DETERMINED_FIT_SHARE and self.inliers >= _DETERMINED_POINTS

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
    view: PreparedView, surfaces: KeyframeMap, prior: MotionPrior, reach_m: FloatArray, most_variance: float = math.inf
) -> tuple[Registration, float]:
    """Return the pose at which depth alone fits the map best, and the share of the next best.

    It looks near the predicted pose. The share is that of the match of the best pose elsewhere. reach_m (3,): of the search
    along each axis of odom. most_variance: of the surfaces that count, m². From a far start most points lie off their surfaces:
    this says nothing against depth there. About 20 ms.
    """
    place_m, rotation = prior.odom_from_depth.translation_m, prior.odom_from_depth.rotation()
    shifts_m = _shifts_m(reach_m)
    keyframes = surfaces.near(view.depth, prior.odom_from_depth, float(reach_m.max()), most_variance)
    fitting = np.array([_inliers(view, keyframes, rotation, place_m + shift_m) for shift_m in shifts_m])
    starts: list[FloatArray] = []
    for number in np.argsort(-fitting, kind="stable"):
        if all(np.linalg.norm(shifts_m[number] - start_m) > _APART_M for start_m in starts):
            starts.append(shifts_m[number])
        if len(starts) == _SEARCH_STARTS:
            break
    ends = [_converge(view, keyframes, Landmarks.none(), prior, start_m) for start_m in starts]
    best = max(ends, key=lambda end: end.match)
    there_m = best.odom_from_depth.translation_m
    others = [end.match for end in ends if np.linalg.norm(end.odom_from_depth.translation_m - there_m) > _APART_M]
    return best, max(others, default=0.0) / max(best.match, _TINY)


def confirm(
    view: PreparedView, keyframes: Keyframes, landmarks: Landmarks, prior: MotionPrior, place_m: FloatArray
) -> Registration | None:
    """Return the registration of a view from another place (3,) than the predicted one, None if it is not that place.

    Landmarks and depth must both fit there.
    """
    found = _converge(view, keyframes, landmarks, prior, place_m - prior.odom_from_depth.translation_m)
    return found if found.confirmed(len(landmarks.place_m)) else None


def _shifts_m(reach_m: FloatArray) -> FloatArray:
    """Return the shifts (N, 3) of the starts of a search."""
    steps = np.ceil(reach_m / _STEP_M - 0.5).clip(0).astype(int)
    steps = np.minimum(steps, _MOST_STEPS[max(int(np.count_nonzero(steps)) - 1, 0)])
    ends = zip(reach_m.tolist(), steps.tolist(), strict=True)
    axes = [np.linspace(-reach, reach, 2 * number + 1) if number else np.zeros(1) for reach, number in ends]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def register(view: PreparedView, keyframes: Keyframes, landmarks: Landmarks, prior: MotionPrior) -> Registration:
    """Return the pose at which the frame fits the map, from the predicted one on. About 2 ms.

    Landmarks of which too few agree are those of a view without texture, and left out.
    """
    found = _converge(view, keyframes, landmarks, prior)
    followed = len(landmarks.place_m)
    if followed and found.landmarks < max(_FEWEST_LANDMARKS, _AGREEING_SHARE * followed):
        return _converge(view, keyframes, Landmarks.none(), prior)
    return found


@dataclass(slots=True, eq=False)
class _Estimate:
    """Pose of a frame during Gauss-Newton.

    rotation (3, 3), place_m (3,): in odom. turned_rad (3,), moved_m (3,): against the predicted pose. slow (2,). shifted_m
    (3,): of the track.
    """

    rotation: FloatArray
    place_m: FloatArray
    turned_rad: FloatArray
    moved_m: FloatArray
    slow: FloatArray
    shifted_m: FloatArray

    def step(self, step: FloatArray) -> bool:
        """Take a step (SIZE + 3,). Return True if the pose has hardly moved."""
        self.rotation = Pose.from_rotation_vector(step[:3], np.zeros(3)).rotation() @ self.rotation
        self.place_m = self.place_m + step[_PLACE]
        self.turned_rad, self.moved_m = self.turned_rad + step[:3], self.moved_m + step[_PLACE]
        self.slow, self.shifted_m = self.slow + step[6:SIZE], self.shifted_m + step[_SHIFT]
        return math.hypot(*step[_PLACE].tolist()) < _STILL_M and math.hypot(*step[:3].tolist()) < _STILL_RAD

    def pose(self) -> Pose:
        """Return odom_from_depth."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.place_m
        return Pose.from_matrix(matrix)


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations of a frame against M keyframes.

    information (M, SIZE, SIZE), gradient (M, SIZE). shown (M, 3): information on the place, along each axis. known, inliers,
    fitting, depth_sigma_m, match: as in Registration.
    """

    information: FloatArray
    gradient: FloatArray
    shown: FloatArray
    known: int
    inliers: int
    fitting: int
    depth_sigma_m: float
    match: float


def _converge(
    view: PreparedView,
    keyframes: Keyframes,
    landmarks: Landmarks,
    prior: MotionPrior,
    shift_m: FloatArray | None = None,
) -> Registration:
    """Run Gauss-Newton from the predicted pose.

    shift_m (3,): from a place farther by this instead; depth counts at first even where it does not fit.
    """
    far, moved_m = shift_m is not None, np.zeros(3) if shift_m is None else shift_m
    at = _Estimate(
        prior.odom_from_depth.rotation(), prior.odom_from_depth.translation_m + moved_m, np.zeros(3), moved_m,
        prior.slow.copy(), np.zeros(3),
    )  # fmt: skip
    predicted = np.asarray(np.linalg.inv(prior.covariance), dtype=np.float64)
    of_track = _of_track(keyframes, prior)
    track = before = prior.track_variance
    whole = np.eye(_SHIFT.stop)
    rounds = _ROUNDS + _FAR_ROUNDS if far else _ROUNDS
    for number in range(rounds):
        near = number - (rounds - _ROUNDS)  # rounds near the pose
        wide = _WIDER[min(max(near, 0), len(_WIDER) - 1)]
        equations = _equations(view, keyframes, landmarks, prior, at, of_track, track, wide, all_counts=far and near < 0)
        shown = of_track[:, None] * equations.shown
        track = _mean(prior.track_variance, np.diagonal(predicted)[_PLACE], keyframes.variance, shown)
        before = _mean(track, _NO_SURFACE, keyframes.variance, equations.shown - shown)
        steady = np.asarray(1.0 / (np.maximum(track - before, 0.0) + _UNSHIFTED_M2), dtype=np.float64)
        whole, pull = _with_prediction(equations, of_track, predicted, prior, at, steady)
        still = at.step(np.asarray(np.linalg.solve(whole, pull), dtype=np.float64))
        if still and near >= len(_WIDER) - 1:
            break
    covariance = np.asarray(np.linalg.inv(whole), dtype=np.float64)
    left = np.minimum(track, before) + np.diagonal(covariance)[_SHIFT]
    covariance = _against_track(covariance)
    return Registration(
        at.pose(), covariance[_POSE, _POSE], at.shifted_m, left, len(view.points), equations.known, equations.inliers,
        equations.fitting, at.slow, covariance[6:, 6:], equations.depth_sigma_m, equations.match,
        _measured(keyframes, of_track, equations),
    )  # fmt: skip


def _equations(
    view: PreparedView,
    keyframes: Keyframes,
    landmarks: Landmarks,
    prior: MotionPrior,
    at: _Estimate,
    of_track: IntArray,
    track: FloatArray,
    wide: float,
    *,
    all_counts: bool,
) -> _Equations:
    """Return the equations of depth and landmarks at an estimate.

    of_track (M,): of _of_track(). track (3,): variance of the track. wide: factor on the scale of the robust weights.
    all_counts: depth counts in full wherever it is.
    """
    most = len(keyframes.number)
    surfaces, slope, shown = np.zeros((most, SIZE, SIZE)), np.zeros((most, SIZE)), np.zeros((most, 3))
    moved = keyframes._replace(place_m=keyframes.place_m + of_track[:, None] * at.shifted_m)
    known, inliers = add_depth_equations(
        view.points, at.rotation, at.place_m, moved, track, _DEPTH_SHARE, wide, surfaces, slope, shown
    )
    match = float(np.trace(surfaces.sum(axis=0)[_PLACE, _PLACE]))
    support = 1.0 if all_counts else _support(known, inliers)
    surfaces, slope = support * surfaces, support * slope
    depth_sigma_m = _leave_weak_directions(surfaces, slope, prior.turn_sigma_rad)
    corners, pull, perfect = np.zeros((most, SIZE, SIZE)), np.zeros((most, SIZE)), np.zeros((3, 3))
    imager = MovingImager(
        camera=view.camera, rotation=at.rotation @ view.depth_from_rgb.rotation(),
        eye_m=at.rotation @ view.depth_from_rgb.translation_m + at.place_m, turn_m=at.place_m,
        motion=np.concatenate((prior.rate_radps, prior.velocity_mps)), slow=at.slow,
    )  # fmt: skip
    fitting = add_landmark_equations(
        landmarks.place_m + of_track[landmarks.keyframe, None] * at.shifted_m, landmarks.slope, landmarks.texture,
        landmarks.at_px, imager, landmarks.keyframe, at.slow - prior.slow, landmarks.share, wide, corners, pull, perfect,
    )  # fmt: skip
    _leave_edges(corners, pull, perfect)
    along = support * shown + np.diagonal(corners, axis1=1, axis2=2)[:, _PLACE]
    return _Equations(surfaces + corners, slope + pull, along, known, inliers, fitting, depth_sigma_m, match)


def _with_prediction(
    equations: _Equations, of_track: IntArray, predicted: FloatArray, prior: MotionPrior, at: _Estimate, steady: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return information (SIZE + 3, SIZE + 3) and gradient (SIZE + 3,) of pose, slow parameters and shift.

    predicted (6, 6): information of the prediction. steady (3,): of the track on its own shift.
    """
    is_track = of_track == 1
    track, pull = equations.information[is_track].sum(axis=0), equations.gradient[is_track].sum(axis=0)
    slow = np.linalg.inv(prior.slow_covariance)
    track[_POSE, _POSE] += predicted
    track[6:, 6:] += slow
    pull[_POSE] -= predicted @ np.concatenate((at.turned_rad, at.moved_m - at.shifted_m))
    pull[6:] -= slow @ (at.slow - prior.slow)
    whole = _with_shift(equations.information[~is_track].sum(axis=0), track, steady)
    both = equations.gradient[~is_track].sum(axis=0) + pull
    return whole, np.concatenate((both, -pull[_PLACE] - steady * at.shifted_m))


def _of_track(keyframes: Keyframes, prior: MotionPrior) -> IntArray:
    """Return 1 for keyframes (M,) that share the error of the track, 0 for those that are known better."""
    least = _BEFORE_SHARE * float(prior.track_variance.max()) - _ALIKE_M2
    return np.asarray(keyframes.variance.max(axis=1, initial=0.0) >= least, dtype=np.int64)


def _measured(keyframes: Keyframes, of_track: IntArray, equations: _Equations) -> Measured:
    """Return what each keyframe alone says."""
    pose = equations.information[:, _POSE, _POSE]
    step = np.linalg.solve(pose + _LEAST_INFORMATION * np.eye(6), equations.gradient[:, _POSE, None])[..., 0]
    return Measured(keyframes.number, pose, np.asarray(step, dtype=np.float64), of_track == 0)


def _mean(variance: FloatArray, weight: FloatArray | float, others: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the weighted mean (3,) of a variance (3,) and those of keyframes (M, 3)."""
    whole = weight + weights.sum(axis=0)
    return np.asarray((variance * weight + (others * weights).sum(axis=0)) / whole)


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


def _inliers(view: PreparedView, keyframes: Keyframes, rotation: FloatArray, place_m: FloatArray) -> int:
    """Return the number of depth points on a known surface from a pose."""
    most = len(keyframes.number)
    unused = np.zeros((most, SIZE, SIZE)), np.zeros((most, SIZE)), np.zeros((most, 3))
    seen = view.points, rotation, place_m, keyframes, np.zeros(3)
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
    both = information.sum(axis=0)
    turn = both[:3, :3] + np.eye(3) * turn_sigma_rad**-2
    alone = both[3:6, 3:6] - both[3:6, :3] @ np.linalg.solve(turn, both[:3, 3:6])
    values, directions = np.linalg.eigh(0.5 * (alone + alone.T))
    left = np.maximum(values - _WEAK_SHARE * values[-1], 0.0)
    kept = np.eye(SIZE)
    kept[_PLACE, _PLACE] = directions @ np.diag(np.sqrt(left / np.maximum(values, _TINY))) @ directions.T
    information[:] = kept @ information @ kept
    gradient[:] = gradient @ kept @ kept
    return 1.0 / math.sqrt(max(float(left[0]), _TINY))


def _leave_edges(information: FloatArray, gradient: FloatArray, shown: FloatArray) -> None:
    """Remove from the equations of landmarks the translations along their edges.

    The direction of an edge in an image is known to some degrees only. shown (3, 3): of add_landmark_equations().
    """
    perfect = shown + _LEAST_SHOWN * np.eye(3)
    root = np.linalg.inv(np.linalg.cholesky(perfect))
    values, vectors = np.linalg.eigh(root @ information.sum(axis=0)[_PLACE, _PLACE] @ root.T)
    along = root.T @ vectors[:, values < _EDGES_SHARE]
    if not along.size:
        return
    kept = np.eye(SIZE)
    kept[_PLACE, _PLACE] -= along @ along.T @ perfect
    information[:] = kept.T @ information @ kept
    gradient[:] = gradient @ kept
