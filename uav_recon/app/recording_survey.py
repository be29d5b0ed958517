"""Survey of a recording: the direction up, and the box that its depth fills."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from uav_recon.app.option_validation import UsageError
from uav_recon.sensors.recordings.recording import Recording
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose

UPS = ("auto", "source", "first", "floor")
_SAMPLES = 40  #: internal: frames looked at
_STRIDE_PX = 8
_NEAR_S = 0.06  #: reject: a frame with no pose nearer in time does not count for the box
_CONES_RAD = np.radians([45.0, 20.0, 10.0, 5.0])  # widths of the search for the floor's normal
_OUTSIDE_SHARE = 0.005  #: plan: this share of the points may lie outside each side of the box
_SMALLEST_M = 1.1  #: plan: the box reaches at least this far from the first pose: a fence is at least 2 m wide
_MARGIN_M = 0.3  #: plan: margin of the box around depth and path
# plan: half sizes of the box where no pose tells how far the camera went
_BOX_WITHOUT_POSES_M = np.array([6.0, 6.0, 2.5])


@dataclass(frozen=True)
class RecordingSurvey:
    """Result of the survey.

    odom_from_source: moves poses of the recording so that z is up, the first body pose has x = y = 0 and heading 0, and the
    lowest depth is at z = 0. box_min_m, box_max_m: (3,) corners, in odom, of what the depth shows. depth_lens: of the depth
    image.
    """

    odom_from_source: Pose
    box_min_m: FloatArray
    box_max_m: FloatArray
    depth_lens: Intrinsics


def survey_recording(recording: Recording, up: str, *, use_poses: bool) -> RecordingSurvey:
    """Read some frames and all poses.

    up: of the poses' frame; "source": its z, "first": the first image is level, "floor": the planes that the depth shows,
    "auto": source or floor, as the format says. Raises RecordingError and UsageError.
    """
    info, poses = recording.info, recording.poses() if use_poses else []
    step = max(1, info.frames // _SAMPLES)
    frames = list(recording.frames(step if poses else max(1, info.frames)))
    lens = frames[0].depth_intrinsics
    if not poses:
        return RecordingSurvey(Pose.identity(), -_BOX_WITHOUT_POSES_M, _BOX_WITHOUT_POSES_M, lens)
    views = [(frame, near) for frame in frames if (near := nearest_pose(poses, frame.stamp_s)) is not None]
    if not views:
        stamps = (
            f"frames are {info.first_s:.3f} to {info.last_s:.3f} s, poses {poses[0].stamp_s:.3f} to {poses[-1].stamp_s:.3f} s"
        )
        raise UsageError(f"no frame has a pose within {_NEAR_S:g} s: {stamps}")
    chosen = ("source" if info.up_is_z else "floor") if up == "auto" else up
    level_from_source = Pose(_turn_to_z(_up_direction(chosen, views, info.body_from_depth)), np.zeros(3))
    first = level_from_source @ poses[0].odom_from_body
    odom_from_source = Pose.from_yaw(first.yaw_rad(), first.translation_m).inverse() @ level_from_source
    seen = np.concatenate([_points(frame, odom_from_source @ pose @ info.body_from_depth) for frame, pose in views])
    if not len(seen):
        raise UsageError(
            f"no depth within --depth-range in any of {len(views)} frames of {info.first_s:.3f} to {info.last_s:.3f} s; "
            f"it was read with {info.metres_per_unit:g} m a unit (--depth-unit)"
        )
    floor_m = float(np.quantile(seen[:, 2], _OUTSIDE_SHARE))
    odom_from_source = Pose(Pose.identity().quat_wxyz, np.array([0.0, 0.0, -floor_m])) @ odom_from_source
    seen[:, 2] -= floor_m
    path = np.array([(odom_from_source @ pose.odom_from_body).translation_m for pose in poses])
    low, high = np.quantile(seen, [_OUTSIDE_SHARE, 1.0 - _OUTSIDE_SHARE], axis=0)
    box_min, box_max = np.minimum(low, path.min(axis=0) - _MARGIN_M), np.maximum(high, path.max(axis=0) + _MARGIN_M)
    low = np.minimum(box_min - _MARGIN_M, (-_SMALLEST_M, -_SMALLEST_M, 0.0))
    high = np.maximum(box_max + _MARGIN_M, _SMALLEST_M)
    return RecordingSurvey(odom_from_source, low, high, lens)


def nearest_pose(poses: list[StampedPose], stamp_s: float) -> Pose | None:
    """Return the pose nearest to a stamp, None if none is near."""
    after = bisect_left(poses, stamp_s, key=lambda pose: pose.stamp_s)
    near = min(poses[max(after - 1, 0) : after + 1], key=lambda pose: abs(pose.stamp_s - stamp_s))
    return near.odom_from_body if abs(near.stamp_s - stamp_s) <= _NEAR_S else None


def _up_direction(chosen: str, views: list[tuple[Frame, Pose]], body_from_depth: Pose) -> FloatArray:
    """Return the unit vector up (3,) in the frame of the poses."""
    if chosen == "source":
        return np.array([0.0, 0.0, 1.0])
    ups = [pose.rotation() @ body_from_depth.rotation() @ (0.0, -1.0, 0.0) for _, pose in views]
    if chosen == "first":
        return np.asarray(ups[0])
    return floor_normal(
        np.concatenate([_normals(frame, pose @ body_from_depth) for frame, pose in views]), np.mean(ups, axis=0)
    )


def floor_normal(normals: FloatArray, start: FloatArray) -> FloatArray:
    """Return the most frequent direction (3,) near ``start`` among unit normals (N, 3).

    Normals of both signs count. It is ``start`` if none is near.
    """
    up = start / np.linalg.norm(start)
    for cone_rad in _CONES_RAD:
        along = normals @ up
        near = np.abs(along) >= np.cos(cone_rad)
        if near.any():
            up = (normals[near] * np.sign(along[near])[:, None]).mean(axis=0)
            up /= np.linalg.norm(up)
    return np.asarray(up)


def _cloud(frame: Frame) -> FloatArray:
    """Return points (h, w, 3) of a coarse grid of pixels, in the depth frame; NaN: no return."""
    bearings = frame.depth_intrinsics.bearings()[::_STRIDE_PX, ::_STRIDE_PX]
    return np.asarray(bearings * frame.depth_m[::_STRIDE_PX, ::_STRIDE_PX, None].astype(np.float64))


def _points(frame: Frame, odom_from_depth: Pose) -> FloatArray:
    cloud = _cloud(frame).reshape(-1, 3)
    return odom_from_depth.apply(cloud[np.isfinite(cloud).all(axis=1)])


def _normals(frame: Frame, source_from_depth: Pose) -> FloatArray:
    cloud = _cloud(frame)
    across, down = cloud[:-1, 1:] - cloud[:-1, :-1], cloud[1:, :-1] - cloud[:-1, :-1]
    normals = np.cross(across, down).reshape(-1, 3)
    length = np.linalg.norm(normals, axis=1)
    flat = np.isfinite(length) & (length > 1e-9)
    return np.asarray((normals[flat] / length[flat, None]) @ source_from_depth.rotation().T)


def _turn_to_z(up: FloatArray) -> FloatArray:
    """Return the quaternion (4,) of the smallest turn that moves the unit vector ``up`` to z."""
    w = 1.0 + float(up[2])
    if w < 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    return np.array([w, float(up[1]), -float(up[0]), 0.0])
