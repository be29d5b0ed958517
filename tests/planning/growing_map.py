"""Map that a camera fills and that a test overwrites, with tile revisions."""

from __future__ import annotations

import numpy as np
from box_world import Solid, grid_of, look_from, voxel_map
from numpy.typing import NDArray

from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.types.maps import TILE, VoxelMap


class GrowingMap:
    """Map whose state (nx, ny, nz) may be overwritten; ``picture`` finds the changes."""

    def __init__(self, solid: Solid) -> None:
        self.grid = grid_of(solid)
        self.solid = solid
        self.state = np.zeros(solid.shape, dtype=np.uint8)
        self.revision = 0
        self._tiles = np.zeros((-(-solid.shape[0] // TILE), -(-solid.shape[1] // TILE)), dtype=np.int64)
        self._before = voxel_map(self.state.copy())

    def look(self, camera: CameraGeometry, position: NDArray[np.float64], yaw_rad: float) -> None:
        pitch = float(np.clip(0.0, camera.pitch_min_rad, camera.pitch_max_rad))
        look_from(self.solid, self.state, camera, position, yaw_rad, pitch)

    def picture(self) -> VoxelMap:
        now = voxel_map(self.state.copy())
        self.revision += 1
        differs = ((now.state != self._before.state) | (now.distance2 != self._before.distance2)).any(axis=2)
        for i, j in np.unique(np.argwhere(differs) // TILE, axis=0):
            self._tiles[i, j] = self.revision
        self._before = now
        return VoxelMap(now.grid, now.state, now.distance2, self._tiles.copy(), self.revision)
