"""Map of an earlier flight: keyframes with corners and depth, in which a view is placed.

A view is placed where the corners of one keyframe agree (ORB and P3P), and the surfaces of all keyframes confirm it. Both maps
stand upright: a place with another vertical is wrong.
"""

from __future__ import annotations

import hashlib
import io
import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from uav_recon.localization.slam.depth_image import grid_points, write_normals
from uav_recon.localization.slam.keyframe_map import SHOWN, THROUGH, KeyframeMap, Keyframes, pose_of, shown_points
from uav_recon.localization.slam.place_recognition import FARTHEST_BITS, UnplacedView
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.types.frames import AnyArray, FloatArray, IntArray
from uav_recon.types.pose import Pose

_FORMAT = 1
_POSES = ("camera", "rotation", "place_m", "variance")  # arrays of Keyframes in the file
_ARRAYS = {"depth", *_POSES, "first", "bits", "corners_m"}
_M_PER_UNIT = 1e-3  # depth in the file
_DIGEST_BYTES = 32  # of a file, before its arrays: a damaged file is refused before it is parsed
_DESCRIPTOR_BYTES = 32
_NEAREST = 4  # corners of the map that each corner of a view votes for
_TRIED = 6  # keyframes with most votes
_MAX_TILT_RAD = math.radians(4.0)  #: reject: the vertical of a place differs by more
_TRIED_POINTS = 300  # of the depth of a view, which the surfaces must confirm
_LEAST_SHOWN_SHARE = 0.5  #: reject: the surfaces of an earlier flight show less of a view from its place
_MOST_THROUGH_SHARE = 0.1  #: reject: they contradict more of what both have seen


class ForeignMapError(ValueError):
    """Bytes that are not a map of a flight; the message is short."""


@dataclass(frozen=True, slots=True, eq=False)
class FlownMap:
    """Map of N keyframes, in the odom frame of its flight, which began at the origin. Immutable.

    keyframes: all of them. first (N + 1,): of the corners of each. bits (K, 32): descriptors of corners. corners_m (K, 3):
    their places in the frame of the depth imager of their keyframe.
    """

    keyframes: Keyframes
    first: IntArray
    bits: AnyArray
    corners_m: FloatArray

    @property
    def count(self) -> int:
        """Number of keyframes."""
        return len(self.first) - 1

    @staticmethod
    def from_bytes(data: bytes) -> FlownMap:
        """Return the map in a file. About 0.5 s for 200 keyframes. Raises ForeignMapError."""
        digest, content = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
        if hashlib.sha256(content).digest() != digest:
            raise ForeignMapError("not the map of a flight, or damaged")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name]) for name in file.files}
        if int(arrays.get("format", 0)) != _FORMAT or not (arrays.keys() >= _ARRAYS and _is_whole(arrays)):
            raise ForeignMapError("of another version")
        depth_m = arrays["depth"].astype(np.float32) * np.float32(_M_PER_UNIT)
        normal = np.zeros((*depth_m.shape, 3), np.float32)
        for image_m, camera, normals in zip(depth_m, arrays["camera"], normal, strict=True):
            write_normals(image_m, camera, normals)
        keyframes = Keyframes(np.arange(len(depth_m)), depth_m, normal, *(arrays[name] for name in _POSES))
        return FlownMap(keyframes, arrays["first"], arrays["bits"], arrays["corners_m"].astype(np.float64))

    def place(self, view: PreparedView, odom_from_depth: Pose) -> Pose | None:
        """Return earlier_from_odom, upright; None if no keyframe is found in the view.

        odom_from_depth: of the view, in odom of this flight. About 20 ms for 150 keyframes.
        """
        unplaced = UnplacedView(view)
        for n in self._likely(unplaced.bits).tolist():
            of = slice(int(self.first[n]), int(self.first[n + 1]))
            found = unplaced.place(self.bits[of], self.corners_m[of], pose_of(self.keyframes, n))
            upright = None if found is None else _upright(found, odom_from_depth)
            if upright is not None and self._confirms(view, upright @ odom_from_depth):
                return upright
        return None

    def _likely(self, bits: AnyArray) -> IntArray:
        """Return the keyframes that have most of the corners nearest to those of a view.

        Most first. bits (N, 32).
        """
        if not len(bits) or not len(self.bits):
            return np.empty(0, np.int64)
        nearest = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(bits, self.bits, k=_NEAREST)
        which = np.array([m.trainIdx for row in nearest for m in row if m.distance <= FARTHEST_BITS], np.int64)
        votes = np.bincount(np.searchsorted(self.first, which, side="right") - 1, minlength=self.count)
        order = np.argsort(-votes, kind="stable")[:_TRIED]
        return np.asarray(order[votes[order] > 0])

    def _confirms(self, view: PreparedView, earlier_from_depth: Pose) -> bool:
        """Return True if the surfaces show the depth of a view from there, and hardly contradict it."""
        points_m = grid_points(view.depth.depth_m, view.depth.camera, _TRIED_POINTS)
        if not len(points_m):
            return False
        looked = shown_points(earlier_from_depth.apply(points_m), earlier_from_depth.translation_m, self.keyframes, 0.0)
        shown = (looked == SHOWN).any(axis=0)
        through = (looked == THROUGH).any(axis=0) & ~shown
        seen = int(shown.sum() + through.sum())
        return bool(shown.mean() >= _LEAST_SHOWN_SHARE and through.sum() <= _MOST_THROUGH_SHARE * seen)


def copied(surfaces: KeyframeMap) -> dict[str, AnyArray]:
    """Return a copy of what a file holds of a tracker's map. About 20 ms for 150 keyframes."""
    every, count = surfaces.every(), surfaces.count
    bits, corners_m, first = [np.empty((0, _DESCRIPTOR_BYTES), np.uint8)], [np.empty((0, 3))], [0]
    for number in range(count):
        described, place_m = surfaces.described(number)
        known = np.isfinite(place_m[:, 0])
        bits.append(described[known])
        corners_m.append(place_m[known])
        first.append(first[-1] + int(known.sum()))
    poses = {name: getattr(every, name)[:count].copy() for name in _POSES}
    depth = np.rint(every.depth_m[:count] / np.float32(_M_PER_UNIT)).astype(np.uint16)
    corners = {
        "first": np.array(first),
        "bits": np.concatenate(bits),
        "corners_m": np.concatenate(corners_m).astype(np.float32),
    }
    return {"format": np.array(_FORMAT), "depth": depth, **poses, **corners}


def file_of(arrays: dict[str, AnyArray]) -> bytes:
    """Return the content of a file of a copied map.

    About 1 s for 150 keyframes; it can run on any thread.
    """
    out = io.BytesIO()
    named: dict[str, Any] = dict(arrays)  # numpy's own keywords have other types
    np.savez_compressed(out, **named)
    return hashlib.sha256(out.getvalue()).digest() + out.getvalue()


def _is_whole(arrays: dict[str, AnyArray]) -> bool:
    """Return True if the arrays of a file fit together."""
    count, corners, first = len(arrays["depth"]), len(arrays["bits"]), arrays["first"]
    kinds: dict[str, tuple[str, tuple[int, ...]]] = {
        "depth": ("uint16", (count, *arrays["depth"].shape[1:3])), "camera": ("float64", (count, 4)),
        "rotation": ("float64", (count, 3, 3)), "place_m": ("float64", (count, 3)), "variance": ("float64", (count, 3)),
        "first": ("int64", (count + 1,)), "bits": ("uint8", (corners, _DESCRIPTOR_BYTES)),
        "corners_m": ("float32", (corners, 3)),
    }  # fmt: skip
    fits = all((str(arrays[name].dtype), arrays[name].shape) == kind for name, kind in kinds.items())
    if not fits or arrays["depth"].ndim != 3:
        return False
    finite = all(np.isfinite(arrays[name]).all() for name in (*_POSES, "corners_m")) and (arrays["camera"][:, :2] > 0.0).all()
    return bool(finite and first[0] == 0 and (np.diff(first) >= 0).all() and first[-1] == corners)


def _upright(earlier_from_depth: Pose, odom_from_depth: Pose) -> Pose | None:
    """Return earlier_from_odom, upright; None if the verticals differ."""
    turned = (earlier_from_depth @ odom_from_depth.inverse()).rotation()
    if math.acos(min(max(float(turned[2, 2]), -1.0), 1.0)) > _MAX_TILT_RAD:
        return None
    turn = Pose.from_yaw(math.atan2(turned[1, 0], turned[0, 0]), np.zeros(3))
    return Pose(turn.quat_wxyz, earlier_from_depth.translation_m - turn.apply(odom_from_depth.translation_m))
