"""Whether a depth picture is to be believed, and whether depth says that the pose has drifted."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import TypeGuard

import numpy as np

from uav_recon.localization.depth_outliers import isolated_pixel_fraction
from uav_recon.localization.drift_rate import DriftRateEstimator
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

_ALONE = 0.05  # of the pixels; honest pictures have 0.004
_MISFIT, _SOME = 0.20, 0.05  # of the points of the picture before, and of those that are not there; honest: 0.07 and 0.03
_REFIT = 0.10  # of the points misfit after a picture that was not believed: what follows a wrong one may follow by chance
_TELLING = 0.03  # of the points more would misfit aside; shifted pictures that fit: 0.000; honest: 0.18 in three of four
_THERE = ViewSelection(
    0.10, math.cos(math.radians(3.0))
)  # the camera stands as it did at the first doubt, and sees what made it
_CALM = 3  # pictures in a row that fit there
_HIDDEN = 0.5  # of the points have something before them: a person that comes near hides fewer
_ASIDE, _MOMENT_S = 0.02, 0.6  # of the points, gained by reading them aside; honest, after so long a pause: 0.014
_DRIFT_M = 0.15  # odom's shift against half a minute ago; honest: 0.09 m
_MANY, _EXPLAINED = 100, 0.75  # points there are, and the share of them that it explains: a person explains fewer
_MAX = 0.9  # the same where much may have come between
_TOLD = 2  # views that say it
_HIDING = 0.22  # of the points, all nearer, have something before them; more, or some that are farther, and odom has moved
_FARTHER = 0.02
_SEEN_THROUGH = 0.4  # of the points of an older picture are not there: more than a person leaves behind; honest: 0.10
_RUNNING = 3  # pictures in a row that say so
_KEPT_S = 2.0  # what was said holds for so long
_FROZEN_M, _FROZEN_COS = 0.04, math.cos(math.radians(1.0))  # the camera moved so, and its picture is the same to the bit


class DepthConsistencyMonitor:
    """Hears every picture once, with the pose that goes with it: about 0.4 ms each, 1 ms in colour. warm_up() compiles
    its kernels.

    A picture that fits neither itself nor what was seen before is not believed, and none after it is before one fits
    a view that is remembered and that would tell of a shift, or some fit from where the first one did not: a wrong one would
    go on to be told there.
    """

    def __init__(self) -> None:
        self._witness = PastViews()
        self._reset_counter = 0
        self._doubted: CameraPose | None = (
            None  # where the first of the pictures was taken that are not believed; None: they are
        )
        self._calm = self._running = 0
        self._creep = DriftRateEstimator()
        self._drift: Reason | None = None
        self._drift_s = -math.inf
        self._same: tuple[Float32Array, Pose] | None = None

    def believes(self, frame: Frame, odom_from_depth: Pose, reset_counter: int) -> bool:
        """Whether the picture may be mapped and flown by."""
        if reset_counter != self._reset_counter:
            self._reset_counter = reset_counter
            self._witness.forget()
            self._creep.forget()
        seen = (frame.stamp_s, frame.depth_m, frame.depth_intrinsics, odom_from_depth)
        newest, others = self._witness.of_newest(*seen), self._witness.of_oldest(*seen, OVERLAPPING)
        overlapping = next(others, None)
        alone, frozen = isolated_pixel_fraction(frame.depth_m) > _ALONE, self._frozen(frame.depth_m, odom_from_depth)
        doubted = self._doubted is not None
        asked = newest is not None and (newest.age_s <= _MOMENT_S or doubted)
        aside = asked and self._witness.gain_aside(*seen[1:]) > _ASIDE
        if not doubted:
            fits = _follows(newest) or _follows(overlapping)  # what stood before it has gone
        else:
            fits = any(_fits(then) and self._witness.loss_aside(then, *seen[1:]) >= _TELLING for then in (newest, overlapping))
            fits |= self._is_over(_fits(newest) and not (alone or frozen or aside), odom_from_depth)
        unasked = newest is None and not (doubted and self._witness.remembers)
        believed = not (alone or frozen or aside) and (fits or unasked)
        if not believed:
            self._doubted = self._doubted or CameraPose.of(odom_from_depth)
        else:
            self._doubted, self._calm = None, 0
            self._creep.update(frame, odom_from_depth)
            moved = (
                _moved(self._witness.of_oldest(*seen, ALIKE), _EXPLAINED)
                or _moved(self._witness.of_oldest(*seen, ALIKE_LATELY), _EXPLAINED)
                or _moved(itertools.chain(filter(None, [overlapping]), others), _MAX)
            )
            self._hear(frame.stamp_s, moved or _seen_through(overlapping) or self._crept())
            self._witness.remember(*seen)
        return believed

    def drift(self, now_s: float) -> Reason | None:
        """What depth says against the pose, None for nothing."""
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
        """Whether what was doubted is seen no more from where it was."""
        there = self._doubted is not None and self._doubted.like(CameraPose.of(odom_from_depth), _THERE)
        self._calm = self._calm + 1 if fits and there else 0
        return self._calm >= _CALM

    def _hear(self, stamp_s: float, said: Reason | None) -> None:
        self._running = self._running + 1 if said is not None else 0
        if self._running >= _RUNNING:
            self._drift, self._drift_s = said, stamp_s

    def _crept(self) -> Reason | None:
        """What many looks back say together of the pose, None for nothing."""
        if self._creep.excess <= 1.0:
            return None
        return Reason(ReasonCode.ODOMETRY_DRIFT, (float(np.linalg.norm(self._creep.velocity_mps)),))

    def _frozen(self, depth_m: Float32Array, odom_from_depth: Pose) -> bool:
        """Whether the camera has moved since it first gave this very picture."""
        if self._same is None or not np.array_equal(self._same[0], depth_m, equal_nan=True):
            self._same = depth_m, odom_from_depth
            return False
        first = self._same[1]
        moved_m = math.dist(first.translation_m.tolist(), odom_from_depth.translation_m.tolist())
        return moved_m > _FROZEN_M or float(first.rotation()[:, 2] @ odom_from_depth.rotation()[:, 2]) < _FROZEN_COS


def _follows(then: ViewComparison | None) -> bool:
    """What comes into view stands before something; a wrong picture also lacks what was there."""
    if then is None:
        return False
    return then.nearer <= _HIDDEN and (then.nearer + then.farther <= _MISFIT or then.farther <= _SOME)


def _fits(then: ViewComparison | None) -> TypeGuard[ViewComparison]:
    """Nearly all is where it was, of so much that a part would be missed."""
    return then is not None and then.count >= _MANY and then.nearer + then.farther <= _REFIT


def _moved(oldest: Iterator[ViewComparison], explained: float) -> Reason | None:
    """What the surfaces of the two oldest views say of the pose, None for nothing.

    One alone errs: where something stands before a wall, as far from it as a drift would be, all that both pictures see may
    fit the shift.
    """

    def says(then: ViewComparison) -> bool:
        hidden = then.nearer <= _HIDING and then.farther <= _FARTHER
        sure = then.explained >= explained and then.count >= _MANY and not hidden
        return sure and float(np.linalg.norm(then.shift_m)) >= _DRIFT_M

    told = list(itertools.islice(itertools.takewhile(says, oldest), _TOLD))
    if len(told) < _TOLD:
        return None
    return Reason(ReasonCode.SURFACES_MOVED, (float(np.linalg.norm(told[0].shift_m)), told[0].age_s))


def _seen_through(then: ViewComparison | None) -> Reason | None:
    """Whether the camera looks through what was seen."""
    if then is None or then.farther < _SEEN_THROUGH:
        return None
    return Reason(ReasonCode.SURFACES_GONE, (then.farther, then.age_s))
