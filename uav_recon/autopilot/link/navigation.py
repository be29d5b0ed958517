"""Source of the autopilot's position: poses of the companion, or a navigation of its own."""

from __future__ import annotations

from collections import deque
from typing import Protocol

from uav_recon.autopilot.link.local_frame import LocalFrame
from uav_recon.autopilot.link.reported_poses import LocalPositionPoses, PoseReports
from uav_recon.autopilot.mavlink.messages import Message
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.vehicle import ReportedPoses

_KEPT = 16  #: internal: poses that are published together, half a second


class Navigation(Protocol):
    """The two directions of poses.

    feeds: True if odometry is sent to the autopilot. streams_hz: messages (id, rate) besides those of the firmware.
    """

    feeds: bool
    streams_hz: tuple[tuple[int, float], ...]

    @property
    def local_from_odom(self) -> Pose | None:
        """Odom in the autopilot's local frame; None while it is not known."""
        ...

    def add_odometry(self, pose: StampedPose) -> None:
        """Process a pose of odometry that is fit for flight."""
        ...

    def add_message(self, message: Message, stamp_s: float) -> None:
        """Process a message of the autopilot. stamp_s: on our clock."""
        ...

    def reported(self) -> ReportedPoses | None:
        """Return the newest poses of the autopilot, None if nothing is new."""
        ...


class CompanionNavigation:
    """The autopilot follows the poses that it is fed: its local frame is odom."""

    feeds = True
    streams_hz: tuple[tuple[int, float], ...] = ()

    @property
    def local_from_odom(self) -> Pose:
        """Odom in the autopilot's local frame, which is odom."""
        return Pose.identity()

    def add_odometry(self, pose: StampedPose) -> None:
        """Do nothing."""

    def add_message(self, message: Message, stamp_s: float) -> None:
        """Do nothing."""

    def reported(self) -> None:
        """Return None: what it reports is what it was fed."""


class AutopilotNavigation:
    """The autopilot knows where it is, and is fed nothing: its poses are the source of odometry.

    reports: builds the poses of the source. Its local frame is measured by the estimate that it flies by.
    """

    feeds = False

    def __init__(self, reports: PoseReports) -> None:
        self._reports = reports
        self._estimates = LocalPositionPoses()
        self._frame = LocalFrame()
        self._kept: deque[StampedPose] = deque(maxlen=_KEPT)
        self._new = False
        self.streams_hz = reports.streams_hz

    @property
    def local_from_odom(self) -> Pose | None:
        """Odom in its local frame; None while it is not known."""
        return self._frame.local_from_odom

    def add_odometry(self, pose: StampedPose) -> None:
        """Compare a pose of odometry with the autopilot's estimates."""
        self._frame.add_odometry(pose)

    def add_message(self, message: Message, stamp_s: float) -> None:
        """Build poses from a message."""
        for estimate in self._estimates.poses(message, stamp_s):
            self._frame.add_estimate(estimate)
        poses = self._reports.poses(message, stamp_s)
        self._kept.extend(poses)
        self._new |= bool(poses)

    def reported(self) -> ReportedPoses | None:
        """Return the newest poses, None if nothing is new.

        Each value also holds those before it, because its reader may miss one.
        """
        if not self._new:
            return None
        self._new = False
        return ReportedPoses(tuple(self._kept))
