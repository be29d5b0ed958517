"""Landmarks: corners of the colour image of a keyframe, with places.

The places are in the frame of its depth imager.
A corner is followed by pyramidal Lucas-Kanade (OpenCV) from the keyframe into a later image, from where the predicted pose
expects it. So its track does not drift, and a frame that is not accepted loses none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.localization.slam.depth_image import DepthImage
from uav_recon.localization.slam.optical_flow import followed, inside
from uav_recon.localization.slam.prepared_view import PreparedView, corner_places
from uav_recon.types.frames import AnyArray, BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.pose import Pose

MOST = 220  # corners of a keyframe
FOLLOWED = 110  # number of them that are looked for in a frame
_APART_PX = 9
_CORNER_QUALITY = 0.01
_MIN_TEXTURE = 7.5e-6  # smallest eigenvalue of structure(): a quarter of OpenCV's, as in feature_tracking; less is noise
_GRID_PX = 16  # between places at which the noise of an image is measured ...
_PLAIN_SHARE = 0.1  # ... as the texture that this share of them does not exceed
_ABOVE_NOISE = 2.0
_HALF_PX = 3  # around a corner, in which its texture is measured
_BLOCK_PX = 3
_WINDOW_PX = 11
_LEVELS = 2
_RETURNS_PX = 0.7  # a corner followed there and back again must return to this distance
_NEAREST_M = 0.25
_SIGMA_PX = 1.0
ROBUST_PX = 2.0  # scale of the robust weight
# eigenvalue of a corner's weaker direction against the stronger one, up to which it is an edge, and from which on a corner
_EDGE_SHARE = 0.15
_CORNER_SHARE = 0.5
_LEAST_SIZE = 0.7  # a corner that looks smaller by more than this factor, or larger, is not recognised
_ALIKE_COS = 0.9  # nor one from a direction that differs by more
_LATE_S = 0.3  # a difference from where the pose expects a corner is remembered for this time

DELAY = 6  # element of the normal equations: delay of colour against depth, s
WIDTH = 7  # share by which the colour image is too wide
SIZE = 8


class Landmarks(NamedTuple):
    """Landmarks that an image shows.

    place_m (N, 3) in odom. slope (N, 3, 2): its derivatives by delay and width of the colour image. at_px (N, 2) float32: where
    the image shows them. texture (N, 2, 2): share of a displacement that the image shows: along an edge it shows none (aperture
    problem). keyframe (N,): which of the keyframes that the frame is compared with, 0 to M - 1. corner (N,): number of the
    corner there.
    """

    place_m: FloatArray
    slope: FloatArray
    at_px: AnyArray
    texture: FloatArray
    keyframe: IntArray
    corner: IntArray

    @property
    def share(self) -> float:
        """Weight of one: the keyframes that show the same corners divide it."""
        return 1.0 / max(len(np.unique(self.keyframe)), 1)

    def of(self, keyframes: BoolArray) -> Landmarks:
        """Return the landmarks of some of the keyframes (M,)."""
        kept = keyframes[self.keyframe]
        return Landmarks(
            self.place_m[kept], self.slope[kept], self.at_px[kept], self.texture[kept], self.keyframe[kept], self.corner[kept]
        )

    @staticmethod
    def none() -> Landmarks:
        """Return no landmarks."""
        none_px, none = np.empty((0, 2), np.float32), np.empty(0, np.int64)
        return Landmarks(np.empty((0, 3)), np.empty((0, 3, 2)), none_px, np.empty((0, 2, 2)), none, none)


class Expected(NamedTuple):
    """Corners of a keyframe that a view is expected to show.

    which (N,): their numbers. place_m (N, 3): in odom. at_px (N, 2) float32: where they are expected.
    """

    which: IntArray
    place_m: FloatArray
    at_px: AnyArray


@dataclass(eq=False)
class Corners:
    """Corners of the colour image of a keyframe. Not thread-safe.

    grey (h, w): the image. at_px (N, 2) float32: where it shows them. texture (N, 2, 2): as in Landmarks. place_m (N, 3): in
    the frame of the depth imager. slope (N, 3, 2): derivatives of the places by delay and width of the image, of which they
    were ``slow`` (2,) when the places were right. rgb_from_depth: pose of the depth imager in the colour imager at the later
    instant of its image. camera (4,): of the colour image.
    """

    grey: ByteArray
    at_px: AnyArray
    texture: FloatArray
    place_m: FloatArray
    slope: FloatArray
    slow: FloatArray
    rgb_from_depth: Pose
    camera: FloatArray
    off_px: AnyArray
    off_s: FloatArray

    @staticmethod
    def of(view: PreparedView, odom_from_depth: Pose, motion: FloatArray, slow: FloatArray) -> Corners:
        """Return the corners of a view; none of a camera without colour.

        motion (6,), slow (2,): as in MovingImager.
        """
        grey = np.zeros((1, 1), np.uint8) if view.grey is None else view.grey
        at_px = corners_px(grey)
        values, vectors = np.linalg.eigh(structure(grey, at_px, _HALF_PX))
        turned = Pose.from_rotation_vector(slow[0] * motion[:3], np.zeros(3))
        later = Pose((turned @ odom_from_depth).quat_wxyz, odom_from_depth.translation_m + slow[0] * motion[3:])
        rgb_from_depth = (later @ view.depth_from_rgb).inverse() @ odom_from_depth
        camera = view.camera * np.array([1.0 + slow[1], 1.0 + slow[1], 1.0, 1.0])
        corners = Corners(
            grey, at_px, _shown(values, vectors), np.full((len(at_px), 3), np.nan), np.empty((len(at_px), 3, 2)), slow.copy(),
            rgb_from_depth, camera, np.zeros_like(at_px), np.full(len(at_px), -np.inf),
        )  # fmt: skip
        corners.place(view.depth)
        turn = odom_from_depth.rotation()
        swept = motion[3:] + np.cross(motion[:3], corners.place_m @ turn.T)
        ahead = rgb_from_depth.apply(corners.place_m)
        ahead[:, 2] = 0.0
        corners.slope = np.stack((swept @ turn, -ahead @ rgb_from_depth.rotation()), axis=2)
        return corners

    def place(self, image: DepthImage) -> None:
        """Take the places from the depth image of the keyframe, where it shows one surface."""
        places = corner_places(
            self.at_px,
            self.camera,
            image.depth_m,
            image.camera,
            self.rgb_from_depth.rotation(),
            self.rgb_from_depth.translation_m,
        )
        places = self.rgb_from_depth.inverse().apply(places)
        known = np.isfinite(places[:, 0])
        self.place_m[known] = places[known]

    def expected(
        self, turn: FloatArray, origin_m: FloatArray, view: PreparedView, imager: MovingImager, slow: FloatArray
    ) -> Expected:
        """Return the corners that a view is expected to show as the keyframe did.

        turn (3, 3), origin_m (3,): pose of the keyframe in odom. slow (2,): as in MovingImager.
        """
        if view.grey is None or view.grey.shape != self.grey.shape:
            return Expected(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 2), np.float32))
        out = Expected(np.empty(FOLLOWED, np.int64), np.empty((FOLLOWED, 3)), np.empty((FOLLOWED, 2), np.float32))
        corners = KeyframeCorners(turn, origin_m, self.place_m, self.slope, self.off_px, self.off_s)
        height, width = self.grey.shape
        found = expect(corners, slow - self.slow, imager, view.frame.stamp_s, height, width, out)
        return Expected(out.which[:found], out.place_m[:found], out.at_px[:found])

    def follow(self, view: PreparedView, keyframe: int, turn: FloatArray, expected: Expected) -> Landmarks:
        """Return the landmarks that a view shows. About 1 ms.

        keyframe: as in Landmarks. turn (3, 3): of the keyframe in odom.
        """
        if view.grey is None or not len(expected.which):
            return Landmarks.none()
        was_px = self.at_px[expected.which]
        at_px, found = followed(
            self.grey,
            view.grey,
            was_px,
            expected.at_px,
            window_px=_WINDOW_PX,
            levels=_LEVELS,
            back_levels=0,
            returns_px=_RETURNS_PX,
        )
        which = expected.which[found]
        slope = np.matmul(turn, self.slope[which])
        number = np.full(len(which), keyframe, np.int64)
        return Landmarks(expected.place_m[found], slope, at_px[found], self.texture[which], number, which)

    def remember(self, which: IntArray, off_px: AnyArray, stamp_s: float) -> None:
        """Remember where an accepted image shows landmarks.

        off_px (N, 2): by how much elsewhere than its pose expects them.
        """
        self.off_px[which], self.off_s[which] = off_px, stamp_s


def corners_px(grey: ByteArray) -> AnyArray:
    """Return the corners (N, 2) float32 of an image that are stronger than its noise."""
    found = cv2.goodFeaturesToTrack(grey, MOST, _CORNER_QUALITY, _APART_PX, blockSize=_BLOCK_PX)
    at_px = np.empty((0, 2), np.float32) if found is None else found.reshape(-1, 2).astype(np.float32)
    at_px = at_px[inside(at_px, grey, _WINDOW_PX)]
    grid = np.stack(np.meshgrid(*(np.arange(_GRID_PX // 2, size, _GRID_PX) for size in grey.shape[::-1])), axis=-1)
    weaker = np.linalg.eigvalsh(structure(grey, grid.reshape(-1, 2).astype(np.float32), _HALF_PX))[:, 0]
    noise = float(np.quantile(weaker, _PLAIN_SHARE)) if len(weaker) else 0.0
    strong = np.linalg.eigvalsh(structure(grey, at_px, _HALF_PX))[:, 0] > max(_MIN_TEXTURE, _ABOVE_NOISE * noise)
    return at_px[strong]


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


class KeyframeCorners(NamedTuple):
    """Corners of a keyframe, for kernels.

    turn (3, 3), origin_m (3,): pose of the depth imager in odom. Others: as in Corners.
    """

    turn: AnyArray
    origin_m: AnyArray
    place_m: AnyArray
    slope: AnyArray
    off_px: AnyArray
    off_s: AnyArray


@kernel
def expect(
    corners: KeyframeCorners, change: AnyArray, imager: MovingImager, stamp_s: float, height: int, width: int, out: Expected
) -> int:
    """Write the first corners of a keyframe that an image (height, width) should show.

    As the keyframe showed them. change (2,): of ``slow`` since their places were right.
    Returns their number, at most that for which ``out`` has room.
    """
    pixel, columns, place_m, room_px, found = np.empty(2), np.empty((2, SIZE)), np.empty(3), _WINDOW_PX // 2, 0
    for n in range(corners.place_m.shape[0]):
        if found == out.which.shape[0]:
            break
        for a in range(3):
            place_m[a] = corners.origin_m[a]
            for b in range(3):
                moved_m = corners.slope[n, b, 0] * change[0] + corners.slope[n, b, 1] * change[1]
                place_m[a] += corners.turn[a, b] * (corners.place_m[n, b] + moved_m)
        if not (_is_alike(place_m, corners.origin_m, imager.eye_m) and _row(place_m, imager, pixel, columns) >= _NEAREST_M):
            continue
        if stamp_s - corners.off_s[n] <= _LATE_S:
            pixel += corners.off_px[n]
        u, v = np.float32(pixel[0]), np.float32(pixel[1])
        if room_px <= u <= width - 1 - room_px and room_px <= v <= height - 1 - room_px:
            out.which[found], out.place_m[found] = n, place_m
            out.at_px[found, 0], out.at_px[found, 1] = u, v
            found += 1
    return found


@kernel
def _is_alike(place_m: AnyArray, eye_m: AnyArray, other_m: AnyArray) -> bool:
    """Return True if a place (3,) looks alike from two points (3,).

    It is about as large from both, and seen from about the same side.
    """
    along = one = other = 0.0
    for a in range(3):
        p, q = place_m[a] - eye_m[a], place_m[a] - other_m[a]
        along, one, other = along + p * q, one + p * p, other + q * q
    alike = _LEAST_SIZE * _LEAST_SIZE * one < other < one / (_LEAST_SIZE * _LEAST_SIZE)
    return bool(alike and along > _ALIKE_COS * np.sqrt(one * other))


@kernel
def add_landmark_equations(
    landmarks: Landmarks,
    imager: MovingImager,
    change: AnyArray,
    weight: float,
    wider: float,
    information: AnyArray,
    gradient: AnyArray,
    shown: AnyArray,
    fitting: AnyArray,
) -> None:
    """Add the normal equations (SIZE) of landmarks that the image shows.

    change (2,): of ``slow`` since their places were right. weight: of one landmark. information (M, SIZE, SIZE), gradient (M,
    SIZE): from each keyframe. shown (M, 3, 3): information on the translation that the landmarks of each keyframe would give if
    they were perfect corners. fitting (M,): number of them that fit. The first six elements are those of add_depth_equations.
    """
    place_m, slope, texture, keyframe = landmarks.place_m, landmarks.slope, landmarks.texture, landmarks.keyframe
    at_px, expected, columns = landmarks.at_px, np.empty(2), np.empty((2, SIZE))
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
        shrink = 1.0 / (1.0 + square / (wider * wider))
        fitting[keyframe[n]] += int(square < 1.0)
        k, w = keyframe[n], weight * shrink * shrink / (_SIGMA_PX * _SIGMA_PX)
        for a in range(SIZE):
            gradient[k, a] += w * (columns[0, a] * shown0 + columns[1, a] * shown1)
            along0, along1 = t00 * columns[0, a] + t01 * columns[1, a], t01 * columns[0, a] + t11 * columns[1, a]
            for b in range(SIZE):
                information[k, a, b] += w * (along0 * columns[0, b] + along1 * columns[1, b])
        for a in range(3):
            for b in range(3):
                shown[k, a, b] += w * (columns[0, 3 + a] * columns[0, 3 + b] + columns[1, 3 + a] * columns[1, 3 + b])


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


@kernel
def structure(grey: AnyArray, at_px: AnyArray, half_px: int) -> AnyArray:
    """Return the mean products of the gradients (N, 2, 2) around pixels (N, 2).

    Of an image (h, w) of brightness 0 to 1.
    """
    out = np.zeros((at_px.shape[0], 2, 2))
    height, width = grey.shape
    for n in range(at_px.shape[0]):
        u, v, number = int(np.rint(at_px[n, 0])), int(np.rint(at_px[n, 1])), 0
        for j in range(max(v - half_px, 1), min(v + half_px + 1, height - 1)):
            for i in range(max(u - half_px, 1), min(u + half_px + 1, width - 1)):
                dx = dy = 0.0
                for k in range(-1, 2):  # Sobel
                    w = (2 - abs(k)) / 2040.0
                    dx += w * (float(grey[j + k, i + 1]) - float(grey[j + k, i - 1]))
                    dy += w * (float(grey[j + 1, i + k]) - float(grey[j - 1, i + k]))
                out[n, 0, 0] += dx * dx
                out[n, 0, 1] += dx * dy
                out[n, 1, 1] += dy * dy
                number += 1
        out[n, 1, 0] = out[n, 0, 1]
        out[n] /= max(number, 1)
    return out


def _shown(values: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return Landmarks.texture (N, 2, 2).

    values (N, 2), vectors (N, 2, 2): eigenvalues and eigenvectors of structure().
    """
    ratio = values / values.max(axis=1, keepdims=True)
    share = np.clip((ratio - _EDGE_SHARE) / (_CORNER_SHARE - _EDGE_SHARE), 0.0, 1.0) ** 2
    return np.asarray(np.einsum("nak,nk,nbk->nab", vectors, share, vectors))
