"""Source of poses by the embedded SLAM, and of the tracked frames with true stamps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from uav_recon.interfaces import DepthCamera
from uav_recon.localization.calibration.camera_mount import Mount
from uav_recon.localization.slam.view_odometry import ViewOdometry
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.pose import StampedPose

_FUTURE_S = 0.01  #: reject: a frame stamped later than the clock by this


class TrackedCamera:
    """DepthCamera whose frames are tracked as they are read, which takes about 8 ms each.

    ``odometry``: of the tracked frames.
    """

    def __init__(
        self, camera: DepthCamera, mount: Mount, odometry: ViewOdometry, *, now_s: Callable[[], float] = lambda: math.inf
    ) -> None:
        self._camera = camera
        self._mount = mount
        self.odometry = odometry
        self._now_s = now_s

    def poll(self) -> Frame | None:
        """Return the newest frame that was not returned before, or None."""
        frame = self._camera.poll()
        if frame is not None and frame.stamp_s <= self._now_s() + _FUTURE_S:  # a later one would move the track into the future
            self._track(frame)
        return frame

    def _track(self, frame: Frame) -> StampedPose | None:
        body_from_depth = self._mount.body_from_depth(frame.stamp_s - self.odometry.tracker.delay_s)
        return None if body_from_depth is None else self.odometry.track(frame, body_from_depth)

    def imu(self) -> list[ImuSample]:
        """Return the inertial samples since the last call.

        They do not reach the tracker here: perception gives it the samples of the sensors that work.
        """
        return self._camera.imu()

    def close(self) -> None:
        """Release the camera."""
        self._camera.close()


class SlamSource(TrackedCamera):
    """DepthCamera and PoseSource in one.

    A frame's stamp is moved to the instant that it shows, as far as the gyro shows the delay. The pose of a frame has the stamp
    of that frame; it can be read after it.
    """

    def __init__(
        self, camera: DepthCamera, mount: Mount, odometry: ViewOdometry, *, now_s: Callable[[], float] = lambda: math.inf
    ) -> None:
        super().__init__(camera, mount, odometry, now_s=now_s)
        self._poses: list[StampedPose] = []

    def poll(self) -> Frame | None:
        """Return the newest frame that was not returned before, or None."""
        frame = super().poll()
        if frame is None or frame.stamp_s > self._now_s() + _FUTURE_S:  # perception rejects it
            return frame
        return replace(frame, stamp_s=frame.stamp_s - self.odometry.tracker.delay_s)

    def _track(self, frame: Frame) -> StampedPose | None:
        pose = super()._track(frame)
        if pose is not None:
            self._poses.append(pose)
        return pose

    def poses(self) -> list[StampedPose]:
        """Return the poses since the last call, oldest first."""
        found, self._poses = self._poses, []
        return found
