"""cuVSLAM by NVIDIA's wheel, on NVIDIA hardware only. Not tried with the real engine."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from uav_recon.trackers.engine import RgbdView, TrackedPose, TrackerError
from uav_recon.types.camera import Intrinsics
from uav_recon.types.pose import Pose

_UNITS_PER_M = 1000.0


class CuVslam:
    """TrackingEngine protocol over cuVSLAM in its RGB-D mode, odometry only.

    Raises TrackerError if the wheel is not installed or finds no GPU.
    """

    def __init__(self, camera: Intrinsics) -> None:
        try:
            engine: Any = importlib.import_module("cuvslam")
        except ImportError as error:
            raise TrackerError(f"cuvslam cannot be imported ({error}): install NVIDIA's wheel for this machine") from None
        lens = engine.Camera()
        lens.size, lens.focal, lens.principal = (camera.width, camera.height), (camera.fx, camera.fy), (camera.cx, camera.cy)
        depth = engine.Tracker.OdometryRGBDSettings()
        depth.depth_scale_factor, depth.depth_camera_id, depth.enable_depth_stereo_tracking = _UNITS_PER_M, 0, False
        mode = engine.Tracker.OdometryMode.RGBD
        config = engine.Tracker.OdometryConfig(async_sba=False, odometry_mode=mode, rgbd_settings=depth)
        try:
            self._tracker = engine.Tracker(engine.Rig([lens]), config)
        except (RuntimeError, ValueError) as error:
            raise TrackerError(f"cuvslam: {error}") from None

    def track(self, view: RgbdView) -> list[TrackedPose]:
        """Track a view. Empty while it is lost."""
        depth = np.round(view.depth_m * _UNITS_PER_M).astype(np.uint16)
        estimate, _ = self._tracker.track(round(view.stamp_s * 1e9), images=[np.ascontiguousarray(view.rgb)], depths=[depth])
        if estimate.world_from_rig is None:
            return []
        pose = estimate.world_from_rig.pose
        x, y, z, w = pose.rotation
        return [TrackedPose(view.stamp_s, Pose(np.array([w, x, y, z]), np.array(pose.translation)), 100)]

    def close(self) -> None:
        """Do nothing."""
