"""Whether what is seen now fits what was seen before, if the poses are right: past views remembered as points on surfaces.

A remembered point is looked for in the picture of now, along its ray from where the pose says that the camera is. How far the
surface found there lies off the remembered one, along its normal, is the residual: few that fit mean a picture that is
wrong, many that fit only when all of the past is moved mean a pose that is.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from uav_recon.localization.point_to_plane import FEWEST, MOST, gain_aside, loss_aside, residuals, shares, shift_of, surface
from uav_recon.types.camera import Intrinsics
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray
from uav_recon.types.pose import Pose

_EVERY_S, _MEMORY_S = 0.5, 30.0


@dataclass(frozen=True, slots=True)
class ViewSelection:
    """Which views are asked: taken no farther off (m), not turned away farther (cosine), and no older."""

    near_m: float
    turned_cos: float
    within_s: float = _MEMORY_S


OVERLAPPING = ViewSelection(3.0, 0.6)  # there is something that both see
ALIKE = ViewSelection(1.5, 0.75)  # little has come between
ALIKE_LATELY = ViewSelection(1.5, 0.75, within_s=8.0)  # a drift so young is still within a residual's reach


@dataclass(frozen=True, slots=True, eq=False)
class ViewComparison:
    """count: points that could be compared. fitting, nearer, farther: shares of them; shift_m (3,): how far odom has moved
    since, as far as surfaces tell; held (3, 3): how well they tell, by direction; explained: the share that fits with it.
    age_s: of the view compared with; points (N, 6): its surface.
    """

    count: int
    fitting: float
    nearer: float
    farther: float
    shift_m: FloatArray
    held: FloatArray
    explained: float
    age_s: float
    points: AnyArray


class CameraPose(NamedTuple):
    """Where a camera was, and its axis; plain numbers, for sixty are asked at each picture."""

    place_m: list[float]
    axis: list[float]

    @staticmethod
    def of(odom_from_depth: Pose) -> CameraPose:
        """Of a camera with this pose."""
        return CameraPose(odom_from_depth.translation_m.tolist(), odom_from_depth.rotation()[:, 2].tolist())

    def like(self, other: CameraPose, likeness: ViewSelection) -> bool:
        """Whether the other is no farther off and turned away."""
        away_m = math.dist(self.place_m, other.place_m)
        return away_m <= likeness.near_m and _dot(self.axis, other.axis) >= likeness.turned_cos


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """points: (N, 6), places and normals in odom, of what was seen from there."""

    stamp_s: float
    stand: CameraPose
    points: AnyArray


class PastViews:
    """Remembers half a minute of views. Not thread-safe; about 0.1 ms a picture."""

    def __init__(self) -> None:
        self._views: deque[_View] = deque()
        self._newest: _View | None = None

    @property
    def remembers(self) -> bool:
        """Whether there is a picture to compare with."""
        return self._newest is not None

    def forget(self) -> None:
        """Odom itself jumped: nothing was seen in the new one."""
        self._views.clear()
        self._newest = None

    def remember(self, stamp_s: float, depth_m: Float32Array, lens: Intrinsics, odom_from_depth: Pose) -> None:
        """Take a picture that is believed for the newest; one every half second is kept."""
        points = surface(depth_m, lens.pinhole_px(), odom_from_depth.rotation(), odom_from_depth.translation_m)
        self._newest = _View(stamp_s, CameraPose.of(odom_from_depth), points)
        if not self._views or stamp_s - self._views[-1].stamp_s >= _EVERY_S:
            self._views.append(self._newest)
        while stamp_s - self._views[0].stamp_s > _MEMORY_S:
            self._views.popleft()

    def of_newest(
        self, stamp_s: float, depth_m: Float32Array, lens: Intrinsics, odom_from_depth: Pose
    ) -> ViewComparison | None:
        """With the newest picture that was believed; None where too little of it is in view. Where it is and nothing comes back
        from there, all of it is farther.
        """
        return None if self._newest is None else _compared(self._newest, stamp_s, depth_m, lens, odom_from_depth, FEWEST)

    def of_oldest(
        self, stamp_s: float, depth_m: Float32Array, lens: Intrinsics, odom_from_depth: Pose, likeness: ViewSelection
    ) -> Iterator[ViewComparison]:
        """With those that look at the same, the oldest first; each is compared when it is asked for."""
        for view in self._alike(stamp_s, odom_from_depth, likeness):
            found = _compared(view, stamp_s, depth_m, lens, odom_from_depth)
            if found is not None:
                yield found

    def gain_aside(self, depth_m: Float32Array, lens: Intrinsics, odom_from_depth: Pose) -> float:
        """By what share more of the newest picture that was believed fits one that lies aside; of pictures a moment apart."""
        if self._newest is None:
            return 0.0
        rotation, place = odom_from_depth.rotation(), odom_from_depth.translation_m
        return float(gain_aside(self._newest.points, depth_m, lens.pinhole_px(), rotation, place))

    @staticmethod
    def loss_aside(then: ViewComparison, depth_m: Float32Array, lens: Intrinsics, odom_from_depth: Pose) -> float:
        """By what share less of that view would fit a picture that lies aside; little, and it tells nothing of this one."""
        rotation, place = odom_from_depth.rotation(), odom_from_depth.translation_m
        return float(loss_aside(then.points, depth_m, lens.pinhole_px(), rotation, place))

    def _alike(self, stamp_s: float, odom_from_depth: Pose, likeness: ViewSelection) -> Iterator[_View]:
        """Views to be asked, the oldest first."""
        here = CameraPose.of(odom_from_depth)
        for view in self._views:
            if stamp_s - view.stamp_s <= likeness.within_s and here.like(view.stand, likeness):
                yield view


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _compared(
    view: _View, stamp_s: float, depth_m: Float32Array, lens: Intrinsics, odom_from_depth: Pose, max_missing: int = MOST
) -> ViewComparison | None:
    """max_missing: points without a return where there are too few with one, for a verdict all the same."""
    rotation, place = odom_from_depth.rotation(), odom_from_depth.translation_m
    found, gone = residuals(view.points, depth_m, lens.pinhole_px(), rotation, place)
    age_s = stamp_s - view.stamp_s
    if len(found) < FEWEST:
        if gone <= max_missing:
            return None
        return ViewComparison(gone, 0.0, 0.0, 1.0, np.zeros(3), np.zeros((3, 3)), 0.0, age_s, view.points)
    shift_m, held = shift_of(found)
    fitting, nearer, explained = shares(found, shift_m)
    return ViewComparison(len(found), fitting, nearer, 1.0 - fitting - nearer, shift_m, held, explained, age_s, view.points)
