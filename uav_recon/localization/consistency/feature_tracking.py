"""Feature tracking: surface points in the colour images, and their displacement.

The displacement is that against the positions which the poses predict.

Depth shows motion along surface normals only. Motion along a bare wall or over a floor shows in the texture. Points are
tracked with the Lucas-Kanade method (OpenCV's pyramids), each forward and back again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from uav_recon.localization.consistency.planar_patches import patches
from uav_recon.localization.slam.optical_flow import brightness, followed, inside
from uav_recon.types.camera import Frame
from uav_recon.types.camera_calibration import CameraMotion
from uav_recon.types.frames import AnyArray, BoolArray, ByteArray, FloatArray
from uav_recon.types.pose import Pose

_MAX = 120  # max. number of points
_APART_PX = 5  # a grid cell of this edge with a point gets no new one
_WIDEST_PX = 320  # max. width of the reduced image
_NARROWEST_PX = 40  # images with a side shorter than this are not used
_WINDOW_PX = 9
_LEVELS = 2
# min. eigenvalue of the gradients (OpenCV's cornerMinEigenVal): texture in both directions
_MIN_TEXTURE = 30e-6
_BLOCK_PX = 7
_RETURNS_PX = 0.5  # max. distance between a point and its position after tracking forward and back
# search interval, max. age of a point, max. pause between images
_EVERY_S = 0.5
_OLDEST_S = 2.0
_PAUSE_S = 0.5
_NEAREST_M = 0.2


class TrackedPoints(NamedTuple):
    """Tracked points, and the displacement of odom against each since it was first seen.

    along: (N, 2, 3), rows in odom whose product with a shift (3,) of odom is off_m (N, 2). range_m and age_s: (N,).
    rows: (N, 2, 5), derivatives of off_m by delay, rotation (3) and width of the colour imager (calibration_filter).
    """

    along: FloatArray
    off_m: FloatArray
    range_m: FloatArray
    age_s: FloatArray
    rows: FloatArray


class _Points(NamedTuple):
    """Points with place_m (N, 3) in odom and since_s (N,).

    at_px: (N, 2) position in the newest image. displacement_px: (N, 2) its difference from the position that the pose predicts.
    rows: (N, 2, 5), its derivatives when it was first seen, per metre of range.
    """

    place_m: AnyArray
    since_s: AnyArray
    at_px: AnyArray
    displacement_px: AnyArray
    rows: AnyArray

    def only(self, which: BoolArray) -> _Points:
        return _Points(*(values[which] for values in self))

    def joined(self, others: _Points) -> _Points:
        return _Points(*(np.concatenate(both) for both in zip(self, others, strict=True)))


_NONE = _Points(np.empty((0, 3)), np.empty(0), np.empty((0, 2), np.float32), np.empty((0, 2), np.float32), np.empty((0, 2, 5)))


@dataclass(frozen=True, slots=True)
class _Camera:
    """A pinhole camera (fx, fy), (cx, cy) at a position in odom; axes (3, 3) are its columns.

    velocity_mps (3,), rate_radps (3,): its motion in odom.
    """

    focal_px: FloatArray
    middle_px: FloatArray
    axes: FloatArray
    place_m: FloatArray
    velocity_mps: FloatArray
    rate_radps: FloatArray

    @staticmethod
    def of(frame: Frame, motion: CameraMotion, smaller: FloatArray) -> _Camera:
        lens, pose = frame.rgb_intrinsics, motion.odom_from_depth @ frame.rgb_from_depth.inverse()
        middle_px = (np.array([lens.cx, lens.cy]) + 0.5) * smaller - 0.5  # pixel (0, 0) is its centre
        focal_px = np.array([lens.fx, lens.fy]) * smaller
        return _Camera(focal_px, middle_px, pose.rotation(), pose.translation_m, motion.velocity_mps, motion.rate_radps)

    def ahead(self, place_m: AnyArray) -> AnyArray:
        """Return positions (N, 3) in the camera's own axes; those behind it get the least depth."""
        ahead_m = (place_m - self.place_m) @ self.axes
        ahead_m[:, 2] = np.maximum(ahead_m[:, 2], 1e-3)
        return ahead_m

    def along(self, ahead_m: AnyArray) -> AnyArray:
        """Return the image directions (N, 2, 3) in odom at positions (N, 3) in own axes."""
        x, y, range_m = ahead_m.T
        across, down, deep = self.axes.T
        return np.stack([across - np.outer(x / range_m, deep), down - np.outer(y / range_m, deep)], axis=1)

    def error_rows(self, ahead_m: AnyArray, along: AnyArray) -> AnyArray:
        """Return the derivatives (N, 2, 5) along rows by delay, rotation (3) and width."""
        swept = self.velocity_mps + np.cross(self.rate_radps, ahead_m @ self.axes.T)
        inside = along @ self.axes
        return np.concatenate(
            [
                np.einsum("nai,ni->na", along, swept)[..., None],
                np.cross(ahead_m[:, None, :], inside),
                (inside[..., :2] * ahead_m[:, None, :2]).sum(axis=-1, keepdims=True),
            ],
            axis=-1,
        )

    def pixels(self, ahead_m: AnyArray) -> AnyArray:
        """Return the positions in the image, (N, 2) float32."""
        return (ahead_m[:, :2] / ahead_m[:, 2:] * self.focal_px + self.middle_px).astype(np.float32)


class FeatureTracker:
    """Tracks points from image to image. Not thread-safe; about 1 ms an image."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Forget all points after a jump of odom: none of them was seen in the new odom."""
        self._grey: ByteArray | None = None
        self._points = _NONE
        self._stamp_s = -math.inf
        self._sought_s = -math.inf

    def update(self, frame: Frame, motion: CameraMotion) -> TrackedPoints | None:
        """Track the points into an image and look for new ones.

        None if there is no point to track, or no image.
        """
        if min(frame.rgb.shape[:2]) < _NARROWEST_PX:
            return None
        grey, smaller = brightness(frame.rgb, _WIDEST_PX)
        still = self._grey is not None and np.array_equal(grey, self._grey)  # the camera repeated the image
        if still or not frame.stamp_s - self._stamp_s <= _PAUSE_S:
            self.forget()
        eye = _Camera.of(frame, motion, smaller)
        seen = self._follow(frame.stamp_s, grey, eye)
        self._grey = grey
        self._stamp_s = frame.stamp_s
        if frame.stamp_s - self._sought_s >= _EVERY_S:
            self._sought_s = frame.stamp_s
            self._points = self._points.joined(self._new(frame, motion.odom_from_depth, grey, eye))
        return seen

    def _follow(self, stamp_s: float, grey: ByteArray, camera: _Camera) -> TrackedPoints | None:
        """Track the points, starting from their predicted position plus their last displacement."""
        points = self._points.only(stamp_s - self._points.since_s <= _OLDEST_S)
        belongs_px = camera.pixels(ahead_m := camera.ahead(points.place_m))
        shown = inside(belongs_px + points.displacement_px, grey, _WINDOW_PX) & (ahead_m[:, 2] > _NEAREST_M)
        points, belongs_px = points.only(shown), belongs_px[shown]
        if self._grey is None or not len(belongs_px):
            self._points = _NONE
            return None
        at_px, found = followed(
            self._grey, grey, points.at_px, belongs_px + points.displacement_px,
            window_px=_WINDOW_PX, levels=_LEVELS, back_levels=_LEVELS, returns_px=_RETURNS_PX,
        )  # fmt: skip
        self._points = points = points._replace(at_px=at_px, displacement_px=at_px - belongs_px).only(found)
        ahead_m = camera.ahead(points.place_m)
        along, range_m = camera.along(ahead_m), ahead_m[:, 2]
        rows = camera.error_rows(ahead_m, along) - range_m[:, None, None] * points.rows
        off_m = points.displacement_px * range_m[:, None] / camera.focal_px
        return TrackedPoints(along, off_m, range_m, stamp_s - points.since_s, rows)

    def _new(self, frame: Frame, odom_from_depth: Pose, grey: ByteArray, eye: _Camera) -> _Points:
        """Return planar patches with the strongest texture, apart from the existing points."""
        camera, here = frame.depth_intrinsics.pinhole_px(), odom_from_depth
        place_m = patches(frame.depth_m, camera, here.rotation(), here.translation_m)[:, :3]
        at_px = eye.pixels(eye.ahead(place_m))
        shown = inside(at_px, grey, _WINDOW_PX)
        place_m, at_px = place_m[shown], at_px[shown]
        column, row = np.rint(at_px).astype(np.int64).T
        telling = cv2.cornerMinEigenVal(grey, _BLOCK_PX)[row, column]
        taken = np.zeros((grey.shape[0] // _APART_PX + 1, grey.shape[1] // _APART_PX + 1), dtype=np.bool_)
        old_column, old_row = np.rint(self._points.at_px).astype(np.int64).T // _APART_PX
        taken[old_row, old_column] = True
        fresh = np.flatnonzero((telling > _MIN_TEXTURE) & ~taken[row // _APART_PX, column // _APART_PX])
        best = fresh[np.argsort(-telling[fresh], kind="stable")][: _MAX - len(self._points.since_s)]
        ahead_m = eye.ahead(place_m[best])
        rows = eye.error_rows(ahead_m, eye.along(ahead_m)) / ahead_m[:, 2, None, None]
        none_px = np.zeros((len(best), 2), np.float32)
        return _Points(place_m[best], np.full(len(best), frame.stamp_s), at_px[best], none_px, rows)
