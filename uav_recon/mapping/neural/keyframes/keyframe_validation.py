"""Validation of keyframes: reasons for rejection, their counts, and the consistency check."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping
from enum import Enum

import numpy as np

from uav_recon.mapping.neural.keyframes.ray_records import DEPTH_FARTHEST_M, DEPTH_NEAREST_M
from uav_recon.types.camera import Intrinsics, PosedFrame
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray
from uav_recon.types.pose import Pose

LOG = logging.getLogger(__name__)

PADDING_M = 0.15  # walls lie on the border of the room's box, and noise moves points outside; more adds debris behind them
FEWEST_SHARE = 0.01  # minimum share of pixels with depth
FEWEST_RAYS = 32  # minimum number of rays from them
INSIDE_SHARE = 0.2  # minimum share of end points in the box
STRIDE = 8  # every STRIDE-th valid pixel is checked
WIDEST = 3.2  # max. bearing x/z or y/z: range of a ray record
NARROWEST = 0.04  # min. extent of an image in bearings
# minimum numbers before a view can contradict the map
FEWEST_VIEWS = 4
FEWEST_VOTES = 100
VIEW_SHARE = 0.2  # refuted share that rejects a view: in the view itself
LENS_SHARE = 0.15  # ... in the recent views of its lens
MEMORY = 0.8  # decay of the votes per view: about five views count


class RejectReason(Enum):
    """Reason why a view was rejected."""

    SHAPE = "pictures do not have the shape that their intrinsics say"
    INTRINSICS = "intrinsics that no camera has"
    POSE = "the pose is not a finite rotation and place"
    OUTSIDE = "taken from outside the box"
    EMPTY = "no depth"
    ELSEWHERE = "what it shows lies outside the box"
    EPOCH = "taken on a map that is no more"
    UNPLACED = "the new map does not say where it was taken"
    OUT_OF_MEMORY = "memory is full"
    DISAGREES = "earlier views look through what it shows: wrong intrinsics or a wrong pose"


class RejectCounts:
    """Number of rejected views by reason. A count is logged when it reaches a power of two."""

    def __init__(self) -> None:
        self.counts: Counter[RejectReason] = Counter()

    def note(self, reason: RejectReason) -> None:
        """Count one rejection, and log it if due."""
        self.counts[reason] += 1
        count = self.counts[reason]
        if count & (count - 1) == 0:
            LOG.warning("a view was refused: %s (%d so far)", reason.value, count)

    def total(self) -> int:
        """Return the count over all reasons."""
        return sum(self.counts.values())


def counts_as_text(counts: Mapping[RejectReason, int]) -> dict[str, int]:
    """Return the counts with the reasons as text."""
    return {reason.value: count for reason, count in counts.items()}


def padded_box(box_min_m: FloatArray, box_max_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mapped box: the room plus PADDING_M. Raises ValueError for an invalid box."""
    low = np.asarray(box_min_m, dtype=np.float64) - PADDING_M
    high = np.asarray(box_max_m, dtype=np.float64) + PADDING_M
    if (
        low.shape != (3,)
        or high.shape != (3,)
        or not (np.isfinite(low).all() and np.isfinite(high).all() and (high > low).all())
    ):
        raise ValueError(f"not a box: {box_min_m} to {box_max_m}")
    return low, high


def reject_reason(keyframe: PosedFrame, low_m: AnyArray, high_m: AnyArray) -> RejectReason | None:
    """Return the reason to reject a view without using the map, or None. Takes about 1 ms.

    low_m, high_m (3,): the mapped box.
    """
    frame = keyframe.frame
    lens, colour = frame.depth_intrinsics, frame.rgb_intrinsics
    if frame.depth_m.shape != (lens.height, lens.width) or frame.rgb.shape != (colour.height, colour.width, 3):
        return RejectReason.SHAPE
    if not (_possible(lens) and _possible(colour)):
        return RejectReason.INTRINSICS
    pose = keyframe.world_from_depth
    reason = pose_reject_reason(pose, low_m, high_m)
    if reason is not None:
        return reason
    valid = (frame.depth_m >= DEPTH_NEAREST_M) & (frame.depth_m <= DEPTH_FARTHEST_M)
    if valid.mean() < FEWEST_SHARE:
        return RejectReason.EMPTY
    v, u = np.nonzero(valid)
    v, u = v[::STRIDE], u[::STRIDE]
    z = frame.depth_m[v, u].astype(np.float64)
    points = np.stack([(u - lens.cx) / lens.fx * z, (v - lens.cy) / lens.fy * z, z], axis=1)
    world = pose.apply(points)
    inside = ((world > low_m) & (world < high_m)).all(axis=1)
    return RejectReason.ELSEWHERE if inside.mean() < INSIDE_SHARE else None


def pose_reject_reason(world_from_depth: Pose, low_m: AnyArray, high_m: AnyArray) -> RejectReason | None:
    """Return the reason to reject a pose, or None."""
    quat_wxyz, position = world_from_depth.quat_wxyz, world_from_depth.translation_m
    if not (np.isfinite(position).all() and abs(float(np.linalg.norm(quat_wxyz)) - 1.0) < 1e-6):
        return RejectReason.POSE
    return None if ((position > low_m) & (position < high_m)).all() else RejectReason.OUTSIDE


class ContradictionVote:
    """Detects views that contradict the map although each is valid by itself.

    The causes are a wrong focal length or a wrong pose. A point is refuted if other views measured through the point that
    this view measured, or if this view measured through their points. Correct views: at most 1 % of the judged points are
    refuted, and 7 % with poses off by 2 cm and 1°. A wrong lens is detected directly in half of its views. Its other views,
    of new positions, are rejected because of the earlier votes.
    """

    def __init__(self) -> None:
        self._lens: Intrinsics | None = None
        self._judged = 0.0
        self._refuted = 0.0

    def is_contradiction(self, lens: Intrinsics, votes: Float32Array) -> bool:
        """Return True if the view must be rejected.

        votes (N,): votes of other views on its points and of this view on theirs; see DepthVisibility.votes(). lens: depth
        intrinsics of the view.
        """
        if lens != self._lens:
            self._lens = lens
            self._judged = 0.0
            self._refuted = 0.0
        judged, refuted = int(np.count_nonzero(votes)), int(np.count_nonzero(votes < 0.0))
        self._judged = MEMORY * self._judged + judged
        self._refuted = MEMORY * self._refuted + refuted
        lately = self._judged >= FEWEST_VOTES and self._refuted >= LENS_SHARE * self._judged
        return lately or (judged >= FEWEST_VOTES and refuted >= VIEW_SHARE * judged)


def _possible(lens: Intrinsics) -> bool:
    """Return True if the intrinsics are plausible and every bearing fits into a ray record."""
    numbers = lens.pinhole_px()
    if not np.isfinite(numbers).all() or min(lens.fx, lens.fy) <= 0.0 or min(lens.width, lens.height) < 2:
        return False
    reach = np.array(
        [lens.cx / lens.fx, (lens.width - 1 - lens.cx) / lens.fx, lens.cy / lens.fy, (lens.height - 1 - lens.cy) / lens.fy]
    )
    return bool((np.abs(reach) < WIDEST).all() and reach[:2].sum() > NARROWEST and reach[2:].sum() > NARROWEST)
