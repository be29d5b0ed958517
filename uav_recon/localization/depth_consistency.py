"""Depth consistency: validity of depth frames, and drift of the pose against depth."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import TypeGuard

import numpy as np

from uav_recon.localization.depth_outliers import isolated_pixel_fraction
from uav_recon.localization.odometry_drift_rate import DriftRateEstimator
from uav_recon.localization.past_view_comparison import (
    ALIKE,
    ALIKE_LATELY,
    OVERLAPPING,
    CameraPose,
    PastViews,
    ViewComparison,
    ViewSelection,
)
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.frames import Float32Array
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
_CALM = 3  #: reject: after a rejected frame, until this many in a row fit from where it was taken
_HIDDEN_SHARE = 0.5  #: reject: a frame with something in front of more points: a person that comes near hides fewer
_ASIDE_SHARE = 0.02  #: reject: a frame of which a shift makes more points fit; valid frames after such a pause: 1.4 %
_MAX_PAUSE_S = 0.6  #: reject: a shift is looked for only against an image that is not older
_DRIFT_M = 0.15  #: land: odom has moved by more against half a minute ago: drift; valid: 0.09 m
_MANY = 100  #: land: min. points that must be compared for that
_EXPLAINED_SHARE = 0.75  #: land: min. share of points that the shift explains: a person explains fewer
_MAX_SHARE = 0.9  #: land: the same where much may have come between
_TOLD = 2  #: land: views that must show the shift: one alone can be wrong
_HIDING_SHARE = 0.22  #: land: at most this many points nearer, and few farther: something in front; else odom has moved
_FARTHER_SHARE = 0.02  #: land: more points than this farther: odom has moved, and nothing hides them
_SEEN_THROUGH_SHARE = 0.4  #: land: points of an older view that are not there: more than a person leaves behind; valid: 10 %
_RUNNING = 3  #: land: frames in a row that must show drift
_KEPT_S = 2.0  #: land: a drift that was shown holds for this time
_FROZEN_M = 0.04  #: reject: a frame equal to the last bit to one that the camera took farther away: it is frozen
_FROZEN_COS = math.cos(math.radians(1.0))  #: reject: the same, turned by more


class DepthConsistencyMonitor:
    """Rejects depth frames that are inconsistent or contradict earlier ones, and reports drift.

    Every frame is passed once with its pose: about 0.4 ms each, 1 ms with colour. warm_up() compiles the kernels.

    After a rejection, frames are rejected until (a) one fits a stored view in which a shift would be visible, or (b) three in a
    row fit from the pose of the first rejected one, where a wrong frame would be rejected again.
    """

    def __init__(self) -> None:
        self._past_views = PastViews()
        self._reset_counter = 0
        self._doubted: CameraPose | None = (
            None  # where the first of the pictures was taken that are not believed; None: they are
        )
        self._calm = self._running = 0
        self._drift_rate = DriftRateEstimator()
        self._drift: Reason | None = None
        self._drift_s = -math.inf
        self._same: tuple[Float32Array, Pose] | None = None

    def believes(self, frame: Frame, odom_from_depth: Pose, reset_counter: int) -> bool:
        """Return True if the frame may be used for mapping and flight."""
        if reset_counter != self._reset_counter:
            self._reset_counter = reset_counter
            self._past_views.forget()
            self._drift_rate.forget()
        seen = (frame.stamp_s, frame.depth_m, frame.depth_intrinsics, odom_from_depth)
        newest, others = self._past_views.compare_newest(*seen), self._past_views.compare_oldest(*seen, OVERLAPPING)
        overlapping = next(others, None)
        alone, frozen = isolated_pixel_fraction(frame.depth_m) > _ALONE_SHARE, self._frozen(frame.depth_m, odom_from_depth)
        doubted = self._doubted is not None
        asked = newest is not None and (newest.age_s <= _MAX_PAUSE_S or doubted)
        aside = asked and self._past_views.gain_aside(*seen[1:]) > _ASIDE_SHARE
        if not doubted:
            fits = _follows(newest) or _follows(overlapping)  # or something in front of it has left
        else:
            fits = any(
                _fits(then) and self._past_views.loss_aside(then, *seen[1:]) >= _MIN_SHIFT_LOSS_SHARE
                for then in (newest, overlapping)
            )
            fits |= self._is_over(_fits(newest) and not (alone or frozen or aside), odom_from_depth)
        unasked = newest is None and not (doubted and self._past_views.has_view)
        believed = not (alone or frozen or aside) and (fits or unasked)
        if not believed:
            self._doubted = self._doubted or CameraPose.of(odom_from_depth)
        else:
            self._doubted = None
            self._calm = 0
            self._drift_rate.update(frame, odom_from_depth)
            moved = (
                _moved(self._past_views.compare_oldest(*seen, ALIKE), _EXPLAINED_SHARE)
                or _moved(self._past_views.compare_oldest(*seen, ALIKE_LATELY), _EXPLAINED_SHARE)
                or _moved(itertools.chain(filter(None, [overlapping]), others), _MAX_SHARE)
            )
            self._hear(frame.stamp_s, moved or _seen_through(overlapping) or self._drift_message())
            self._past_views.remember(*seen)
        return believed

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
        for n, depth_m in enumerate((wall, wall, 2.0 * wall, wall)):
            other.believes(Frame(0.1 * n, n, depth_m, lens, colour, lens, here), here, 0)

    def _is_over(self, fits: bool, odom_from_depth: Pose) -> bool:
        """Return True if the cause of the rejection is no longer seen from where it was."""
        there = self._doubted is not None and self._doubted.like(CameraPose.of(odom_from_depth), _REJECTION_POSE)
        self._calm = self._calm + 1 if fits and there else 0
        return self._calm >= _CALM

    def _hear(self, stamp_s: float, said: Reason | None) -> None:
        self._running = self._running + 1 if said is not None else 0
        if self._running >= _RUNNING:
            self._drift = said
            self._drift_s = stamp_s

    def _drift_message(self) -> Reason | None:
        """Return the drift rate that many comparisons give together, None for nothing."""
        if self._drift_rate.excess <= 1.0:
            return None
        return Reason(ReasonCode.ODOMETRY_DRIFT, (float(np.linalg.norm(self._drift_rate.velocity_mps)),))

    def _frozen(self, depth_m: Float32Array, odom_from_depth: Pose) -> bool:
        """Return True if the camera has moved since it first gave this very image."""
        if self._same is None or not np.array_equal(self._same[0], depth_m, equal_nan=True):
            self._same = depth_m, odom_from_depth
            return False
        first = self._same[1]
        moved_m = math.dist(first.translation_m.tolist(), odom_from_depth.translation_m.tolist())
        return moved_m > _FROZEN_M or float(first.rotation()[:, 2] @ odom_from_depth.rotation()[:, 2]) < _FROZEN_COS


def _follows(then: ViewComparison | None) -> bool:
    """Return True if the frame is a plausible successor of the view.

    Something that comes into view hides what is behind it; a wrong frame also lacks surfaces that were there.
    """
    if then is None:
        return False
    return then.nearer <= _HIDDEN_SHARE and (then.nearer + then.farther <= _MISFIT_SHARE or then.farther <= _MAX_FARTHER_SHARE)


def _fits(then: ViewComparison | None) -> TypeGuard[ViewComparison]:
    """Return True if nearly all points are unchanged, of enough points to notice missing ones."""
    return then is not None and then.count >= _MANY and then.nearer + then.farther <= _REFIT_SHARE


def _moved(oldest: Iterator[ViewComparison], explained: float) -> Reason | None:
    """Return the shift of odom that the two oldest views agree on, None for nothing.

    One view alone can be wrong: where something stands in front of a wall at about the distance of a drift, all that both
    frames see may fit the shift.
    """

    def says(then: ViewComparison) -> bool:
        hidden = then.nearer <= _HIDING_SHARE and then.farther <= _FARTHER_SHARE
        sure = then.explained >= explained and then.count >= _MANY and not hidden
        return sure and float(np.linalg.norm(then.shift_m)) >= _DRIFT_M

    told = list(itertools.islice(itertools.takewhile(says, oldest), _TOLD))
    if len(told) < _TOLD:
        return None
    return Reason(ReasonCode.SURFACES_MOVED, (float(np.linalg.norm(told[0].shift_m)), told[0].age_s))


def _seen_through(then: ViewComparison | None) -> Reason | None:
    """Return a message if the camera looks through surfaces that were seen, None for nothing."""
    if then is None or then.farther < _SEEN_THROUGH_SHARE:
        return None
    return Reason(ReasonCode.SURFACES_GONE, (then.farther, then.age_s))
