"""Channels of the mission, as the channels of a flight provide them."""

from __future__ import annotations

from typing import Protocol

from uav_recon.interfaces import Channel
from uav_recon.types.camera import PosedFrame
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.maps import FreeSpace, SurfaceElements, VoxelMap
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import MapCorrection
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Intent
from uav_recon.types.vehicle import MissionProgress, VehicleState


class MissionChannels(Protocol):
    """Channels between the mission, the pilot, perception and the recorder."""

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
        """Occupancy map, for viewers and recorders."""
        ...

    @property
    def surface(self) -> Channel[SurfaceElements]:
        """Surface that the mapper has learned."""
        ...

    @property
    def plan(self) -> Channel[ViewPath]:
        """Planned views and their path."""
        ...

    @property
    def correction(self) -> Channel[MapCorrection]:
        """Map corrections, from perception."""
        ...

    @property
    def free(self) -> Channel[FreeSpace]:
        """Free space of the occupancy map, for the guard."""
        ...

    @property
    def perception(self) -> Channel[PerceptionStatus]:
        """Status of perception."""
        ...

    @property
    def cones(self) -> Channel[FreeCone]:
        """Free cones of the upward range finder."""
        ...
