"""Channels that the recorder reads, as the channels of a flight provide them."""

from __future__ import annotations

from typing import Protocol

from uav_recon.interfaces import Channel
from uav_recon.types.camera import PosedFrame
from uav_recon.types.maps import SurfaceElements, VoxelMap
from uav_recon.types.pose import StampedPose
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Intent
from uav_recon.types.vehicle import MissionProgress, VehicleState


class RecorderChannels(Protocol):
    """All channels that the recorder reads."""

    @property
    def odom(self) -> Channel[StampedPose]:
        """Odometry of the body."""
        ...

    @property
    def frames(self) -> Channel[PosedFrame]:
        """Depth frames with their poses."""
        ...

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
    def voxels(self) -> Channel[VoxelMap]:
        """Occupancy map."""
        ...

    @property
    def surface(self) -> Channel[SurfaceElements]:
        """Surface elements of the mapper."""
        ...

    @property
    def plan(self) -> Channel[ViewPath]:
        """Planned path of views."""
        ...
