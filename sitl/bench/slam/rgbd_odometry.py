"""Baseline of `bench slam`: Open3D's RGB-D odometry, hybrid term, from frame to frame.

It uses neither the inertial sensors nor a map. Park, Zhou, Koltun, "Colored Point Cloud Registration Revisited", ICCV 2017.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import open3d

from uav_recon.types.camera import Frame, ImuSample, Intrinsics
from uav_recon.types.frames import Float32Array
from uav_recon.types.pose import Pose, StampedPose

MAX_DEPTH_M = 4.5
MAX_DEPTH_STEP_M = 0.07  # of a pixel between two frames
ITERATIONS = (20, 10, 5)  # twice the default, from the coarse level of the pyramid to the fine one
MIN_FITNESS = 0.3  # share of the pixels with a partner; below it the frame is lost


class RgbdOdometry:
    """Odometry from frame to frame.

    A lost frame is skipped, and the next one is matched with the frame before it.
    """

    def __init__(self) -> None:
        self._before: Any = None
        self._odom_from_rgb: Pose | None = None

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Ignore inertial samples."""

    def track(self, frame: Frame, body_from_depth: Pose) -> StampedPose | None:
        """Return odom_from_body at the frame's stamp.

        The quality is 100 times the fitness, 0 if the frame is lost.
        """
        image = _rgbd_image(frame)
        body_from_rgb = body_from_depth @ frame.rgb_from_depth.inverse()
        if self._odom_from_rgb is None:
            self._before, self._odom_from_rgb = image, body_from_rgb
            return StampedPose(frame.stamp_s, Pose.identity(), np.zeros(3))
        fitness, before_from_now = _motion(image, self._before, frame.rgb_intrinsics)
        found = fitness >= MIN_FITNESS
        if found:
            self._before = image
            self._odom_from_rgb = self._odom_from_rgb @ before_from_now
        odom_from_body = self._odom_from_rgb @ body_from_rgb.inverse()
        return StampedPose(frame.stamp_s, odom_from_body, np.zeros(3), quality=round(100.0 * fitness) if found else 0)


def registered_depth_m(frame: Frame) -> Float32Array:
    """Return the depth (h, w), m, as the colour imager sees it; 0 = no return.

    Each return is put into its pixel and, because colour has more pixels per angle, into the one right of and below it.
    """
    camera = frame.rgb_intrinsics
    known = np.isfinite(frame.depth_m)
    z = frame.depth_m[known].astype(np.float64)
    points = frame.rgb_from_depth.apply(frame.depth_intrinsics.bearings()[known] * z[:, None])
    order = np.argsort(-points[:, 2], kind="stable")  # the nearest return is written last
    x, y, z = points[order].T
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    out = np.zeros((camera.height, camera.width), np.float32)
    for right, below in ((0, 0), (1, 0), (0, 1), (1, 1)):
        column, row = np.floor(u).astype(np.int64) + right, np.floor(v).astype(np.int64) + below
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height) & (z > 0.0)
        column, row, depth = column[inside], row[inside], z[inside]
        near = (out[row, column] == 0.0) | (out[row, column] > depth)
        out[row[near], column[near]] = depth[near]
    return out


def _rgbd_image(frame: Frame) -> Any:
    grey = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY)
    colour = np.repeat(grey[..., None], 3, axis=2)  # the odometry takes three channels and uses their intensity
    image, tensor = open3d.t.geometry.Image, open3d.core.Tensor.from_numpy
    return open3d.t.geometry.RGBDImage(image(tensor(colour)), image(tensor(registered_depth_m(frame))))


def _motion(image: Any, before: Any, camera: Intrinsics) -> tuple[float, Pose]:
    """Return the fitness, 0 to 1, and before_from_now."""
    odometry, tensor = open3d.t.pipelines.odometry, open3d.core.Tensor.from_numpy
    lens = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    criteria = [odometry.OdometryConvergenceCriteria(count) for count in ITERATIONS]
    loss = odometry.OdometryLossParams(MAX_DEPTH_STEP_M)
    try:
        found = odometry.rgbd_odometry_multi_scale(
            image, before, tensor(lens), tensor(np.eye(4)), 1.0, MAX_DEPTH_M, criteria, odometry.Method.Hybrid, loss
        )
    except RuntimeError:  # a singular system: no pixel has a partner
        return 0.0, Pose.identity()
    matrix = found.transformation.numpy()
    if not np.isfinite(matrix).all():
        return 0.0, Pose.identity()
    return float(found.fitness), Pose.from_matrix(matrix)
