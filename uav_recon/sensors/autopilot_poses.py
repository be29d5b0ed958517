"""Poses of an autopilot that navigates by itself, as the pilot's process reports them."""

from __future__ import annotations

import math

from uav_recon.interfaces import Channel
from uav_recon.types.pose import StampedPose
from uav_recon.types.vehicle import ReportedPoses


class AutopilotPoses:
    """PoseSource protocol over the channel of the reported poses."""

    def __init__(self, reported: Channel[ReportedPoses]) -> None:
        self._reported = reported
        self._sequence = 0
        self._read_s = -math.inf

    def poses(self) -> list[StampedPose]:
        """Return the poses since the last call, oldest first."""
        sequence = self._reported.sequence()
        newest = self._reported.latest() if sequence != self._sequence else None
        if newest is None:
            return []
        self._sequence = sequence
        fresh = [pose for pose in newest.poses if pose.stamp_s > self._read_s]
        if fresh:
            self._read_s = fresh[-1].stamp_s
        return fresh
