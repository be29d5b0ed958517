"""Depth consistency: validity of depth frames, and drift of the pose against depth."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeGuard

import numpy as np

from uav_recon.localization.calibration.calibration_filter import CalibrationFilter
from uav_recon.localization.consistency.depth_outliers import isolated_pixel_fraction
from uav_recon.localization.consistency.odometry_drift_rate import DriftRateEstimator
from uav_recon.localization.consistency.past_view_comparison import (
    ALIKE,
    ALIKE_LATELY,
    OVERLAPPING,
    CameraPose,
    PastViews,
    ViewComparison,
    ViewSelection,
)
from uav_recon.localization.repeated_image import FROZEN_S, RepeatedImage
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.camera_calibration import CameraCalibration, CameraMotion
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_ALONE_SHARE = 0.05  #: reject: a frame with more isolated pixels; valid frames have 0.4 %
_MISFIT_SHARE = 0.20  #: reject: a frame with more misfits to the previous one, unless few are farther; valid: 7 %
_MAX_FARTHER_SHARE = 0.05  #: reject: a frame with many misfits, and more that are farther than expected; valid: 3 %
#: reject: a frame with more misfits after a rejected one: a frame that follows a wrong one may fit by chance
_REFIT_SHARE = 0.10
#: reject: after a rejected frame, one that a shift makes no worse; shifted frames: 0 %, valid: 18 % in 3 of 4
_MIN_SHIFT_LOSS_SHARE = 0.03
_REJECTION_POSE = ViewSelection(
    0.10, math.cos(math.radians(3.0))
)  # the camera pose is that of the first rejected frame, so that its cause would be seen
_MIN_RETURNS_SHARE = 0.2  #: reject: a frame with returns in fewer of its pixels; it changes nothing else
_CALM = 3  #: reject: after a rejected frame, until this many in a row fit each other and what was seen before it
_CLEARED_SHARE = 0.7  #: reject: after a rejected frame, while fewer of the points fit that it contradicted
_CLEAN_SHARE = 0.005  #: reject: after a frame that contradicts the newest view only, while a shift fits more of the one before
_BRIEF_S = 1.0  #: reject: for longer than this after a rejected frame, what follows must be confirmed by views from before it
_CLEARED_IN_VIEW_SHARE = 0.5  #: reject: the same, while fewer of these points are in view
_HIDDEN_SHARE = 0.5  #: reject: a frame with something in front of more points: a person that comes near hides fewer
_ASIDE_SHARE = 0.02  #: reject: a frame of which a shift makes more points fit; valid frames after such a pause: 1.4 %
_MAX_PAUSE_S = 0.6  #: reject: a shift is looked for only against an image that is not older
#: land: odom has moved by more against half a minute ago: drift; honest, with camera errors: 0.15 m before they are known
_DRIFT_M = 0.25
_MANY = 100  #: land: min. points that must be compared for that
_EXPLAINED_SHARE = 0.75  #: land: min. share of points that the shift explains: a person explains fewer
_MAX_SHARE = 0.9  #: land: the same where much may have come between
_APART_M = 0.10  #: land: two views that show it must be taken farther apart than this: one place alone can be wrong
_APART_COS = math.cos(math.radians(5.0))  #: land: or turned by more
_HIDING_SHARE = 0.22  #: land: at most this many points nearer, and few farther: something in front; else odom has moved
_FARTHER_SHARE = 0.02  #: land: more points than this farther: odom has moved, and nothing hides them
_SEEN_THROUGH_SHARE = 0.4  #: land: points of an older view that are not there: more than a person leaves behind; valid: 10 %
_DRIFT_FRAMES = 3  #: land: frames in a row that must show drift
_KEPT_S = 2.0  #: land: a drift that was shown holds for this time
_FROZEN_M = 0.04  #: reject: an image that has repeated for FROZEN_S, and that the camera first gave farther away: it is frozen
_FROZEN_COS = math.cos(math.radians(1.0))  #: reject: the same, turned by more
_STRIDE = 4  # a large image is sampled for its share of returns
_SAMPLED_PX = 64  #: internal: a smaller image is not sampled
Seen = tuple[float, Float32Array, Intrinsics, Pose]  # stamp (s), depth (m), its lens, pose in odom


class CorrectedDrift(NamedTuple):
    """Drift of odom that another method has found.

    motion: of the depth imager in odom as the source gives it. drift_mps (3,): of that odom, in its axes.
    """

    motion: CameraMotion
    drift_mps: FloatArray


class DepthConsistencyMonitor:
    """Rejects depth frames that are inconsistent or contradict earlier ones, and reports drift.

    Every frame is passed once with its pose: about 0.4 ms each, 1 ms with colour. warm_up() compiles the kernels.

    corrects: False if the poses come from these very frames: they contain the errors of mount and stamps already.

    A frame that is nearly empty, has isolated pixels, repeats or is frozen is rejected by itself. A frame that contradicts
    earlier views raises a doubt, because a wrong frame may be followed by one that fits by chance. The doubt ends at a frame
    that fits a stored view in which a shift would be visible, or at the third frame in a row that fits the one before it and
    the views from before the doubt, see _Doubt.
    """

    def __init__(self, corrects: bool = True) -> None:
        self._corrects = corrects
        self._past_views = PastViews()
        self._reset_counter = 0
        self._doubt: _Doubt | None = None  # None: the newest frame that could be compared was accepted
        self._drift_run = 0
        self._drift_rate = DriftRateEstimator()
        self._drift: Reason | None = None
        self._drift_s = -math.inf
        self._images = RepeatedImage()
        self._first_pose = Pose.identity()  # of the camera when it first gave the newest image

    def rejection(
        self, frame: Frame, motion: CameraMotion | None, reset_counter: int = 0, drift: CorrectedDrift | None = None
    ) -> Reason | None:
        """Return why the frame may not be used for mapping and flight, None if it may.

        Without a pose only the number of returns is checked. motion: in corrected odom. drift: what is corrected, None for
        nothing.
        """
        share = _returns_share(frame.depth_m)
        if share < _MIN_RETURNS_SHARE:
            return Reason(ReasonCode.DEPTH_FRAME_EMPTY, (share,))
        if motion is None:
            return None
        if reset_counter != self._reset_counter:
            self._reset_counter = reset_counter
            self._past_views.forget()
            self._drift_rate.forget()
            self._doubt = None
        repeats_s = self._images.repeats_s(frame.stamp_s, frame.depth_m)
        if 0.0 < repeats_s <= FROZEN_S:
            return Reason(ReasonCode.DEPTH_FRAME_REPEATS)
        fault = self._fault_in_itself(frame.depth_m, motion.odom_from_depth, repeats_s > 0.0)
        if fault is not None:
            if self._doubt is not None:
                self._doubt.interrupt()
            return fault
        return self._against_views(frame, motion, drift or CorrectedDrift(motion, np.zeros(3)))

    def _fault_in_itself(self, depth_m: Float32Array, odom_from_depth: Pose, repeats: bool) -> Reason | None:
        """Return why a frame is wrong whatever was seen before, None for nothing."""
        alone, frozen = isolated_pixel_fraction(depth_m), self._frozen(odom_from_depth, repeats)
        if alone > _ALONE_SHARE:
            return Reason(ReasonCode.DEPTH_FRAME_NOISE, (alone,))
        return Reason(ReasonCode.DEPTH_FRAME_FROZEN) if frozen else None

    def _against_views(self, frame: Frame, motion: CameraMotion, drift: CorrectedDrift) -> Reason | None:
        """Compare a frame with earlier views; remember it if it is accepted."""
        odom_from_depth = self.calibration.pose(motion)
        depth_m = self.calibration.true_depth_m(frame.depth_m)
        seen = (frame.stamp_s, depth_m, frame.depth_intrinsics, odom_from_depth)
        newest, others = self._past_views.compare_newest(*seen), self._past_views.compare_oldest(*seen, OVERLAPPING)
        overlapping = next(others, None)
        asked = newest is not None and (newest.age_s <= _MAX_PAUSE_S or self._doubt is not None)
        aside = asked and newest is not None and self._past_views.gain_aside(newest, *seen[1:]) > _ASIDE_SHARE
        fits = newest is None or _follows(newest) or _follows(overlapping)  # or something in front of it has left
        if self._doubt is not None:
            confirmed = self._past_views.compare_confirmed(*seen)
            shown = not aside and any(self._shows_no_shift(then, seen) for then in (newest, confirmed, overlapping))
            ended = self._doubt.ended_by(seen, newest, overlapping, contradicted=aside or not fits)
            if not (shown or ended or self._newest_was_wrong(seen)):
                return Reason(ReasonCode.DEPTH_FRAME_UNCONFIRMED)
        elif aside or not fits:
            contradicted = self._past_views.contradicted(*seen[1:])
            self._doubt = _Doubt(frame.stamp_s, contradicted, CameraPose.of(odom_from_depth), self._fits_confirmed(seen))
            return Reason(ReasonCode.DEPTH_FRAME_SHIFTED if aside else ReasonCode.DEPTH_FRAME_CONTRADICTS)
        self._doubt = None
        self._drift_rate.update(frame, drift.motion, drift.drift_mps)
        moved = (
            _moved(self._past_views.compare_oldest(*seen, ALIKE), _EXPLAINED_SHARE)
            or _moved(self._past_views.compare_oldest(*seen, ALIKE_LATELY), _EXPLAINED_SHARE)
            or _moved(itertools.chain(filter(None, [overlapping]), others), _MAX_SHARE)
        )
        seen_through = _seen_through(self._past_views.compare_oldest(*seen, OVERLAPPING))
        self._record_drift(frame.stamp_s, moved or seen_through or self._drift_message())
        self._past_views.remember(*seen, confirms_newest=newest is not None and not _looks_through(newest))
        return None

    def _fits_confirmed(self, seen: Seen) -> bool:
        """Return True if the frame fits the newest confirmed view, with no sign of a shift."""
        then = self._past_views.compare_confirmed(*seen)
        return _fits(then) and self._past_views.gain_aside(then, *seen[1:]) <= _CLEAN_SHARE

    def _newest_was_wrong(self, seen: Seen) -> bool:
        """Return True, and forget the newest view, if the frames since fit the newest confirmed one.

        A single wrong frame may be accepted: before a plain wall a shift does not show.
        """
        if self._doubt is None or not self._doubt.blames_newest or not self._fits_confirmed(seen):
            return False
        self._past_views.drop_newest()
        return True

    def _shows_no_shift(self, comparison: ViewComparison | None, seen: Seen) -> bool:
        """Return True if the frame fits a view that it would not fit with a shift."""
        return _fits(comparison) and self._past_views.loss_aside(comparison, *seen[1:]) >= _MIN_SHIFT_LOSS_SHARE

    def forget(self) -> None:
        """Forget all that was seen, and the newest that was learnt of the camera: odom was wrong."""
        self._past_views.forget()
        self._drift_rate.undo()
        self._doubt = None
        self._drift_run = 0

    def hold_valid(self, stamp_s: float) -> None:
        """Take odom as valid up to an instant; see DriftRateEstimator.hold_valid()."""
        self._drift_rate.hold_valid(stamp_s)

    def forget_drift(self) -> None:
        """Forget the drift that was measured: the source of the poses corrects its place."""
        self._drift_rate.forget()

    @property
    def calibration(self) -> CameraCalibration:
        """Errors of the depth imager to correct, as far as they are known."""
        return self._drift_rate.calibration.calibration() if self._corrects else CameraCalibration.none()

    @property
    def calibration_filter(self) -> CalibrationFilter:
        """The filter of the camera's errors and of the drift."""
        return self._drift_rate.calibration

    def confirms(self, drift_mps: FloatArray) -> bool:
        """Return True if depth surely shows this drift (3,) of odom, too."""
        return self._drift_rate.confirms(drift_mps)

    @property
    def at_rest(self) -> bool:
        """True if the camera has not moved for a while."""
        return self._drift_rate.at_rest

    def drift(self, now_s: float) -> Reason | None:
        """Return the drift of the pose that depth shows, None for nothing."""
        return self._drift if now_s - self._drift_s <= _KEPT_S else None

    @staticmethod
    def warm_up() -> None:
        """Compile every kernel."""
        lens = Intrinsics.from_fov(32, 24, 1.5, 1.2)
        wall = np.full((24, 32), 2.0, dtype=np.float32)
        wall.setflags(write=False)
        colour = np.zeros((2, 2, 3), dtype=np.uint8)
        other, here = DepthConsistencyMonitor(), Pose.identity()
        for n, times in enumerate((1.0, 1.0001, 2.0, 1.0, 1.0001, 1.0)):  # none repeats the one before
            depth_m = np.float32(times) * wall
            other.rejection(Frame(0.1 * n, n, depth_m, lens, colour, lens, here), CameraMotion.at_rest(here))

    def _record_drift(self, stamp_s: float, drift: Reason | None) -> None:
        self._drift_run = self._drift_run + 1 if drift is not None else 0
        if self._drift_run >= _DRIFT_FRAMES:
            self._drift = drift
            self._drift_s = stamp_s

    def _drift_message(self) -> Reason | None:
        """Return the drift rate that many comparisons give together, None for nothing."""
        if not self._drift_rate.drifts:
            return None
        return Reason(ReasonCode.ODOMETRY_DRIFT, (float(np.linalg.norm(self._drift_rate.velocity_mps)),))

    def _frozen(self, odom_from_depth: Pose, repeats: bool) -> bool:
        """Return True if the camera has moved since it first gave this very image."""
        if not repeats:
            self._first_pose = odom_from_depth
            return False
        first = self._first_pose
        moved_m = math.dist(first.translation_m.tolist(), odom_from_depth.translation_m.tolist())
        return moved_m > _FROZEN_M or float(first.rotation()[:, 2] @ odom_from_depth.rotation()[:, 2]) < _FROZEN_COS


class _Doubt:
    """The time after a frame that contradicted earlier views.

    It ends at the third frame in a row that fits the one before it, if no view from before the doubt speaks against it:
    - the newest such view is in view and fits, and the points that the first rejected frame contradicted are in view again and
      fit, or the camera stands where that frame was taken: a lasting fault would still show there; or
    - the newest such view is out of view within _BRIEF_S, and no three frames in a row contradicted what was seen: the camera
      turns fast, and the fault did not last.
    """

    def __init__(self, begun_s: float, contradicted: AnyArray, camera_pose: CameraPose, confirmed_fits: bool) -> None:
        self._confirmed_fits = confirmed_fits
        self._begun_s = begun_s
        self._contradicted_points = contradicted
        self._camera_pose = camera_pose
        self._since = PastViews()
        self._run = 0
        self._lasting = False

    @property
    def blames_newest(self) -> bool:
        """True if the newest view from before the doubt is the wrong one.

        The first rejected frame contradicted no other, and enough frames in a row follow it.
        """
        return self._confirmed_fits and self._run >= _CALM

    def interrupt(self) -> None:
        """Begin to count again after a frame that is wrong in itself."""
        self._run = 0

    def ended_by(
        self, seen: Seen, newest: ViewComparison | None, overlapping: ViewComparison | None, contradicted: bool
    ) -> bool:
        """Return True if this frame ends the doubt.

        newest, overlapping: comparisons with views from before it.
        """
        then = self._since.compare_newest(*seen)
        follows = _fits(then) and self._since.gain_aside(then, *seen[1:]) <= _ASIDE_SHARE
        self._run = self._run + 1 if follows else 1
        self._since.remember(*seen, confirms_newest=follows)
        self._lasting |= contradicted and self._run >= _CALM
        if contradicted or self._run < _CALM:
            return False
        if newest is None:
            brief = not self._lasting and seen[0] - self._begun_s <= _BRIEF_S
            return brief and (overlapping is None or _fits(overlapping))
        return _fits(newest) and (self._is_cleared(seen) or self._camera_pose.like(CameraPose.of(seen[3]), _REJECTION_POSE))

    def _is_cleared(self, seen: Seen) -> bool:
        """Return True if the points that the first rejected frame contradicted are in view and fit."""
        in_view, fitting = self._since.fit_counts(self._contradicted_points, *seen[1:])
        return in_view >= _CLEARED_IN_VIEW_SHARE * len(self._contradicted_points) and fitting >= _CLEARED_SHARE * in_view


def _returns_share(depth_m: Float32Array) -> float:
    """Return the share of pixels with a return, from every fourth row and column."""
    stride = _STRIDE if min(depth_m.shape) >= _SAMPLED_PX else 1
    sample = depth_m[::stride, ::stride]
    return float(np.count_nonzero(sample > 0.0)) / sample.size


def _follows(comparison: ViewComparison | None) -> bool:
    """Return True if the frame is a plausible successor of the view.

    Something that comes into view hides what is behind it; a wrong frame also lacks surfaces that were there.
    """
    if comparison is None:
        return False
    return comparison.nearer <= _HIDDEN_SHARE and (
        comparison.nearer + comparison.farther <= _MISFIT_SHARE or comparison.farther <= _MAX_FARTHER_SHARE
    )


def _looks_through(comparison: ViewComparison) -> bool:
    """Return True if surfaces of the view are not there.

    It showed something that was not there, or that has left.
    """
    return comparison.farther > _MAX_FARTHER_SHARE or comparison.nearer > _HIDDEN_SHARE


def _fits(comparison: ViewComparison | None) -> TypeGuard[ViewComparison]:
    """Return True if nearly all points are unchanged, of enough points to notice missing ones."""
    return comparison is not None and comparison.count >= _MANY and comparison.nearer + comparison.farther <= _REFIT_SHARE


def _moved(oldest: Iterator[ViewComparison], explained: float) -> Reason | None:
    """Return the shift of odom that the oldest views agree on, None for nothing.

    One view alone can be wrong: where something stands in front of a wall at about the distance of a drift, all that both
    frames see may fit the shift.
    """

    def shows_shift(comparison: ViewComparison) -> bool:
        hidden = comparison.nearer <= _HIDING_SHARE and comparison.farther <= _FARTHER_SHARE
        sure = comparison.explained >= explained and comparison.count >= _MANY and not hidden
        return sure and float(np.linalg.norm(comparison.shift_m)) >= _DRIFT_M

    shown = _shown_twice(oldest, shows_shift)
    if shown is None:
        return None
    return Reason(ReasonCode.SURFACES_MOVED, (float(np.linalg.norm(shown.shift_m)), shown.age_s))


def _seen_through(oldest: Iterator[ViewComparison]) -> Reason | None:
    """Return a message if the camera looks through what the oldest views show, else None."""
    shown = _shown_twice(oldest, lambda comparison: comparison.farther >= _SEEN_THROUGH_SHARE)
    return None if shown is None else Reason(ReasonCode.SURFACES_GONE, (shown.farther, shown.age_s))


def _shown_twice(oldest: Iterator[ViewComparison], shows: Callable[[ViewComparison], bool]) -> ViewComparison | None:
    """Return the oldest view if views from two places show the same, None if not.

    They may also be taken in two directions, and so must all views between them. Kept views are half a second apart at least,
    so these two are from two times as well.
    """
    first: ViewComparison | None = None
    for comparison in itertools.takewhile(shows, oldest):
        first = first or comparison
        if not comparison.camera_pose.like(first.camera_pose, ViewSelection(_APART_M, _APART_COS)):
            return first
    return None
