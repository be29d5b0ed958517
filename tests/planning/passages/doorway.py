"""Two rooms with an opening between them, as voxels and as a fine map of the opening."""

from __future__ import annotations

import numpy as np

from uav_recon.mapping.occupancy.distance_field import distance2_to_not_free
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.free_space.flyable_space import FlyableSpace, height_measure
from uav_recon.planning.passages.passages import Passages
from uav_recon.types.frames import ByteArray, FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, VoxelMap
from uav_recon.types.tasks import PlanRequest

SIZE_M = np.array([6.0, 4.0, 2.4])
WALL_M = (2.95, 3.05)
MIDDLE_M = 2.013  # of the opening along y: not at a border of voxels
CLEARANCE_M, PASSAGE_M = 0.4, 0.295
HEIGHTS = height_measure(CLEARANCE_M, 0.1, 0.12, 0.1)
FINE_HEIGHTS = height_measure(PASSAGE_M, 0.1, 0.095, 0.025)
HERE = np.array([1.2, 2.0, 1.1])
CAMERA = CameraGeometry(1.5, 1.0, np.zeros(3), 0.26, 0.26, 4.5)


def solid(centres: FloatArray, width_m: float) -> ByteArray:
    """Return a mask (N,): the walls of two rooms at positions (N, 3)."""
    x, y, z = centres.T
    shell = ((centres < 0.1) | (centres > SIZE_M - 0.1)).any(axis=1)
    wall = (x > WALL_M[0]) & (x < WALL_M[1]) & ~((np.abs(y - MIDDLE_M) < width_m / 2) & (z < 2.0))
    return np.asarray(shell | wall).astype(np.uint8)


def voxel_map(grid: GridSpec, width_m: float, *, fine: bool, revision: int = 1) -> VoxelMap:
    """Return a map: a voxel is occupied if any of its 27 samples is in a wall."""
    offsets = np.stack(np.meshgrid(*[[-0.49, 0.0, 0.49]] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * grid.resolution_m
    centres = grid.centre(np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), axis=-1).reshape(-1, 3))
    occupied = np.zeros(len(centres), dtype=np.uint8)
    for offset in offsets:
        occupied |= solid(centres + offset, width_m)
    state = np.where(occupied, OCCUPIED, FREE).astype(np.uint8).reshape(grid.shape)
    heights, reach = (FINE_HEIGHTS, 15) if fine else (HEIGHTS, 11)
    return VoxelMap.whole(grid, state, distance2_to_not_free(state, reach, heights), revision, heights=heights)


class Doorway:
    """The maps of an opening of a width, and the passages of a planner in them."""

    def __init__(self, width_m: float) -> None:
        grid = GridSpec(np.zeros(3), 0.1, (60, 40, 24))
        self.voxels = voxel_map(grid, width_m, fine=False)
        box = np.zeros(3, dtype=np.int64), np.array(grid.shape)
        self.usual = FlyableSpace(grid, CLEARANCE_M, *box, HEIGHTS)
        self.passages = Passages(self.usual, FlyableSpace(grid, 0.25, *box, HEIGHTS), PASSAGE_M, CAMERA)

    def fine(self, width_m: float, revision: int = 1) -> VoxelMap:
        """Return a fine map of where the passages want one, with an opening of a width."""
        first = np.rint(self.passages.places[0] / 0.025 - np.array([40, 40, 24]))
        return voxel_map(GridSpec(first * 0.025, 0.025, (80, 80, 48)), width_m, fine=True, revision=revision)

    def plan(self, *fine: VoxelMap, position: FloatArray = HERE, yaw_rad: float = 0.0) -> None:
        """Update spaces and passages as a planner at rest does."""
        voxels = VoxelMap(
            self.voxels.grid, self.voxels.state, self.voxels.distance2, self.voxels.tile_revision, 1, 0, HEIGHTS, fine
        )
        self.usual.update(voxels)
        assert self.usual.locate_vehicle(position) is not None
        if self.passages.update(PlanRequest(voxels, None, position, yaw_rad, 10)):
            self.usual.update(voxels)
            self.usual.locate_vehicle(position)

    def leads_through(self) -> bool:
        """Return True if the other room is reachable."""
        i, j, k = np.floor(self.usual.padded_from_world(np.array([4.8, 2.0, 1.1]))).astype(int)
        return bool(self.usual.reachable[i, j, k])
