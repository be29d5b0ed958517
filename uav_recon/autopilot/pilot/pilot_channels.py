"""Channels of the pilot, as the channels of a flight provide them."""

from __future__ import annotations

from typing import Protocol

from uav_recon.interfaces import Channel
from uav_recon.types.flow import FlowReadings
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.maps import FreeSpace
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import StampedPose
from uav_recon.types.trajectory import Intent
from uav_recon.types.vehicle import ReportedPoses, TurnRates, VehicleState


class PilotChannels(Protocol):
    """Channels between the pilot, perception and the mission."""

    @property
    def odom(self) -> Channel[StampedPose]:
        """Odometry of the body."""
        ...

    @property
    def intent(self) -> Channel[Intent]:
        """Goal and trajectory of the mission."""
        ...

    @property
    def vehicle(self) -> Channel[VehicleState]:
        """State of the vehicle, from the pilot."""
        ...

    @property
    def free(self) -> Channel[FreeSpace]:
        """Free space of the occupancy map, for the guard."""
        ...

    @property
    def nearby(self) -> Channel[MinRangeGrid]:
        """Nearest returns of each frame."""
        ...

    @property
    def rates(self) -> Channel[TurnRates]:
        """Turn rates of the autopilot."""
        ...

    @property
    def reported(self) -> Channel[ReportedPoses]:
        """Poses that the autopilot reports."""
        ...

    @property
    def cones(self) -> Channel[FreeCone]:
        """Free cones of the upward range finder."""
        ...

    @property
    def flow(self) -> Channel[FlowReadings]:
        """Optical flow of the autopilot, and ranges below."""
        ...
