"""Landmarks: corners of the colour image with places in odom, followed between images.

A corner is followed by pyramidal Lucas-Kanade (OpenCV) from where the predicted pose expects it. Its place is the mean of the
depths measured at it.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.localization.slam.optical_flow import followed, inside
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.types.frames import AnyArray, BoolArray, ByteArray, FloatArray
from uav_recon.types.pose import Pose

MOST = 220
_ENOUGH = 170  # landmarks; fewer are topped up
_APART_PX = 9
_CORNER_QUALITY = 0.01
_MIN_TEXTURE = 3e-5  # smallest eigenvalue of a corner, as in feature_tracking; less is noise
_BLOCK_PX = 3
_WINDOW_PX = 15
_LEVELS = 2
_RETURNS_PX = 0.7  # a corner followed there and back again must return to this distance
_NEAREST_M = 0.25
_SIGMA_PX = 1.0
ROBUST_PX = 2.0  # scale of the robust weight
# eigenvalue of a corner's weaker direction against the stronger one, up to which it is an edge, and from which on a corner
_EDGE_SHARE = 0.15
_CORNER_SHARE = 0.5
_FITS_PX = 3.0  # a landmark farther from where the pose expects it is dropped
_MOST_SEEN = 15.0  # depths in a mean; more would keep the landmark where it was first seen

DELAY = 6  # element of the normal equations: delay of colour against depth, s
WIDTH = 7  # share by which the colour image is too wide
SIZE = 8


class Landmarks(NamedTuple):
    """Landmarks that are in view.

    place_m (N, 3) in odom. slope (N, 3, 2): its derivatives by delay and width of the colour image. at_px (N, 2) float32:
    where the newest image shows them. off_px (N, 2): difference from where the pose expected them. seen (N,): weight of the
    depths in the place. texture (N, 2, 2): share of a displacement that the image shows: along an edge it
    shows none (aperture problem). variance (N, 3): of the place, by that of the camera when it was measured, m² along the axes
    of odom.
    """

    place_m: FloatArray
    slope: FloatArray
    at_px: AnyArray
    off_px: AnyArray
    seen: FloatArray
    texture: FloatArray
    variance: FloatArray

    @staticmethod
    def none() -> Landmarks:
        """Return no landmarks."""
        none_px = np.empty((0, 2), np.float32)
        return Landmarks(
            np.empty((0, 3)), np.empty((0, 3, 2)), none_px, none_px, np.empty(0), np.empty((0, 2, 2)), np.empty((0, 3))
        )

    def only(self, which: BoolArray) -> Landmarks:
        """Return the landmarks of a mask (N,)."""
        return Landmarks(*(values[which] for values in self))


class LandmarkTracker:
    """Follows landmarks through the images. Not thread-safe; about 2 ms an image of 424x240."""

    def __init__(self) -> None:
        self._grey: ByteArray | None = None
        self._slow = np.zeros(2)
        self.points = Landmarks.none()
        self._accepted: tuple[ByteArray | None, Landmarks] = None, self.points

    def recall(self) -> None:
        """Return to the image and the landmarks of the newest accepted frame: this one is not."""
        self._grey, self.points = self._accepted

    def follow(self, view: PreparedView, predicted: FloatArray) -> Landmarks:
        """Return the landmarks that the image shows.

        predicted (N, 2): where the predicted pose expects each of ``points``.
        """
        points, grey = self.points, view.grey
        self.points = Landmarks.none()
        before, self._grey = self._grey, grey
        if before is None or grey is None or not len(points.place_m) or before.shape != grey.shape:
            return self.points
        guess_px = (predicted + points.off_px).astype(np.float32)
        shown = inside(guess_px, grey, _WINDOW_PX)
        points, guess_px = points.only(shown), guess_px[shown]
        if not len(guess_px):
            return self.points
        at_px, found = followed(
            before, grey, points.at_px, guess_px, window_px=_WINDOW_PX, levels=_LEVELS, returns_px=_RETURNS_PX
        )
        self.points = points._replace(at_px=at_px).only(found)
        return self.points

    def shift(self, shift_m: FloatArray, share: FloatArray) -> None:
        """Move all landmarks by the error (3,) of the track that has been found.

        share (3,): of their variance that is left.
        """
        points = self.points
        self.points = points._replace(place_m=points.place_m + shift_m, variance=points.variance * share)

    def settle(
        self, view: PreparedView, odom_from_depth: Pose, motion: FloatArray, slow: FloatArray, variance: FloatArray
    ) -> None:
        """Keep the landmarks that fit the pose of the image, refine their places, and add new ones.

        motion (6,), slow (2,): as in MovingImager. variance (3,): of the place of the camera, m² along the axes of odom.
        """
        if view.grey is None:
            return
        eye = view.rgb_pose(odom_from_depth)
        place_m = self.points.place_m + self.points.slope @ (slow - self._slow)
        self._slow = slow
        off_px = self.points.at_px - project(place_m, moving_imager(view, odom_from_depth, motion, slow))
        fits = np.asarray(np.einsum("na,nab,nb->n", off_px, self.points.texture, off_px) < _FITS_PX**2)
        points = self.points._replace(place_m=place_m, off_px=off_px.astype(np.float32)).only(fits)
        places = view.places(points.at_px, odom_from_depth, motion, slow)
        weight = _weight(points.place_m, eye[1])
        slope = _slope(points.place_m, eye, odom_from_depth.translation_m, motion)
        measured = np.isfinite(places[:, 0])
        share = np.where(measured, weight / (points.seen + weight), 0.0)
        place_m = points.place_m + share[:, None] * np.where(measured[:, None], places - points.place_m, 0.0)
        slope = points.slope + share[:, None, None] * (slope - points.slope)
        seen = np.minimum(points.seen + np.where(measured, weight, 0.0), _MOST_SEEN)
        placed = points.variance + share[:, None] * (variance - points.variance)
        self.points = points._replace(place_m=place_m, slope=slope, seen=seen, variance=placed)
        if len(self.points.seen) < _ENOUGH:
            self._add(view, odom_from_depth, motion, slow, variance)
        self._accepted = self._grey, self.points

    def _add(
        self, view: PreparedView, odom_from_depth: Pose, motion: FloatArray, slow: FloatArray, variance: FloatArray
    ) -> None:
        grey = view.grey
        assert grey is not None
        free = np.full(grey.shape, 255, np.uint8)
        for u, v in np.rint(self.points.at_px).astype(int).tolist():
            cv2.circle(free, (u, v), _APART_PX, 0, -1)
        corners = cv2.goodFeaturesToTrack(
            grey, MOST - len(self.points.seen), _CORNER_QUALITY, _APART_PX, mask=free, blockSize=_BLOCK_PX
        )
        if corners is None:
            return
        at_px = corners.reshape(-1, 2).astype(np.float32)
        at_px = at_px[inside(at_px, grey, _WINDOW_PX)]
        column, row = np.rint(at_px).astype(np.int64).T
        texture = cv2.cornerEigenValsAndVecs(grey, _WINDOW_PX // 2, 3)[row, column].astype(np.float64)
        strong = np.minimum(texture[:, 0], texture[:, 1]) > _MIN_TEXTURE
        at_px, texture = at_px[strong], texture[strong]
        place_m = view.places(at_px, odom_from_depth, motion, slow)
        known = np.isfinite(place_m[:, 0])
        place_m, at_px, texture = place_m[known], at_px[known], texture[known]
        eye = view.rgb_pose(odom_from_depth)
        weight = _weight(place_m, eye[1])
        new = Landmarks(
            place_m,
            _slope(place_m, eye, odom_from_depth.translation_m, motion),
            at_px,
            np.zeros_like(at_px),
            weight,
            _shown(texture),
            np.tile(variance, (len(place_m), 1)),
        )
        self.points = Landmarks(*(np.concatenate(both) for both in zip(self.points, new, strict=True)))


class MovingImager(NamedTuple):
    """Colour imager that moves while its image is late, for kernels.

    camera (4,): fx, fy, cx, cy. rotation (3, 3), eye_m (3,): its pose in odom. turn_m (3,): place of the depth imager, about
    which the camera turns. motion (6,): turn rate and velocity in odom. slow (2,): delay (s) and share of width of the image.
    """

    camera: AnyArray
    rotation: AnyArray
    eye_m: AnyArray
    turn_m: AnyArray
    motion: AnyArray
    slow: AnyArray


def moving_imager(view: PreparedView, odom_from_depth: Pose, motion: FloatArray, slow: FloatArray) -> MovingImager:
    """Return the colour imager of a view.

    odom_from_depth: pose of the depth imager. motion (6,), slow (2,): as in MovingImager.
    """
    rotation, eye_m = view.rgb_pose(odom_from_depth)
    return MovingImager(
        camera=view.camera, rotation=rotation, eye_m=eye_m, turn_m=odom_from_depth.translation_m, motion=motion, slow=slow
    )


@kernel
def project(place_m: AnyArray, imager: MovingImager) -> AnyArray:
    """Return the pixels (N, 2) of places (N, 3) in odom; NaN behind the camera."""
    out, columns = np.empty((place_m.shape[0], 2)), np.empty((2, SIZE))
    for n in range(place_m.shape[0]):
        deep = _row(place_m[n], imager, out[n], columns)
        if deep < _NEAREST_M:
            out[n, 0] = out[n, 1] = np.nan
    return out


@kernel
def add_landmark_equations(
    place_m: AnyArray,
    slope: AnyArray,
    texture: AnyArray,
    at_px: AnyArray,
    imager: MovingImager,
    change: AnyArray,
    wider: float,
    information: AnyArray,
    gradient: AnyArray,
    shown: AnyArray,
) -> int:
    """Add the normal equations (SIZE) of landmarks that the image shows at at_px (N, 2).

    place_m (N, 3), slope (N, 3, 2), texture (N, 2, 2): of Landmarks; change (2,): of ``slow`` since the places were right.
    wider: factor on the scale of the robust weight. shown (3, 3): information on the translation that the landmarks would give
    if each were a perfect corner. The first six elements are those of add_depth_equations. Returns the number of landmarks that
    fit.
    """
    fitting, expected, columns = 0, np.empty(2), np.empty((2, SIZE))
    for n in range(place_m.shape[0]):
        deep = _row(place_m[n], imager, expected, columns)
        if deep < _NEAREST_M:
            continue
        for axis in range(2):  # a change of delay or width moves the place, too
            for k in range(2):
                moved = 0.0
                for a in range(3):
                    moved -= columns[axis, 3 + a] * slope[n, a, k]
                columns[axis, DELAY + k] += moved
                expected[axis] += moved * change[k]
        off0, off1 = at_px[n, 0] - expected[0], at_px[n, 1] - expected[1]
        t00, t01, t11 = texture[n, 0, 0], texture[n, 0, 1], texture[n, 1, 1]
        shown0, shown1 = t00 * off0 + t01 * off1, t01 * off0 + t11 * off1
        square = (off0 * shown0 + off1 * shown1) / (ROBUST_PX * ROBUST_PX)
        fitting += int(square < 1.0)
        shrink = 1.0 / (1.0 + square / (wider * wider))
        w = shrink * shrink / (_SIGMA_PX * _SIGMA_PX)
        for a in range(SIZE):
            gradient[a] += w * (columns[0, a] * shown0 + columns[1, a] * shown1)
            along0, along1 = t00 * columns[0, a] + t01 * columns[1, a], t01 * columns[0, a] + t11 * columns[1, a]
            for b in range(SIZE):
                information[a, b] += w * (along0 * columns[0, b] + along1 * columns[1, b])
        for a in range(3):
            for b in range(3):
                shown[a, b] += w * (columns[0, 3 + a] * columns[0, 3 + b] + columns[1, 3 + a] * columns[1, 3 + b])
    return fitting


@kernel
def _row(place: AnyArray, imager: MovingImager, expected: AnyArray, columns: AnyArray) -> float:
    """Write the pixel (2,) of a place and its derivatives (2, SIZE); return its depth (m).

    The derivatives are by a rotation of the camera in odom axes, its translation, and ``slow``.
    """
    camera, rotation, eye_m, turn_m = imager.camera, imager.rotation, imager.eye_m, imager.turn_m
    motion, slow = imager.motion, imager.slow
    x, y, z = place[0] - eye_m[0], place[1] - eye_m[1], place[2] - eye_m[2]
    p = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
    q = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
    deep = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
    if deep < _NEAREST_M:
        return float(deep)
    x, y, z = place[0] - turn_m[0], place[1] - turn_m[1], place[2] - turn_m[2]
    for axis in range(2):
        focal, across = camera[axis], (p if axis == 0 else q) / deep
        # direction in odom along which the place must move to change the pixel
        m0 = focal / deep * (rotation[0, axis] - across * rotation[0, 2])
        m1 = focal / deep * (rotation[1, axis] - across * rotation[1, 2])
        m2 = focal / deep * (rotation[2, axis] - across * rotation[2, 2])
        columns[axis, 0] = m1 * z - m2 * y
        columns[axis, 1] = m2 * x - m0 * z
        columns[axis, 2] = m0 * y - m1 * x
        columns[axis, 3], columns[axis, 4], columns[axis, 5] = -m0, -m1, -m2
        flow = 0.0
        for a in range(6):
            flow += columns[axis, a] * motion[a]
        columns[axis, DELAY] = flow
        columns[axis, WIDTH] = focal * across
        expected[axis] = focal * across * (1.0 + slow[1]) + camera[2 + axis] + slow[0] * flow
    return float(deep)


def _shown(texture: FloatArray) -> FloatArray:
    """Return Landmarks.texture (N, 2, 2) of the brightness around corners.

    texture (N, 6): its eigenvalues and eigenvectors.
    """
    values, first, second = texture[:, :2], texture[:, 2:4], texture[:, 4:6]
    ratio = values / values.max(axis=1, keepdims=True)
    share = np.clip((ratio - _EDGE_SHARE) / (_CORNER_SHARE - _EDGE_SHARE), 0.0, 1.0) ** 2
    return np.asarray(
        share[:, 0, None, None] * first[:, :, None] * first[:, None, :]
        + share[:, 1, None, None] * second[:, :, None] * second[:, None, :]
    )


def _weight(place_m: FloatArray, eye_m: FloatArray) -> FloatArray:
    """Return the weight (N,) of one depth: one at 1 m, less by the square of the distance."""
    return np.asarray(1.0 / np.maximum(np.linalg.norm(place_m - eye_m, axis=1), 0.5) ** 2, dtype=np.float64)


def _slope(place_m: FloatArray, eye: tuple[FloatArray, FloatArray], turn_m: FloatArray, motion: FloatArray) -> FloatArray:
    """Return the derivatives (N, 3, 2) of measured places by the delay and width of the image."""
    swept = motion[3:] + np.cross(motion[:3], place_m - turn_m)
    rotation, eye_m = eye
    ahead = (place_m - eye_m) @ rotation
    ahead[:, 2] = 0.0
    return np.stack((swept, -ahead @ rotation.T), axis=2)
