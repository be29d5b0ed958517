"""Check of a recording's depth unit, by its poses and by what a camera measures.

A point that one frame shows lies on the surface that another frame shows, if depth and poses have one scale. Depth of a wrong
unit (millimetres read as 0.25 mm, as of an L515) fits with another scale: the one at which the two surfaces agree best.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from uav_recon.sensors.recordings.checked_recording import CheckedRecording
from uav_recon.types.camera import Frame
from uav_recon.types.frames import Float32Array, FloatArray
from uav_recon.types.pose import Pose, StampedPose

_FRAMES = 120  #: internal: frames looked at, at most
_APART_S = 0.25  #: internal: time between two of them, at most
_WIDTH_PX = 160  #: internal: the images are thinned to this width
_POINT_STEP = 4  #: internal: of the pixels of a thinned image, those that are compared
_PAIRS = 24  #: internal: pairs of frames that are compared
_BASELINES_M = (0.05, 0.5)  #: internal: distance between the two frames of a pair
_TURN_RAD = math.radians(20.0)  #: internal: turn between them at most
_POSE_GAP_S = 0.25  #: internal: a frame between two poses that are farther apart is not compared
_SCALES = np.geomspace(1 / 30, 30.0, 171)  # those that are tried, 4 % apart
#: internal: a distance between two surfaces of a larger share of the range counts as this: something is hidden
_CLIPPED_SHARE = 0.1
_LANDED_SHARE = 0.25  #: internal: a pair of which fewer points land on depth tells nothing
_GROUPS = 4  #: internal: groups of pairs, each with an estimate of its own
_BESIDE_FACTOR = 1.3  #: internal: a scale that fits is compared with those that differ by this factor
_CLEAR_SHARE = 0.9  #: internal: of the distance there, that of a scale that fits is at most this share
_FITTING_FACTOR = (0.95, 1.05)  #: warn: a scale outside of which the depth does not fit the poses
_UNITS_M = (0.0001, 0.0002, 0.00025, 0.0005, 0.001, 1.0)  #: internal: units of known devices and formats, in metres
_SAME_UNIT_SHARE = 0.06  #: internal: an estimate within this share of such a unit names it
_OUTSIDE_SHARE = 0.8  #: warn: this share of the depth is nearer or farther than the camera's range


def depth_unit_remarks(recording: CheckedRecording) -> list[str]:
    """Return what is wrong with the depth, a line each; empty if nothing is.

    Reads some frames and all poses.

    Raises RecordingError.
    """
    whole, info = recording.of_any_depth(), recording.info
    apart_s = min((info.last_s - info.first_s) / _FRAMES, _APART_S)
    step = max(1, round(apart_s * info.frames / max(info.last_s - info.first_s, _APART_S)))
    frames = [_thinned(frame) for frame in itertools.islice(whole.frames(step), _FRAMES)]
    scale = unfitting_scale(frames, recording.poses(), info.body_from_depth)
    if scale is not None:
        return [_scale_remark(scale, info.metres_per_unit)]
    return _range_remarks(frames, recording.depth_range_m, info.metres_per_unit)


def _scale_remark(scale: float, unit_m: float) -> str:
    """Return the line that names the likely unit."""
    estimate_m = scale * unit_m
    known = next((unit for unit in _UNITS_M if abs(estimate_m / unit - 1.0) <= _SAME_UNIT_SHARE), None)
    likely = f"{known:g}" if known is not None else f"{estimate_m:.3g}, unless the scale of the poses is wrong"
    return f"depth fits the poses' motion with {scale:.3g} of its unit: --depth-unit {likely} (it was read with {unit_m:g})"


def _range_remarks(frames: list[_View], range_m: tuple[float, float] | None, unit_m: float) -> list[str]:
    seen_m = np.concatenate([view.depth_m[np.isfinite(view.depth_m)] for view in frames])
    if not len(seen_m):
        return ["the depth images are empty: no pixel has a return"]
    if range_m is None:
        return []
    low_m, high_m = range_m
    typical_m = f"the median is {float(np.median(seen_m)):.3g} m; is the unit right? --depth-unit, now {unit_m:g} m"
    for share, words in (
        ((seen_m < low_m).mean(), f"nearer than {low_m:g} m"),
        ((seen_m > high_m).mean(), f"beyond {high_m:g} m"),
    ):
        if share >= _OUTSIDE_SHARE:
            return [f"{100.0 * share:.0f} % of the depth is {words}, and is not used: {typical_m}"]
    return []


@dataclass(frozen=True)
class _View:
    """A thinned frame: depth_m (h, w), NaN without a return; bearings (h, w, 3), z = 1."""

    stamp_s: float
    depth_m: Float32Array
    bearings: FloatArray
    lens: tuple[float, float, float, float]  # fx, fy, cx, cy of the thinned image


def _thinned(frame: Frame) -> _View:
    """Return a frame with every n-th pixel of its depth."""
    lens, step = frame.depth_intrinsics, max(1, frame.depth_m.shape[1] // _WIDTH_PX)
    numbers = lens.fx / step, lens.fy / step, lens.cx / step, lens.cy / step
    depth_m = np.array(frame.depth_m[::step, ::step])
    return _View(frame.stamp_s, depth_m, _bearings(*numbers, *depth_m.shape), numbers)


@lru_cache(maxsize=4)
def _bearings(fx: float, fy: float, cx: float, cy: float, height: int, width: int) -> FloatArray:
    v, u = np.indices((height, width))
    return np.stack(((u - cx) / fx, (v - cy) / fy, np.ones((height, width))), axis=-1)


def unfitting_scale(frames: list[_View], poses: list[StampedPose], body_from_depth: Pose) -> float | None:
    """Return the factor with which the depth fits the motion of the poses.

    None if it fits as it is, or nothing tells.

    Each of several groups of pairs of frames must tell that it does not fit, all of them on the same side.
    """
    placed = [(view, pose @ body_from_depth) for view in frames if (pose := pose_at(poses, view.stamp_s)) is not None]
    pairs = _pairs(placed)
    if len(pairs) < _GROUPS:
        return None
    costs = np.array([_distances(*placed[i], *placed[j]) for i, j in pairs])
    scales = [_best_scale(costs[k::_GROUPS].mean(axis=0)) or 1.0 for k in range(_GROUPS)]
    if max(scales) < _FITTING_FACTOR[0] or min(scales) > _FITTING_FACTOR[1]:
        return _best_scale(costs.mean(axis=0))
    return None


def pose_at(poses: list[StampedPose], stamp_s: float) -> Pose | None:
    """Return the pose at an instant, interpolated between the two beside it.

    None without two that are near each other.
    """
    after = bisect_left(poses, stamp_s, key=lambda pose: pose.stamp_s)
    if after < len(poses) and poses[after].stamp_s == stamp_s:
        return poses[after].odom_from_body
    if not 0 < after < len(poses) or poses[after].stamp_s - poses[after - 1].stamp_s > _POSE_GAP_S:
        return None
    first, second = poses[after - 1], poses[after]
    share = (stamp_s - first.stamp_s) / (second.stamp_s - first.stamp_s)
    a, b = first.odom_from_body, second.odom_from_body
    turned = b.quat_wxyz if a.quat_wxyz @ b.quat_wxyz >= 0.0 else -b.quat_wxyz
    position_m = (1.0 - share) * a.translation_m + share * b.translation_m
    return Pose((1.0 - share) * a.quat_wxyz + share * turned, position_m)


def _pairs(placed: list[tuple[_View, Pose]]) -> list[tuple[int, int]]:
    """Return for each frame the one after it that is farthest away and yet shows the same.

    At most _PAIRS, spread evenly.
    """
    places = np.array([pose.translation_m for _, pose in placed]).reshape(-1, 3)
    turns = np.array([pose.quat_wxyz for _, pose in placed]).reshape(-1, 4)
    out = []
    for i, j in itertools.chain.from_iterable(((i, i + k) for i in range(len(placed) - k)) for k in (1, 2, 4, 8, 16)):
        apart_m = float(np.linalg.norm(places[j] - places[i]))
        turn_rad = 2.0 * math.acos(min(1.0, abs(float(turns[i] @ turns[j]))))
        if _BASELINES_M[0] <= apart_m <= _BASELINES_M[1] and turn_rad <= _TURN_RAD:
            out.append((apart_m, i, j))
    farthest = {i: (i, j) for _, i, j in sorted(out)}
    chosen = sorted(farthest.values())
    return chosen[:: max(1, math.ceil(len(chosen) / _PAIRS))]


def _distances(first: _View, world_from_first: Pose, second: _View, world_from_second: Pose) -> FloatArray:
    """Return the mean distance between two surfaces at each of _SCALES, as a share of the range.

    _CLIPPED_SHARE where it is not known.
    """
    second_from_first = world_from_second.inverse() @ world_from_first
    depth_m = first.depth_m[::_POINT_STEP, ::_POINT_STEP]
    rays = first.bearings[::_POINT_STEP, ::_POINT_STEP] @ second_from_first.rotation().T
    known = np.isfinite(depth_m)
    points = rays[known] * depth_m[known][:, None]
    out = np.full(len(_SCALES), _CLIPPED_SHARE)
    if not len(points):
        return out
    for number, scale in enumerate(_SCALES):
        moved = points + second_from_first.translation_m / scale  # in units of the depth as it was read
        share = _distance(moved, second)
        out[number] = _CLIPPED_SHARE if share is None else share
    return out


def _distance(points: FloatArray, view: _View) -> float | None:
    """Return the mean distance of points (N, 3) from a view's surface as a share of the range.

    None if few land on it.
    """
    (fx, fy, cx, cy), (height, width) = view.lens, view.depth_m.shape
    ahead = points[points[:, 2] > 0.0]
    u = np.rint(fx * ahead[:, 0] / ahead[:, 2] + cx)
    v = np.rint(fy * ahead[:, 1] / ahead[:, 2] + cy)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    seen_m = view.depth_m[v[inside].astype(np.intp), u[inside].astype(np.intp)]
    landed = np.isfinite(seen_m)
    if landed.sum() < _LANDED_SHARE * len(points):
        return None
    away = np.abs(ahead[inside, 2][landed] - seen_m[landed]) / seen_m[landed]
    return float(np.minimum(away, _CLIPPED_SHARE).mean())


def _best_scale(costs: FloatArray) -> float | None:
    """Return the scale of the smallest distance; None if scales beside it fit nearly as well."""
    best = int(np.argmin(costs))
    beside = round(math.log(_BESIDE_FACTOR) / math.log(_SCALES[1] / _SCALES[0]))
    if not beside <= best < len(_SCALES) - beside:
        return None
    if costs[best] > _CLEAR_SHARE * min(costs[best - beside], costs[best + beside]):
        return None
    before, at, after = costs[best - 1 : best + 2]
    bend = before - 2.0 * at + after
    offset = 0.5 * (before - after) / bend if bend > 0.0 else 0.0  # of a parabola through the three
    return float(_SCALES[best] * (_SCALES[1] / _SCALES[0]) ** offset)
