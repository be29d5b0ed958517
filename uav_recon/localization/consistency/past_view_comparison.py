"""Comparison of the present depth with past views, which are stored as points on surfaces.

A stored point is projected into the present depth image with the present camera pose. The distance of the surface found
there from the stored one, along its normal, is the residual. Few points that fit mean a wrong image. Many that fit only if
the whole past is shifted mean a wrong pose.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from uav_recon.localization.consistency.point_to_plane import (
    MIN_POINTS,
    MOST,
    contradicted_points,
    fit_counts,
    residuals,
    shares,
    shift_gain,
    shift_loss,
    shift_of,
    surface,
)
from uav_recon.types.camera import Intrinsics
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray
from uav_recon.types.pose import Pose

_EVERY_S = 0.5  #: internal: interval of stored views
_MEMORY_S = 30.0  #: internal: max. age of stored views


@dataclass(frozen=True, slots=True)
class ViewSelection:
    """Limits for past views: distance (m), cosine between the optical axes, and age (s)."""

    near_m: float
    turned_cos: float
    within_s: float = _MEMORY_S


OVERLAPPING = ViewSelection(3.0, 0.6)  # both see some of the same surface
ALIKE = ViewSelection(1.5, 0.75)  # little can stand in between
ALIKE_LATELY = ViewSelection(1.5, 0.75, within_s=8.0)  # a drift of this age is still within a residual's reach


@dataclass(frozen=True, slots=True, eq=False)
class ViewComparison:
    """Result of the comparison with one past view.

    count: points that could be compared. fitting, nearer, farther: shares of them. shift_m (3,): motion of odom since, as far
    as the surfaces show it. held (3, 3): how well they determine it, by direction. explained: share of the points that fit with
    the shift. age_s: age of the past view. points (N, 6): its surface.
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
    camera_pose: CameraPose


class CameraPose(NamedTuple):
    """Position and optical axis of a camera.

    They are plain numbers, because about sixty are checked per image.
    """

    place_m: list[float]
    axis: list[float]

    @staticmethod
    def of(odom_from_depth: Pose) -> CameraPose:
        """Return those of a camera with this pose."""
        return CameraPose(odom_from_depth.translation_m.tolist(), odom_from_depth.rotation()[:, 2].tolist())

    def like(self, other: CameraPose, selection: ViewSelection) -> bool:
        """Return True if the other pose meets the selection's distance and axis limits."""
        away_m = math.dist(self.place_m, other.place_m)
        return away_m <= selection.near_m and _dot(self.axis, other.axis) >= selection.turned_cos


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A past view. points: (N, 6) positions and normals in odom of the seen surface."""

    stamp_s: float
    camera_pose: CameraPose
    points: AnyArray


class PastViews:
    """Stores half a minute of views. Not thread-safe; about 0.1 ms an image.

    A view is kept once the next accepted image confirms it: a single wrong image may be accepted, and is then the newest until
    the next one, but nothing later is judged by it.
    """

    def __init__(self) -> None:
        self._views: deque[_View] = deque()
        self._newest: _View | None = None
        self._confirmed: _View | None = None  # the newest that the next one confirmed

    @property
    def has_view(self) -> bool:
        """True if there is an image to compare with."""
        return self._newest is not None

    def forget(self) -> None:
        """Forget all views after a jump of odom: none of them was seen in the new odom."""
        self._views.clear()
        self._newest = self._confirmed = None

    def drop_newest(self) -> None:
        """Forget the newest accepted image, because it was wrong."""
        self._newest, self._confirmed = self._confirmed, None

    def remember(
        self, stamp_s: float, depth_m: Float32Array, intrinsics: Intrinsics, odom_from_depth: Pose, confirms_newest: bool
    ) -> None:
        """Store an accepted image as the newest.

        Of those that the next one confirms, one every half second is kept.
        """
        if self._newest is not None and confirms_newest:
            self._confirmed = self._newest
            self._keep(self._newest)
        points = surface(depth_m, intrinsics.pinhole_px(), odom_from_depth.rotation(), odom_from_depth.translation_m)
        self._newest = _View(stamp_s, CameraPose.of(odom_from_depth), points)
        while self._views and stamp_s - self._views[0].stamp_s > _MEMORY_S:
            self._views.popleft()

    def _keep(self, view: _View) -> None:
        if not self._views or view.stamp_s - self._views[-1].stamp_s >= _EVERY_S:
            self._views.append(view)

    def compare_newest(
        self, stamp_s: float, depth_m: Float32Array, intrinsics: Intrinsics, odom_from_depth: Pose
    ) -> ViewComparison | None:
        """Compare with the newest accepted image; None if too little of it is in view.

        If it is in view and there are no returns from there, all of it counts as farther.
        """
        return (
            None if self._newest is None else _compared(self._newest, stamp_s, depth_m, intrinsics, odom_from_depth, MIN_POINTS)
        )

    def compare_confirmed(
        self, stamp_s: float, depth_m: Float32Array, intrinsics: Intrinsics, odom_from_depth: Pose
    ) -> ViewComparison | None:
        """Compare with the newest image that the one after it confirmed.

        None if too little of it is in view.
        """
        return None if self._confirmed is None else _compared(self._confirmed, stamp_s, depth_m, intrinsics, odom_from_depth)

    def compare_oldest(
        self, stamp_s: float, depth_m: Float32Array, intrinsics: Intrinsics, odom_from_depth: Pose, selection: ViewSelection
    ) -> Iterator[ViewComparison]:
        """Yield comparisons with the views that meet the selection, oldest first.

        Each is computed when it is requested.
        """
        for view in self._alike(stamp_s, odom_from_depth, selection):
            found = _compared(view, stamp_s, depth_m, intrinsics, odom_from_depth)
            if found is not None:
                yield found

    @staticmethod
    def gain_aside(comparison: ViewComparison, depth_m: Float32Array, intrinsics: Intrinsics, odom_from_depth: Pose) -> float:
        """Return the share of that view that only fits the present image shifted.

        It is meant for images a moment apart.
        """
        rotation, place = odom_from_depth.rotation(), odom_from_depth.translation_m
        return float(shift_gain(comparison.points, depth_m, intrinsics.pinhole_px(), rotation, place))

    @staticmethod
    def loss_aside(comparison: ViewComparison, depth_m: Float32Array, intrinsics: Intrinsics, odom_from_depth: Pose) -> float:
        """Return the share of that view that would no longer fit a shifted image.

        If it is small, the view cannot show whether this image is shifted.
        """
        rotation, place = odom_from_depth.rotation(), odom_from_depth.translation_m
        return float(shift_loss(comparison.points, depth_m, intrinsics.pinhole_px(), rotation, place))

    def contradicted(self, depth_m: Float32Array, intrinsics: Intrinsics, odom_from_depth: Pose) -> AnyArray:
        """Return the points (N, 6) of the newest accepted image that the present one contradicts."""
        if self._newest is None:
            return np.empty((0, 6))
        return contradicted_points(
            self._newest.points, depth_m, intrinsics.pinhole_px(), odom_from_depth.rotation(), odom_from_depth.translation_m
        )

    @staticmethod
    def fit_counts(points: AnyArray, depth_m: Float32Array, intrinsics: Intrinsics, odom_from_depth: Pose) -> tuple[int, int]:
        """Return the number of points (N, 6) in view, and of those that fit the image."""
        in_view, fitting = fit_counts(
            points, depth_m, intrinsics.pinhole_px(), odom_from_depth.rotation(), odom_from_depth.translation_m
        )
        return int(in_view), int(fitting)

    def _alike(self, stamp_s: float, odom_from_depth: Pose, selection: ViewSelection) -> Iterator[_View]:
        """Yield the views that meet the selection, oldest first."""
        here = CameraPose.of(odom_from_depth)
        for view in self._views:
            if stamp_s - view.stamp_s <= selection.within_s and here.like(view.camera_pose, selection):
                yield view


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _compared(
    view: _View, stamp_s: float, depth_m: Float32Array, intrinsics: Intrinsics, odom_from_depth: Pose, max_missing: int = MOST
) -> ViewComparison | None:
    """Compare a view with the present depth image, or return None.

    max_missing: with too few returns to compare, more missing returns than this still give a result.
    """
    rotation, place = odom_from_depth.rotation(), odom_from_depth.translation_m
    found, gone = residuals(view.points, depth_m, intrinsics.pinhole_px(), rotation, place)
    age_s = stamp_s - view.stamp_s
    if len(found) < MIN_POINTS:
        if gone <= max_missing:
            return None
        return ViewComparison(gone, 0.0, 0.0, 1.0, np.zeros(3), np.zeros((3, 3)), 0.0, age_s, view.points, view.camera_pose)
    shift_m, held = shift_of(found)
    fitting, nearer, explained = shares(found, shift_m)
    farther = 1.0 - fitting - nearer
    return ViewComparison(len(found), fitting, nearer, farther, shift_m, held, explained, age_s, view.points, view.camera_pose)
