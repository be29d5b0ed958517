"""Calibration of the camera from a motion by hand: its views, and advice on the motion.

The filter says during the walk which motion is still missing. The errors themselves come from all views together, which the
mapper adjusts: app/views_calibration.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from uav_recon.interfaces import Clock, DepthCamera, PoseSource
from uav_recon.localization.calibration.calibration_filter import CalibrationFilter, Elements
from uav_recon.localization.calibration.camera_mount import Mount
from uav_recon.localization.consistency.odometry_drift_rate import DriftRateEstimator
from uav_recon.localization.consistency.planar_patches import patches
from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.localization.motion_estimator import MotionEstimator
from uav_recon.types.camera import Frame, PosedFrame
from uav_recon.types.camera_calibration import (
    COLOUR_ERROR_SIGMAS,
    ERROR_SIGMAS,
    MOMENT_S,
    CameraCalibration,
    CameraMotion,
)
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.pose import Pose

_MEMORY_S = 120.0  # a mount in a hand does not change, but comparisons are not independent: with 600 s sigma was a third
_KEPT_EVERY_S = 0.5
MOST_VIEWS = 120  # kept over the whole walk
# a view in motion is worth more: at rest no delay shows. Speed of the image's middle, 2 m away, at which it is worth most, and
# the worth of a view at rest
_FAST_MPS = 0.5
_RANGE_M = 2.0
_REST_WORTH = 0.4
_COMPARED = 6  # earlier views that residuals compare a view with
_WAITING = 8  # frames that wait for a pose
#: warn: share of its prior deviation up to which an error is known: a hand can show more than a flight does
_KNOWN_SHARE = 0.5
_PRIOR_SIGMA = ERROR_SIGMAS | COLOUR_ERROR_SIGMAS
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


class CameraCalibrator:
    """Reads a camera and poses, keeps views of the whole walk, and filters the camera's errors.

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
        self._views: list[PosedFrame] = []
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

    @property
    def views(self) -> tuple[PosedFrame, ...]:
        """At most MOST_VIEWS views of the whole walk, with their motion.

        Depth is as the camera reported it.
        """
        return tuple(self._views)

    def elements(self) -> Elements:
        """Return the errors of the depth imager as the filter knows them now."""
        return tuple(each for each in self.filter.summary() if each[0] in ERROR_SIGMAS)

    def residuals(self, calibration: CameraCalibration) -> Residuals:
        """Return the distances of surfaces between views of a camera with these errors."""
        stamps_s, distances_m = [np.empty(0)], [np.empty(0)]
        before: deque[AnyArray] = deque(maxlen=_COMPARED)
        for view in self._views:
            frame = view.frame
            motion = CameraMotion(view.world_from_depth, view.velocity_mps, view.rate_radps)
            pose, depth_m = calibration.pose(motion), calibration.true_depth_m(frame.depth_m)
            camera = frame.depth_intrinsics.pinhole_px()
            for seen in before:
                off_m = _distances_m(seen, depth_m, camera, pose)
                distances_m.append(off_m)
                stamps_s.append(np.full(len(off_m), frame.stamp_s))
            before.append(patches(depth_m, camera, pose.rotation(), pose.translation_m))
        return Residuals(np.concatenate(stamps_s), np.concatenate(distances_m))

    def _compare(self, frame: Frame) -> None:
        here, before = self._fusion.odom_at(frame.stamp_s), self._fusion.odom_at(frame.stamp_s - MOMENT_S)
        mount, moment = self._mount.body_from_depth(frame.stamp_s), self._mount.body_from_depth(frame.stamp_s - MOMENT_S)
        if here is None or before is None or mount is None or moment is None or here.quality == 0:
            return
        motion = CameraMotion.between(before.odom_from_body @ moment, here.odom_from_body @ mount, MOMENT_S)
        self._estimator.update(frame, motion)
        self.frames += 1
        if not self._views or frame.stamp_s - self._views[-1].frame.stamp_s >= _KEPT_EVERY_S:
            self._keep(frame, motion)

    def _keep(self, frame: Frame, motion: CameraMotion) -> None:
        """Keep a view.

        Of too many, the one is dropped that leaves the shortest gap, and rather one at rest.
        """
        pose, velocity_mps, rate_radps = motion.odom_from_depth, motion.velocity_mps, motion.rate_radps
        self._views.append(PosedFrame(frame, pose, velocity_mps=velocity_mps, rate_radps=rate_radps))
        if len(self._views) > MOST_VIEWS:
            stamp_s = np.array([view.frame.stamp_s for view in self._views])
            worth = (stamp_s[2:] - stamp_s[:-2]) * np.array([_worth(view) for view in self._views[1:-1]])
            del self._views[1 + int(np.argmin(worth))]


def known_elements(elements: Elements) -> Elements:
    """Return the errors that are known: their deviation has become a share of the prior's."""
    return tuple(each for each in elements if each[2] <= _KNOWN_SHARE * _PRIOR_SIGMA[each[0]])


def missing_motions(elements: Elements) -> dict[str, str]:
    """Return the motions that would show what is not known yet, by the name of the error."""
    known = {name for name, _, _ in known_elements(elements)}
    return {name: motion for name, motion in MOTIONS.items() if name not in known}


def _worth(view: PosedFrame) -> float:
    speed_mps = float(np.linalg.norm(view.velocity_mps) + _RANGE_M * np.linalg.norm(view.rate_radps))
    return _REST_WORTH + (1.0 - _REST_WORTH) * min(speed_mps / _FAST_MPS, 1.0)


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
