"""Recognition of a place: a view matched to the corners of a keyframe.

It does not matter where the track believes to be.
Rublee et al. 2011, ORB; the descriptors are upright, for a camera that hardly rolls. The pose is that of three corners with
which most of the matches agree (P3P in RANSAC, OpenCV). It is a proposal, which depth and landmarks must confirm.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from uav_recon.localization.slam.landmarks import corners_px
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.types.frames import AnyArray, ByteArray, FloatArray, IntArray
from uav_recon.types.pose import Pose

_PATCH_PX = 31
FARTHEST_BITS = 60  # between descriptors of the same corner
_FEWEST = 12  # matches that must agree
_AGREEING_SHARE = 0.4
_REPROJECTED_PX = 3.0
_TRIES = 100


class Description(NamedTuple):
    """Descriptors (K, 32) of corners, and the numbers (K,) of these: one at the border has none."""

    bits: ByteArray
    which: IntArray

    @staticmethod
    def of(grey: ByteArray, at_px: AnyArray) -> Description:
        """Return the descriptors of corners (N, 2) of an image. About 1 ms."""
        points = [cv2.KeyPoint(u, v, _PATCH_PX, 0.0, 0.0, 0, n) for n, (u, v) in enumerate(at_px.astype(float).tolist())]
        orb = cv2.ORB.create(nfeatures=max(len(points), 1), nlevels=1, edgeThreshold=_PATCH_PX // 2 + 1, patchSize=_PATCH_PX)
        kept, found = orb.compute(grey, points)
        if found is None:
            return Description(np.empty((0, 32), np.uint8), np.empty(0, np.int64))
        return Description(np.asarray(found, np.uint8), np.array([point.class_id for point in kept], np.int64))


class UnplacedView:
    """A view whose place is not known. About 3 ms for 424x240."""

    def __init__(self, view: PreparedView) -> None:
        self._view = view
        grey = np.zeros((1, 1), np.uint8) if view.grey is None else view.grey
        at_px = corners_px(grey)
        self._description = Description.of(grey, at_px)
        self._at_px = at_px[self._description.which].astype(np.float64)

    @property
    def bits(self) -> ByteArray:
        """Descriptors (N, 32) of the corners of the view."""
        return self._description.bits

    def place(self, bits: ByteArray, corners_m: FloatArray, odom_from_keyframe: Pose) -> Pose | None:
        """Return odom_from_depth by the corners of a keyframe, None if too few agree. About 1 ms.

        bits (K, 32): their descriptors. corners_m (K, 3): in the frame of its depth imager, NaN where not known.
        """
        if min(len(self._at_px), len(bits)) < _FEWEST:
            return None
        matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(bits, self._description.bits)
        pairs = np.array([(m.queryIdx, m.trainIdx) for m in matches if m.distance <= FARTHEST_BITS], np.int64).reshape(-1, 2)
        place_m = corners_m[pairs[:, 0]]
        known = np.isfinite(place_m[:, 0])
        if np.count_nonzero(known) < _FEWEST:
            return None
        turn, moved_m, agreeing = self._solved(odom_from_keyframe.apply(place_m[known]), self._at_px[pairs[known, 1]])
        if agreeing < max(_FEWEST, _AGREEING_SHARE * np.count_nonzero(known)):
            return None
        return Pose.from_rotation_vector(turn, moved_m).inverse() @ self._view.depth_from_rgb.inverse()

    def _solved(self, place_m: FloatArray, at_px: FloatArray) -> tuple[FloatArray, FloatArray, int]:
        """Return rotation vector and translation of rgb_from_odom, and how many agree."""
        fx, fy, cx, cy = self._view.camera.tolist()
        lens = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        found, turn, moved_m, agreeing = cv2.solvePnPRansac(
            place_m, at_px, lens, np.zeros(4), flags=cv2.SOLVEPNP_P3P, reprojectionError=_REPROJECTED_PX, iterationsCount=_TRIES
        )
        number = len(agreeing) if found and agreeing is not None else 0
        return np.asarray(turn)[:, 0], np.asarray(moved_m)[:, 0], number
