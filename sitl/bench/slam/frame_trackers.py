"""The trackers that `bench slam` compares, behind one protocol."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.pose import Pose, StampedPose


class SequenceTracker(Protocol):
    """Tracker of the body's pose from frames and inertial samples.

    Calls block while they compute.
    """

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Add inertial samples, oldest first."""
        ...

    def track(self, frame: Frame, body_from_depth: Pose) -> StampedPose | None:
        """Return odom_from_body at the stamp that the result has; None or quality 0 if it is lost.

        body_from_depth: nominal pose of the depth imager.
        """
        ...


def _joint() -> SequenceTracker:
    from uav_recon.localization.slam.slam_tracker import SlamTracker

    return SlamTracker()


def _open3d() -> SequenceTracker:
    from sitl.bench.slam.rgbd_odometry import RgbdOdometry

    return RgbdOdometry()


METHODS: dict[str, Callable[[], SequenceTracker]] = {"joint": _joint, "open3d": _open3d}
