"""Map of the tracker: keyframes with depth image, normals of the surfaces, and pose.

A frame that adds to what the keyframes show becomes one; another one makes the depths of the keyframe that it resembles more
exact. A keyframe holds the error of its place, too: that of the camera when it was taken.
Newcombe et al. 2011, KinectFusion, for projective data association; Kerl, Sturm and Cremers 2013, Dense Visual SLAM for RGB-D
Cameras, for the choice of keyframes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import fast_kernel
from uav_recon.localization.slam.depth_image import DepthImage, grid_points, write_normals
from uav_recon.localization.slam.landmarks import Corners, Landmarks, moving_imager, project
from uav_recon.localization.slam.place_recognition import Description, UnplacedView
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.types.frames import AnyArray, BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.pose import Pose

SHOWN, THROUGH = 1, 2  # what a keyframe says of a point
NEAREST_M = 0.1  # a point nearer to the plane of an imager is not in its image
_FIRST_CAPACITY = 32
_NEW_SHARE = 0.75  # a frame of which no keyframe shows more than this becomes one
_FEW_LANDMARKS = 60  # a frame in which fewer fit becomes a keyframe, if it is apart from the newest one ...
_MORE, _FEWEST_LANDMARKS = 1.5, 10  # ... and shows more corners than this factor of them, and this number
_APART_M = 0.1
_APART_RAD = np.radians(5.0)
_FEWEST_DEPTHS = 500  # a view with fewer returns shows no surface
_TRIED_POINTS = 100  # number that is projected into each keyframe to find what it shows
_SEEN_M = 0.10  # difference in depth of a point that a keyframe shows, and of one metre
_SEEN_PER_M = 0.02
_FAR_M = 9.0  # between cameras that show the same surfaces
_MIN_SHARE = 0.3  # of the view, which a keyframe must show to be compared with it
# a keyframe is less like a view by this share each, if it was taken from elsewhere, and in another direction, by this or more
_OTHER_SHARE = 0.3
_OTHER_M = 1.0
_OTHER_RAD = 0.6
_LEAST_LIKE = 0.01  # but it is still one of the same surfaces
_COMPARED = 3  # number of keyframes that a frame is compared with
_LEAST_MORE_SHARE = 0.1  # of the view, that a further one must have looked at
_AGAIN_SHARE = 0.25  # worth of what another one has looked at already
_SURE_M2 = 0.02**2  # variance of a place that halves the worth
_CANDIDATES = 12  # keyframes that show most of a view, of which the one with most of its landmarks is one more
_MAX_TURN_RAD = np.radians(6.0)  # between the pose that a keyframe's corners give and the predicted attitude
_TRIED_KEYFRAMES = 4  # that may show a view whose place is not known, and as many of the others
_MOST_FUSED = 20.0  # depths in a mean
_FUSED_M = 0.02  # difference of depths that are fused, and per square metre of range
_FUSED_PER_M2 = 0.01
# share of the variance of a view, less than which, and by at least how much, a keyframe is known better than the view shows it
_BETTER_SHARE = 0.25
_ALIKE_M2 = 0.02**2


class Keyframes(NamedTuple):
    """Keyframes that a frame is compared with, for kernels.

    number (M,): of their images in depth_m (N, H, W) and normal (N, H, W, 3). camera (M, 4): as in DepthImage. rotation
    (M, 3, 3), place_m (M, 3): pose of the depth imager in odom. variance (M, 3): of the place, m² along the axes of odom.
    """

    number: AnyArray
    depth_m: AnyArray
    normal: AnyArray
    camera: AnyArray
    rotation: AnyArray
    place_m: AnyArray
    variance: AnyArray


class KeyframeMap:
    """The keyframes in odom. Not thread-safe. ``count``: number of keyframes."""

    def __init__(self) -> None:
        self.count = 0
        self._all = no_keyframes()
        self._fused = np.zeros((0, 1, 1), np.float32)
        self._looks = np.zeros(0, np.int64)
        self._corners: list[Corners] = []
        self._descriptions: list[Description] = []
        self._next = 0  # keyframe that is tried next

    def near(self, image: DepthImage, odom_from_depth: Pose, reach_m: float, most_variance: float) -> Keyframes:
        """Return the keyframes to compare a depth image with.

        reach_m: by which its pose may be off. most_variance: of their places, m².
        """
        looked = self._looked_at(image, odom_from_depth, reach_m) > 0
        looked[self._all.variance[: self.count].max(axis=1, initial=0.0) > most_variance] = False
        return self._chosen(self._covering(looked, self._like(looked, odom_from_depth)))

    def near_view(
        self, view: PreparedView, odom_from_depth: Pose, motion: FloatArray, slow: FloatArray
    ) -> tuple[Keyframes, Landmarks]:
        """Return the keyframes to compare a view with, and their landmarks that it shows.

        About 1 ms a keyframe.
        odom_from_depth: the predicted pose. motion (6,), slow (2,): as in MovingImager.
        """
        looked = self._looked_at(view.depth, odom_from_depth, 0.0) > 0
        imager = moving_imager(view, odom_from_depth, motion, slow)
        like = self._like(looked, odom_from_depth)
        candidates = _most(like)
        rotation, place_m = self._all.rotation, self._all.place_m
        shown = {
            number: self._corners[number].expected(rotation[number], place_m[number], view, imager, slow)
            for number in candidates.tolist()
        }
        chosen = self._covering(looked, like)
        if shown:
            best = max(shown, key=lambda number: len(shown[number].which))
            chosen = chosen if best in chosen else np.append(chosen, best)
        keyframes = self._chosen(chosen)
        followed = [
            self._corners[number].follow(view, m, rotation[number], shown[number])
            for m, number in enumerate(chosen.tolist())
            if number in shown
        ]
        found = [Landmarks.none(), *followed]
        return keyframes, Landmarks(*(np.concatenate(parts) for parts in zip(*found, strict=True)))

    def recognise(self, view: PreparedView, predicted: Pose, reach_m: float, most_variance: float) -> Pose | None:
        """Return odom_from_depth of a view whose place is not known; None if no keyframe fits.

        By the corners of one keyframe.
        predicted: its pose, off by up to reach_m. Keyframes that may show the same are tried first, and a few of the others.
        most_variance: of their places, m². About 10 ms.
        """
        share = _share(self._looked_at(view.depth, predicted, reach_m) == SHOWN)
        others = (self._next + np.arange(min(_TRIED_KEYFRAMES, self.count))) % max(self.count, 1)
        self._next += _TRIED_KEYFRAMES
        unplaced = UnplacedView(view)
        for number in np.concatenate((_most(share, _MIN_SHARE, _TRIED_KEYFRAMES), others)).tolist():
            if self._all.variance[number].max() <= most_variance:
                pose = unplaced.place(*self.described(number), self.pose(number))
                if pose is not None and np.linalg.norm((pose @ predicted.inverse()).rotation_vector()) < _MAX_TURN_RAD:
                    return pose
        return None

    def described(self, number: int) -> tuple[ByteArray, FloatArray]:
        """Return descriptors (K, 32) and places (K, 3) of the corners of a keyframe.

        The places are in the frame of its depth imager, NaN where not known.
        """
        description = self._descriptions[number]
        return description.bits, self._corners[number].place_m[description.which]

    def every(self) -> Keyframes:
        """Return all keyframes; they change with the map."""
        return self._chosen(np.arange(self.count))

    def _like(self, looked: BoolArray, odom_from_depth: Pose) -> FloatArray:
        """Return how much each keyframe is like a view, (N,).

        The share of the view that it has looked at, less for another viewpoint.
        looked (N, P): at which of its points each keyframe has looked.
        """
        way_m = np.linalg.norm(self._all.place_m[: self.count] - odom_from_depth.translation_m, axis=1)
        ahead = self._all.rotation[: self.count, :, 2] @ odom_from_depth.rotation()[:, 2]
        apart = np.minimum(way_m / _OTHER_M, 1.0) + np.minimum(np.arccos(np.clip(ahead, -1.0, 1.0)) / _OTHER_RAD, 1.0)
        whole = _share(looked)
        return np.asarray(np.where(whole >= _MIN_SHARE, np.maximum(whole - _OTHER_SHARE * apart, _LEAST_LIKE), 0.0))

    def _covering(self, looked: BoolArray, like: FloatArray) -> IntArray:
        """Return the numbers (M,) of keyframes to compare a view with.

        The one that is most like the view, and those that add most to it.
        looked (N, P): at which of its points each keyframe has looked. like (N,): of _like(). A keyframe that is known better
        counts more.
        """
        whole = _share(looked)
        sure = 1.0 / (1.0 + self._all.variance[: self.count].max(axis=1, initial=0.0) / _SURE_M2)
        chosen, left = list[int](), np.ones(looked.shape[1], np.bool_)
        while len(chosen) < min(_COMPARED, self.count):
            adds = (looked[:, left].sum(axis=1) / max(len(left), 1) + _AGAIN_SHARE * whole) * sure
            worth = np.where(whole >= _LEAST_MORE_SHARE, adds if chosen or not like.any() else like, 0.0)
            worth[chosen] = 0.0
            best = int(np.argmax(worth))
            if worth[best] <= 0.0:
                break
            chosen.append(best)
            left &= ~looked[best]
        return np.array(chosen, np.int64)

    def pose(self, number: int) -> Pose:
        """Return odom_from_depth of a keyframe."""
        return pose_of(self._all, number)

    def remember(
        self,
        view: PreparedView,
        keyframes: Keyframes,
        landmarks: Landmarks,
        odom_from_depth: Pose,
        motion: FloatArray,
        slow: FloatArray,
    ) -> None:
        """Remember where an accepted view shows landmarks of keyframes.

        Other arguments: as of near_view().
        """
        off_px = landmarks.at_px - project(landmarks.place_m, moving_imager(view, odom_from_depth, motion, slow))
        for m, number in enumerate(keyframes.number.tolist()):
            of = landmarks.keyframe == m
            self._corners[number].remember(landmarks.corner[of], off_px[of], view.frame.stamp_s)

    def add(
        self,
        view: PreparedView,
        odom_from_depth: Pose,
        motion: FloatArray,
        slow: FloatArray,
        variance: FloatArray,
        landmarks: int,
    ) -> bool:
        """Take an accepted view; return True if it has become a keyframe.

        About 1 ms, 5 ms for a keyframe.
        motion (6,), slow (2,): as in MovingImager. variance (3,): of the place of the camera, m² along the axes of odom. A
        keyframe that is known much better stays as it is. landmarks: number that fit.
        """
        image = view.depth
        if np.count_nonzero(image.depth_m) < _FEWEST_DEPTHS:
            return False
        share = _share(self._looked_at(image, odom_from_depth, 0.0) == SHOWN)
        best = int(np.argmax(share)) if self.count else 0
        new = not self.count or share[best] < _NEW_SHARE
        corners = None
        if new or (landmarks < _FEW_LANDMARKS and self._is_apart(odom_from_depth)):
            corners = Corners.of(view, odom_from_depth, motion, slow)
            new = new or len(corners.at_px) > _MORE * landmarks + _FEWEST_LANDMARKS
        if new and corners is not None:
            self._append(image, odom_from_depth, variance)
            self._corners.append(corners)
            self._descriptions.append(Description.of(corners.grey, corners.at_px))
            return True
        if not self._all.variance[best].max() < _BETTER_SHARE * variance.max() - _ALIKE_M2:
            self._fuse(best, image, odom_from_depth)
        return False

    def move(self, moved_m: FloatArray, variance: FloatArray) -> None:
        """Correct the places of the keyframes by (N, 3); variance (N, 3): what they have then."""
        self._all.place_m[: self.count] += moved_m
        self._all.variance[: self.count] = variance

    def keep(self, count: int) -> None:
        """Forget all but the first keyframes."""
        self.count = count
        del self._corners[count:], self._descriptions[count:]

    def _is_apart(self, odom_from_depth: Pose) -> bool:
        """Return True if the newest keyframe was taken from elsewhere."""
        moved = self.pose(self.count - 1).inverse() @ odom_from_depth
        return bool(np.linalg.norm(moved.translation_m) > _APART_M or np.linalg.norm(moved.rotation_vector()) > _APART_RAD)

    def _looked_at(self, image: DepthImage, odom_from_depth: Pose, reach_m: float) -> AnyArray:
        """Return what each keyframe says of points of a view, (N, P).

        SHOWN, THROUGH, or 0 for nothing.
        """
        points_m = grid_points(image.depth_m, image.camera, _TRIED_POINTS)
        return shown_points(odom_from_depth.apply(points_m), odom_from_depth.translation_m, self.every(), reach_m)

    def _chosen(self, number: IntArray) -> Keyframes:
        every = self._all
        return Keyframes(
            number, every.depth_m, every.normal, every.camera[number], every.rotation[number], every.place_m[number],
            every.variance[number],
        )  # fmt: skip

    def _append(self, image: DepthImage, odom_from_depth: Pose, variance: FloatArray) -> None:
        if not self.count:
            self._all, self._fused = no_keyframes(image.depth_m.shape), np.zeros((0, *image.depth_m.shape), np.float32)
        if self.count == len(self._all.place_m):
            self._grow()
        n, arrays = self.count, self._all
        rows, columns = (min(a, b) for a, b in zip(image.depth_m.shape, arrays.depth_m.shape[1:], strict=True))
        arrays.depth_m[n, :rows, :columns] = image.depth_m[:rows, :columns]
        arrays.camera[n], arrays.rotation[n], arrays.place_m[n] = (
            image.camera,
            odom_from_depth.rotation(),
            odom_from_depth.translation_m,
        )
        arrays.variance[n] = variance
        write_normals(arrays.depth_m[n], image.camera, arrays.normal[n])
        self._fused[n] = 1.0
        self._looks[n] = 1
        self.count += 1

    def _grow(self) -> None:
        more = max(len(self._all.place_m), _FIRST_CAPACITY)
        self._all = Keyframes(
            np.zeros(0, np.int64),
            *(np.concatenate((array, np.zeros((more, *array.shape[1:]), array.dtype))) for array in self._all[1:]),
        )
        self._fused = np.concatenate((self._fused, np.zeros((more, *self._fused.shape[1:]), np.float32)))
        self._looks = np.concatenate((self._looks, np.zeros(more, np.int64)))

    def _fuse(self, number: int, image: DepthImage, odom_from_depth: Pose) -> None:
        arrays = self._all
        rotation, place_m = odom_from_depth.rotation(), odom_from_depth.translation_m
        turn = rotation.T @ arrays.rotation[number]
        moved_m = rotation.T @ (arrays.place_m[number] - place_m)
        fuse_depth(
            arrays.depth_m[number],
            arrays.normal[number],
            self._fused[number],
            arrays.camera[number],
            turn,
            moved_m,
            image.depth_m,
            image.camera,
        )
        self._looks[number] += 1
        looks = int(self._looks[number])
        if looks & (looks - 1) == 0:
            write_normals(arrays.depth_m[number], arrays.camera[number], arrays.normal[number])
            self._corners[number].place(DepthImage(arrays.depth_m[number], arrays.camera[number]))


def pose_of(keyframes: Keyframes, number: int) -> Pose:
    """Return odom_from_depth of one of the keyframes."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = keyframes.rotation[number], keyframes.place_m[number]
    return Pose.from_matrix(matrix)


def _share(of: BoolArray) -> FloatArray:
    """Return the share (N,) of the points of a view (N, P), 0 of a view without any."""
    return np.asarray(of.sum(axis=1) / max(of.shape[1], 1))


def _most(share: FloatArray, least: float = 0.0, most: int = _CANDIDATES) -> IntArray:
    """Return the numbers of the largest shares (N,), largest first."""
    order = np.argsort(-share, kind="stable")[:most]
    return np.asarray(order[share[order] > least])


def no_keyframes(shape: tuple[int, ...] = (1, 1)) -> Keyframes:
    """Return no keyframes, of images of this shape."""
    images = np.zeros((0, *shape), np.float32)
    return Keyframes(
        number=np.zeros(0, np.int64), depth_m=images, normal=np.zeros((0, *shape, 3), np.float32), camera=np.zeros((0, 4)),
        rotation=np.zeros((0, 3, 3)), place_m=np.zeros((0, 3)), variance=np.zeros((0, 3)),
    )  # fmt: skip


@fast_kernel
def shown_points(points_m: AnyArray, eye_m: AnyArray, keyframes: Keyframes, reach_m: float) -> AnyArray:
    """Return what each keyframe says of points (N, 3) in odom, (M, N).

    They are seen from eye_m (3,).
    SHOWN: it shows the point. THROUGH: it contradicts it. reach_m: by which the points may be off.
    """
    out = np.zeros((keyframes.number.shape[0], points_m.shape[0]), np.int8)
    for m in range(keyframes.number.shape[0]):
        turn, place_m, camera = keyframes.rotation[m], keyframes.place_m[m], keyframes.camera[m]
        depth_m, normal = keyframes.depth_m[keyframes.number[m]], keyframes.normal[keyframes.number[m]]
        apart2 = (place_m[0] - eye_m[0]) ** 2 + (place_m[1] - eye_m[1]) ** 2 + (place_m[2] - eye_m[2]) ** 2
        if apart2 > _FAR_M * _FAR_M:
            continue
        for n in range(points_m.shape[0]):
            x, y, z = points_m[n, 0] - place_m[0], points_m[n, 1] - place_m[1], points_m[n, 2] - place_m[2]
            deep = turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z
            if deep < NEAREST_M:
                continue
            u = int(np.floor((turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z) / deep * camera[0] + camera[2] + 0.5))
            v = int(np.floor((turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z) / deep * camera[1] + camera[3] + 0.5))
            if not (0 <= v < depth_m.shape[0] and 0 <= u < depth_m.shape[1]):
                continue
            seen, facing = float(depth_m[v, u]), 0.0  # not the other side of a thin wall
            for a in range(3):
                along = turn[a, 0] * normal[v, u, 0] + turn[a, 1] * normal[v, u, 1] + turn[a, 2] * normal[v, u, 2]
                facing += along * (eye_m[a] - points_m[n, a])
            near_m = _SEEN_M + reach_m + _SEEN_PER_M * seen
            if facing >= 0.0 and seen > 0.0 and abs(seen - deep) < near_m:
                out[m, n] = SHOWN
            elif seen - deep >= near_m:
                out[m, n] = THROUGH
    return out


@fast_kernel
def fuse_depth(
    depth_m: AnyArray,
    normal: AnyArray,
    fused: AnyArray,
    camera: AnyArray,
    turn: AnyArray,
    moved_m: AnyArray,
    other_m: AnyArray,
    other: AnyArray,
) -> None:
    """Take another depth image into that of a keyframe, where both show the same surface.

    normal (H, W, 3): of the keyframe. fused (H, W): number of depths in each mean. camera (4,), other (4,): of keyframe and
    image. turn (3, 3), moved_m (3,): pose of the keyframe in the frame of the image.
    """
    for v in range(depth_m.shape[0]):
        for u in range(depth_m.shape[1]):
            z = float(depth_m[v, u])
            if z <= 0.0:
                continue
            x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
            deep = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + moved_m[2]
            if deep < NEAREST_M:
                continue
            across = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + moved_m[0]
            down = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + moved_m[1]
            i = int(np.floor(across / deep * other[0] + other[2] + 0.5))
            j = int(np.floor(down / deep * other[1] + other[3] + 0.5))
            if not (0 <= j < other_m.shape[0] and 0 <= i < other_m.shape[1]):
                continue
            seen, facing = float(other_m[j, i]), 0.0  # not the other side of a thin wall
            for a in range(3):
                sight = turn[a, 0] * normal[v, u, 0] + turn[a, 1] * normal[v, u, 1] + turn[a, 2] * normal[v, u, 2]
                facing -= sight * (across if a == 0 else down if a == 1 else deep)
            if facing >= 0.0 and seen > 0.0 and abs(seen - deep) < _FUSED_M + _FUSED_PER_M2 * z * z:
                number = fused[v, u]
                depth_m[v, u] = z + (seen - deep) / (number + 1.0)
                fused[v, u] = min(number + 1.0, _MOST_FUSED)
