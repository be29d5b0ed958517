"""Publication of the mission's maps: to the guard, and to viewers."""

from __future__ import annotations

import math

from uav_recon.interfaces import Mapper
from uav_recon.mission.setup.mission_channels import MissionChannels
from uav_recon.types.maps import FreeSpace, VoxelMap
from uav_recon.types.trajectory import Trajectory

MAP_PERIOD_S = 1.0  #: internal: interval of the map for viewers
FREE_PERIOD_S = 0.2  #: internal: interval of the free space for the guard


class MapPublisher:
    """Publishes each map when it is new and due."""

    def __init__(self, channels: MissionChannels) -> None:
        self._channels = channels
        self._surface_revision = self._free_revision = -1
        self._map_s = self._free_s = -math.inf
        self._proposed: Trajectory | None = None

    def free(self, now_s: float, voxels: VoxelMap | None, trajectory: Trajectory | None) -> None:
        """Publish the free space for the guard, never later than a motion that was planned in it."""
        due = now_s - self._free_s >= FREE_PERIOD_S or trajectory is not self._proposed
        self._proposed = trajectory
        if voxels is not None and due and voxels.revision != self._free_revision:
            self._free_revision = voxels.revision
            self._free_s = now_s
            self._channels.free.publish(FreeSpace.of(voxels))

    def maps(self, now_s: float, voxels: VoxelMap | None, mapper: Mapper, last: bool) -> None:
        """Publish maps for screens and recorders. last: this is the final call."""
        surface = mapper.surface()
        if surface is not None and surface.revision != self._surface_revision:
            self._surface_revision = surface.revision
            self._channels.surface.publish(surface)
        if voxels is not None and (now_s - self._map_s >= MAP_PERIOD_S or last):
            self._map_s = now_s
            self._channels.voxels.publish(voxels)
