"""Rooms: parts of the free space that openings narrower than a usual passage part.

Room segmentation by distance transform (survey: Bormann et al., ICRA 2016). Free columns with more than CORE_M to the nearest
wall are cores, and each connected set of them is a room. All other columns belong to the room of the nearest core. Small
furniture parts no room, because only what stands at the height of a head is a wall.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, VoxelMap

CORE_M = 0.65  # an opening of up to twice this parts two rooms
BAND_M = (1.2, 1.9)  # heights above the floor of what is a wall: above most furniture, below the top of a doorway
FREE_SHARE = 0.5  # of a column in the band, from which on it is free


class Rooms:
    """Labels of the rooms of the newest map."""

    def __init__(self, floor_m: float) -> None:
        """Start without a map. floor_m: z of the floor in world."""
        self._band_m = np.array(BAND_M) + floor_m
        self._revision = -1
        self._label: IntArray = np.zeros((0, 0), dtype=np.int64)

    def of(self, voxels: VoxelMap, places_world: FloatArray) -> IntArray:
        """Return the labels (N,) of the rooms at positions (N, 3). 0: no room is known."""
        if voxels.revision != self._revision:
            self._revision = voxels.revision
            self._label = labels(self._free_columns(voxels), CORE_M / voxels.grid.resolution_m)
        index = np.clip(voxels.grid.index(places_world)[:, :2], 0, np.array(self._label.shape) - 1)
        found: IntArray = self._label[index[:, 0], index[:, 1]]
        return found

    def _free_columns(self, voxels: VoxelMap) -> BoolArray:
        grid = voxels.grid
        low, high = np.clip(np.rint((self._band_m - grid.origin_world_m[2]) / grid.resolution_m), 0, grid.shape[2]).astype(int)
        if low == high:
            low, high = 0, grid.shape[2]
        free: BoolArray = (voxels.state[:, :, low:high] == FREE).mean(axis=2) >= FREE_SHARE
        return free


def labels(free: BoolArray, core: float) -> IntArray:
    """Return the room (nx, ny) of each column, 1 and more; 0 if there is no core.

    free: (nx, ny) True for free columns. core: distance in columns to the nearest other one from which on a column is a core.
    """
    away = ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    cores, count = ndimage.label(away >= core, structure=np.ones((3, 3)))
    if count <= 1:
        return np.full(free.shape, count, dtype=np.int64)
    nearest = ndimage.distance_transform_edt(cores == 0, return_distances=False, return_indices=True)
    label: IntArray = cores[tuple(nearest)].astype(np.int64)
    return label
