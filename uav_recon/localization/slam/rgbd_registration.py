"""Registration of an RGB-D frame: Gauss-Newton on depth, landmarks and motion together.

The places of the keyframes that the frame is compared with are unknowns as the frame's own: all have errors, which are
correlated. Their joint covariance says what a keyframe tells: one that was just taken has the error of the track, and one from
before corrects it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.localization.slam.depth_points import add_depth_equations
from uav_recon.localization.slam.frame_equations import (
    DEPTH_SHARE,
    ComparedFrame,
    Equations,
    PoseEstimate,
    Predicted,
    converge,
    determined_share,
)
from uav_recon.localization.slam.keyframe_map import KeyframeMap, Keyframes
from uav_recon.localization.slam.landmarks import SIZE, Landmarks
from uav_recon.localization.slam.place_errors import PlaceErrors, worst_variances
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.localization.slam.weak_directions import TRIED_SCALE
from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.pose import Pose

_STEP_M = 0.12  # between the starts of a search along an axis
_MOST_STEPS = (5, 2, 2)  # to each side, of a search along one, two or three axes
_SEARCH_STARTS = 4  # of a search, those that fit best
_APART_M = 0.1  # between places that are not the same
_FEWEST_LANDMARKS = 6
_AGREEING_SHARE = 0.5
_POSE = slice(0, 6)
# error of the mean normal of a wall, and of the direction of an edge in the image: if the way along them is uncertain by 0.1 m,
# a keyframe shows the distance to them to 5 mm
_NORMAL_RAD = 0.05
_PLACE = slice(3, 6)
_LAG = slice(3, 6)  # of the joint covariance of places
_UNCERTAIN_M = 0.08  # standard deviation of a way to a keyframe from which registration may end at a wrong place
_CERTAIN_M = 0.025  # the same along the normal of a surface that counts all the same: the wall is the same wherever on it
_LEAST_M2 = 1e-5**2  # variance of a place that is known exactly
_DETERMINED_M = 0.02  # standard deviation of a place that depth alone determines
_DETERMINED_FIT_SHARE = 0.85  # of its points in known space, those on a known surface
_CONFIRMING_LANDMARKS = 20  # number of landmarks that must fit at a place that was recognised
_DETERMINED_POINTS = 250  # number of its points on known surfaces
_TINY = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class MotionPrior:
    """The predicted pose of the depth imager, and how well it is known.

    attitude_covariance (3, 3): of a rotation in odom axes about the camera. places: joint covariance of the place of the body
    with those of the keyframes. turn_sigma_rad: of the turn since the newest frame, per axis. rate_radps (3,), velocity_mps
    (3,): of the camera in odom. slow (2,): delay and width of the colour image (landmarks.DELAY, WIDTH); slow_covariance (2,
    2).
    """

    odom_from_depth: Pose
    attitude_covariance: FloatArray
    places: PlaceErrors
    turn_sigma_rad: float
    rate_radps: FloatArray
    velocity_mps: FloatArray
    slow: FloatArray
    slow_covariance: FloatArray

    @property
    def variance(self) -> FloatArray:
        """Variance (3,) of the place, m² along the axes of odom."""
        return np.asarray(np.diagonal(self.places.state)[:3])

    @property
    def step_covariance(self) -> FloatArray:
        """Covariance (3, 3) of the place against that one or two seconds before."""
        return self.places.against_lag()[:3, :3]


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The pose of a frame, and what supports it.

    keyframes: that it was compared with. covariance (6, 6): of a rotation in odom axes about the camera, and of its place.
    moved_m (6 + 3 M,), joint (6 + 3 M, 6 + 3 M): correction and covariance of the places of PlaceErrors.joint(). against_track
    (3, 3): covariance of the place against the keyframe, or the place lately, against which it is known best. determined_share
    (3, 3): share of the place that the frame has determined and not the prediction. points, known, inliers: depth points, those
    in known space, those on a known surface. fitting (M,): number of landmarks of each keyframe that fit. slow,
    slow_covariance: as in MotionPrior, after this frame. depth_sigma_m: of the place by depth alone, in its worst direction;
    infinite where depth does not determine it. match: sum of the weights of depth, larger for a better fit.
    """

    odom_from_depth: Pose
    keyframes: Keyframes
    covariance: FloatArray
    moved_m: FloatArray
    joint: FloatArray
    against_track: FloatArray
    determined_share: FloatArray
    points: int
    known: int
    inliers: int
    fitting: IntArray
    slow: FloatArray
    slow_covariance: FloatArray
    depth_sigma_m: float
    match: float

    @property
    def landmarks(self) -> int:
        """Number of landmarks that fit."""
        return int(self.fitting.sum())

    @property
    def shift_m(self) -> FloatArray:
        """Found error (3,) of the track: by what the place one or two seconds before is corrected."""
        return self.moved_m[_LAG]

    @property
    def variance(self) -> FloatArray:
        """Variance (3,) of the place, m² along the axes of odom."""
        return np.asarray(np.diagonal(self.covariance)[_PLACE])

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the place in its worst direction."""
        return _worst_m(self.covariance[_PLACE, _PLACE])

    @property
    def sigma_against_track_m(self) -> float:
        """Standard deviation of the place against the track, in its worst direction."""
        return _worst_m(self.against_track)

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

    def confirmed(self, followed: Landmarks, of: BoolArray) -> bool:
        """Return True if depth and the landmarks of some keyframes both show the place.

        of (M,): which keyframes.
        followed: the landmarks that the registration was given.
        """
        most = np.count_nonzero(of[followed.keyframe])
        seen = int(self.fitting[of].sum()) >= max(_CONFIRMING_LANDMARKS, _AGREEING_SHARE * most)
        return seen and self.fit >= _DETERMINED_FIT_SHARE and self.inliers >= _DETERMINED_POINTS

    @property
    def quality(self) -> int:
        """Quality 1 to 100 of an accepted frame."""
        support = min(1.0, self.known / 400.0) * self.fit + min(1.0, self.landmarks / 60.0)
        return int(np.clip(round(100.0 * min(1.0, support)), 1, 100))

    def surprise(self, prior: MotionPrior) -> float:
        """Return the squared innovation of the place against the track, in standard deviations."""
        moved_m = self.moved_m[:3] - self.shift_m
        return float(moved_m @ np.linalg.solve(prior.step_covariance, moved_m))


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
    """Return the registration of a view from another place (3,) than the predicted one.

    None if it is not that place.
    Depth, and the landmarks of the keyframes to which the way was uncertain, must both fit there.
    """
    found = _converge(view, keyframes, landmarks, prior, place_m - prior.odom_from_depth.translation_m)
    return found if found.confirmed(landmarks, uncertain(keyframes, prior)) else None


def _shifts_m(reach_m: FloatArray) -> FloatArray:
    """Return the shifts (N, 3) of the starts of a search."""
    steps = np.ceil(reach_m / _STEP_M - 0.5).clip(0).astype(int)
    steps = np.minimum(steps, _MOST_STEPS[max(int(np.count_nonzero(steps)) - 1, 0)])
    ends = zip(reach_m.tolist(), steps.tolist(), strict=True)
    axes = [np.linspace(-reach, reach, 2 * number + 1) if number else np.zeros(1) for reach, number in ends]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def register(
    view: PreparedView, keyframes: Keyframes, landmarks: Landmarks, prior: MotionPrior, *, doubted: bool = False
) -> Registration:
    """Return the pose at which the frame fits the map, from the predicted one on. About 2 ms.

    Landmarks of which too few agree are those of a view without texture, and left out. doubted: surfaces of a keyframe do not
    count where they face a direction in which the way to it is too uncertain, nor do its landmarks: registration may end at a
    wrong place there.
    """
    doubt = np.zeros((len(keyframes.number), 3, 3))
    if doubted:
        doubt = _ways(prior.places.joint(keyframes.number)) / _CERTAIN_M**2
        landmarks = landmarks.of(~uncertain(keyframes, prior))
    found = _converge(view, keyframes, landmarks, prior, doubt=doubt)
    agree = _agree(found, landmarks)
    if not agree.all():
        landmarks = landmarks.of(agree)
        found = _converge(view, keyframes, landmarks, prior, doubt=doubt)
    followed = len(landmarks.place_m)
    if followed and found.landmarks < max(_FEWEST_LANDMARKS, _AGREEING_SHARE * followed):
        return _converge(view, keyframes, Landmarks.none(), prior, doubt=doubt)
    return found


def _agree(registration: Registration, followed: Landmarks) -> BoolArray:
    """Return the keyframes (M,) of which enough landmarks fit: a few of many fit anywhere."""
    most = np.bincount(followed.keyframe, minlength=len(registration.fitting))
    return np.asarray(registration.fitting >= _AGREEING_SHARE * most)


def uncertain(keyframes: Keyframes, prior: MotionPrior) -> BoolArray:
    """Return which keyframes (M,) register() may fit at a wrong place.

    The way to them is too uncertain.
    """
    return np.asarray(worst_variances(prior.places.joint(keyframes.number))[1:] > _UNCERTAIN_M**2)


def _ways(joint: FloatArray) -> FloatArray:
    """Return the covariances (M, 3, 3) of the ways to keyframes. joint: of the places."""
    ways = [_way(joint, first) for first in range(6, len(joint), 3)]
    return np.array(ways).reshape(-1, 3, 3)


def _way(joint: FloatArray, first: int) -> FloatArray:
    """Return the covariance (3, 3) of the place against another of the joint places.

    first: element at which the other one begins.
    """
    other = slice(first, first + 3)
    return np.asarray(joint[:3, :3] - joint[:3, other] - joint[other, :3] + joint[other, other])


def _converge(
    view: PreparedView,
    keyframes: Keyframes,
    landmarks: Landmarks,
    prior: MotionPrior,
    shift_m: FloatArray | None = None,
    doubt: FloatArray | None = None,
) -> Registration:
    """Run Gauss-Newton from the predicted pose.

    shift_m (3,): from a place farther by this instead; depth counts at first even where it does not fit. doubt (M, 3, 3):
    as in add_depth_equations().
    """
    joint = prior.places.joint(keyframes.number)
    leaning = np.asarray(_NORMAL_RAD**2 * worst_variances(joint)[1:], dtype=np.float64)
    compared = ComparedFrame(
        view.points, view.camera, view.depth_from_rgb.rotation(),
        view.depth_from_rgb.translation_m,
        np.concatenate((prior.rate_radps, prior.velocity_mps)), keyframes, landmarks,
        np.zeros((len(keyframes.number), 3, 3)) if doubt is None else doubt, leaning, landmarks.share, prior.turn_sigma_rad,
    )  # fmt: skip
    moved_m = np.concatenate((np.zeros(3) if shift_m is None else shift_m, np.zeros(len(joint) - 3)))
    place_m = prior.odom_from_depth.translation_m + moved_m[:3]
    at = PoseEstimate(prior.odom_from_depth.rotation(), place_m, np.zeros(3), prior.slow.copy(), moved_m)
    predicted = _predicted(prior, joint)
    equations, whole = Equations.empty(len(keyframes.number)), np.empty((SIZE + len(joint) - 3,) * 2)
    known, inliers, depth_sigma_m, match = converge(compared, predicted, at, equations, whole, shift_m is not None)
    covariance = np.asarray(np.linalg.inv(whole), dtype=np.float64)
    elements = np.concatenate((np.arange(3, 6), np.arange(SIZE, len(whole))))  # the joint places among the unknowns
    found = covariance[np.ix_(elements, elements)]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = at.rotation, at.place_m
    return Registration(
        Pose.from_matrix(pose), keyframes, covariance[_POSE, _POSE], moved_m, found,
        _against_track(found, keyframes, prior.places), determined_share(equations, predicted), len(view.points), known,
        inliers, equations.fitting, at.slow, covariance[6:SIZE, 6:SIZE], depth_sigma_m, match,
    )  # fmt: skip


def _predicted(prior: MotionPrior, joint: FloatArray) -> Predicted:
    """Return the information of the prediction. joint (6 + 3 M, 6 + 3 M): of the places."""
    covariances = prior.attitude_covariance, prior.slow_covariance, joint + _LEAST_M2 * np.eye(len(joint))
    attitude, slow, places = (np.asarray(np.linalg.inv(covariance), dtype=np.float64) for covariance in covariances)
    return Predicted(attitude, slow, places, prior.slow)


def _against_track(joint: FloatArray, keyframes: Keyframes, places: PlaceErrors) -> FloatArray:
    """Return the covariance (3, 3) of the place against that of which it is known best.

    The place lately, and the keyframes that are older than this: a newer one has the same error.
    """
    older = np.concatenate(([True], keyframes.number < places.before))
    return _way(joint, 3 + 3 * int(np.argmin(np.where(older, worst_variances(joint), np.inf))))


def _worst_m(covariance: FloatArray) -> float:
    """Return the standard deviation in the worst direction."""
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))


def _inliers(view: PreparedView, keyframes: Keyframes, rotation: FloatArray, place_m: FloatArray) -> int:
    """Return the number of depth points on a known surface from a pose."""
    most = len(keyframes.number)
    unused, none = (np.zeros((most, SIZE, SIZE)), np.zeros((most, SIZE))), np.zeros((most, 3, 3))
    return int(add_depth_equations(view.points, rotation, place_m, keyframes, none, DEPTH_SHARE, TRIED_SCALE, *unused)[1])
