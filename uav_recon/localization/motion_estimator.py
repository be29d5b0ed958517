"""Protocol of an estimator of the body's motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from uav_recon.localization.fusion.filter_pose_gates import PoseRejection
from uav_recon.types.camera import ImuSample
from uav_recon.types.pose import StampedPose


class MotionEstimator(Protocol):
    """Odometry of any recent instant."""

    @property
    def newest_pose_s(self) -> float:
        """Stamp of the newest fused pose; -inf before the first."""
        ...

    @property
    def source_excluded(self) -> bool:
        """True while the poses of the source are not used because the other sensors contradict them."""
        ...

    @property
    def confirmed_s(self) -> float:
        """Instant at which the view has last confirmed the source; -inf before.

        It compares their ways over seconds: the source did not drift.
        """
        ...

    @property
    def rejected(self) -> Mapping[PoseRejection, int]:
        """Counts of rejected poses and inertial samples."""
        ...

    def add_imu(self, samples: list[ImuSample], now_s: float) -> None:
        """Add inertial samples, oldest first."""
        ...

    def add_pose(self, pose: StampedPose, now_s: float) -> bool:
        """Add a pose at its own stamp. Return False if it is not used."""
        ...

    def add_view(self, now_s: float) -> None:
        """Take what the tracked images have shown since the last call."""
        ...

    def odom_at(self, stamp_s: float) -> StampedPose | None:
        """Return the body's pose at an instant, None if it is not known."""
        ...
