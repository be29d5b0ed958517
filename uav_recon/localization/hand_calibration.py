"""Calibration of the camera from a motion by hand, with the filter of the flight."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from uav_recon.interfaces import Clock, DepthCamera, PoseSource
from uav_recon.localization.calibration.calibration_filter import (
    NAMES,
    CalibrationFilter,
    Elements,
    observed,
    prior_sigma,
)
from uav_recon.localization.calibration.camera_mount import Mount
from uav_recon.localization.consistency.odometry_drift_rate import DriftRateEstimator
from uav_recon.localization.consistency.planar_patches import patches
from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.localization.motion_estimator import MotionEstimator
from uav_recon.types.camera import Frame
from uav_recon.types.camera_calibration import MOMENT_S, CameraCalibration, CameraMotion
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.pose import Pose

_MEMORY_S = 120.0  # a mount in a hand does not change, but comparisons are not independent: with 600 s sigma was a third
_KEPT_EVERY_S = 0.5
_MOST_FRAMES = 400  # frames that are kept for the residuals: the first minutes
_AGE_S = 3.0  # age of the views that residuals compare
_WAITING = 8  # frames that wait for a pose
#: warn: share of its prior deviation above which a motion is still asked for: a hand can show more than a flight does
_KNOWN_SHARE = 0.5
_OUTLIER_M = 0.15  # a larger distance is another surface
# elements that a fixed mount's calibration needs, each with the motion that shows it
MOTIONS = {
    "delay_s": "turn left and right, briskly",
    "rotation_x_rad": "move up and down and to and fro before a wall or over the floor",
    "rotation_y_rad": "move left and right, and to and fro, before a wall",
    "rotation_z_rad": "move sideways and up and down along a wall",
    "depth_scale": "move towards a wall, and back, several times",
}


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Distances (N,) of surfaces from those of earlier views, m, with their times (N,), s."""

    stamp_s: FloatArray
    distance_m: FloatArray

    @property
    def typical_m(self) -> float:
        """Median of the absolute distances; NaN without any.

        Some are of another surface: a mean would be theirs.
        """
        return float(np.median(np.abs(self.distance_m))) if len(self.distance_m) else math.nan


class _Kept(NamedTuple):
    frame: Frame
    motion: CameraMotion


class CameraCalibrator:
    """Reads a camera and poses, and estimates the camera's errors.

    Call step() at about 100 Hz; it never blocks. odometry: estimates the motion from the poses; None: the fusion filter.
    """

    def __init__(
        self, camera: DepthCamera, poses: PoseSource, mount: Mount, clock: Clock, odometry: MotionEstimator | None = None
    ) -> None:
        self._camera = camera
        self._poses = poses
        self._mount = mount
        self._clock = clock
        self._fusion: MotionEstimator = odometry or FusionFilter()
        self._estimator = DriftRateEstimator(CalibrationFilter(_MEMORY_S))
        self._waiting: deque[Frame] = deque(maxlen=_WAITING)
        self._kept: list[_Kept] = []
        self.frames = 0
        self.poses_read = 0

    @property
    def filter(self) -> CalibrationFilter:
        """The filter of the errors."""
        return self._estimator.calibration

    def step(self) -> None:
        """Read what is new; compare each frame once the pose after it is known."""
        now_s = self._clock.now_s()
        self._mount.observe()
        self._fusion.add_imu(self._camera.imu(), now_s)
        for pose in self._poses.poses():
            self.poses_read += 1
            self._fusion.add_pose(pose, now_s)
        if (frame := self._camera.poll()) is not None:
            self._waiting.append(frame)
        while self._waiting and self._waiting[0].stamp_s <= self._fusion.newest_pose_s:
            self._compare(self._waiting.popleft())

    def elements(self) -> Elements:
        """Return all errors as known now."""
        return self.filter.summary()

    def missing(self) -> tuple[str, ...]:
        """Return the motions that would show what is not known well yet."""
        known = {name for name, _, sigma in self.elements() if sigma <= _KNOWN_SHARE * prior_sigma(name)}
        return tuple(motion for name, motion in MOTIONS.items() if name not in known)

    def residuals(self, calibration: CameraCalibration) -> Residuals:
        """Return the distances of surfaces between views of a camera with these errors."""
        stamps_s, distances_m = [np.empty(0)], [np.empty(0)]
        views: deque[tuple[float, AnyArray]] = deque()
        for frame, motion in self._kept:
            pose, depth_m = calibration.pose(motion), calibration.true_depth_m(frame.depth_m)
            camera = frame.depth_intrinsics.pinhole_px()
            while views and frame.stamp_s - views[0][0] > _AGE_S:
                views.popleft()
            for _, seen in views:
                off_m = _distances_m(seen, depth_m, camera, pose)
                distances_m.append(off_m)
                stamps_s.append(np.full(len(off_m), frame.stamp_s))
            views.append((frame.stamp_s, patches(depth_m, camera, pose.rotation(), pose.translation_m)))
        return Residuals(np.concatenate(stamps_s), np.concatenate(distances_m))

    def _compare(self, frame: Frame) -> None:
        here, before = self._fusion.odom_at(frame.stamp_s), self._fusion.odom_at(frame.stamp_s - MOMENT_S)
        mount, moment = self._mount.body_from_depth(frame.stamp_s), self._mount.body_from_depth(frame.stamp_s - MOMENT_S)
        if here is None or before is None or mount is None or moment is None or here.quality == 0:
            return
        motion = CameraMotion.between(before.odom_from_body @ moment, here.odom_from_body @ mount, MOMENT_S)
        self._estimator.update(frame, motion)
        self.frames += 1
        due = not self._kept or frame.stamp_s - self._kept[-1].frame.stamp_s >= _KEPT_EVERY_S
        if due and len(self._kept) < _MOST_FRAMES:
            self._kept.append(_Kept(frame, motion))


def known_calibration(elements: Elements) -> CameraCalibration:
    """Return the errors of the depth imager that have been observed; the others are zero."""
    values = {name: value for name, value, _ in observed(elements)}
    state = np.zeros(max(NAMES.values()) + 1)
    for name, value in values.items():
        state[NAMES[name]] = value
    wrong = Pose.from_rotation_vector(
        state[[NAMES[f"rotation_{axis}_rad"] for axis in "xyz"]], state[[NAMES[f"offset_{axis}_m"] for axis in "xyz"]]
    )
    return CameraCalibration(float(state[NAMES["delay_s"]]), wrong.inverse(), float(state[NAMES["depth_scale"]]))


def _distances_m(seen: AnyArray, depth_m: AnyArray, camera: FloatArray, pose: Pose) -> FloatArray:
    """Return the distances of returns from the planes of patches (N, 6)."""
    ahead = (seen[:, :3] - pose.translation_m) @ pose.rotation()
    ahead = ahead[ahead[:, 2] > 0.2] if len(ahead) else ahead
    planes = seen[((seen[:, :3] - pose.translation_m) @ pose.rotation())[:, 2] > 0.2]
    u = np.rint(ahead[:, 0] / ahead[:, 2] * camera[0] + camera[2]).astype(np.int64)
    v = np.rint(ahead[:, 1] / ahead[:, 2] * camera[1] + camera[3]).astype(np.int64)
    inside = (u >= 0) & (u < depth_m.shape[1]) & (v >= 0) & (v < depth_m.shape[0])
    u, v, planes = u[inside], v[inside], planes[inside]
    z = depth_m[v, u].astype(np.float64)
    there = np.stack([(u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z, z], axis=1)
    off_m = np.einsum("ni,ni->n", there @ pose.rotation().T + pose.translation_m - planes[:, :3], planes[:, 3:])
    return np.asarray(off_m[np.abs(off_m) < _OUTLIER_M])
