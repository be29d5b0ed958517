"""Channels of perception, as the channels of a flight provide them."""

from __future__ import annotations

from typing import Protocol

from uav_recon.interfaces import Channel
from uav_recon.types.camera import PosedFrame
from uav_recon.types.flow import FlowReadings
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import StampedPose
from uav_recon.types.vehicle import TurnRates


class PerceptionChannels(Protocol):
    """Channels that perception writes, and the sensors of the autopilot that it reads."""

    @property
    def odom(self) -> Channel[StampedPose]:
        """Odometry of the body."""
        ...

    @property
    def frames(self) -> Channel[PosedFrame]:
        """Depth frames with their poses."""
        ...

    @property
    def nearby(self) -> Channel[MinRangeGrid]:
        """Nearest returns of each frame, with or without a pose."""
        ...

    @property
    def perception(self) -> Channel[PerceptionStatus]:
        """Counts and remarks, once a second."""
        ...

    @property
    def rates(self) -> Channel[TurnRates]:
        """Turn rates of the autopilot, in place of a camera's IMU that is missing or frozen."""
        ...

    @property
    def flow(self) -> Channel[FlowReadings]:
        """Optical flow of the autopilot, and ranges below; nothing without such a sensor."""
        ...
