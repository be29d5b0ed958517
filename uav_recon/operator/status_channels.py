"""Channels for the status of a flight, as the channels of a flight provide them."""

from __future__ import annotations

from typing import Protocol

from uav_recon.interfaces import Channel
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import StampedPose
from uav_recon.types.trajectory import Intent
from uav_recon.types.vehicle import MissionProgress, VehicleState


class StatusChannels(Protocol):
    """Channels that a command handler reads."""

    @property
    def vehicle(self) -> Channel[VehicleState]:
        """State of the vehicle, from the pilot."""
        ...

    @property
    def intent(self) -> Channel[Intent]:
        """Goal and trajectory of the mission."""
        ...

    @property
    def progress(self) -> Channel[MissionProgress]:
        """Progress of the mission."""
        ...

    @property
    def odom(self) -> Channel[StampedPose]:
        """Odometry of the body."""
        ...

    @property
    def perception(self) -> Channel[PerceptionStatus]:
        """Counts and remarks of perception."""
        ...
