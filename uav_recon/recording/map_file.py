"""File of the final voxel map of a flight: voxels.npz in its folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uav_recon import atomic_file
from uav_recon.types.maps import GridSpec, VoxelMap

VOXELS = "voxels.npz"


def save_map(folder: Path, voxels: VoxelMap) -> None:
    """Write the map atomically."""
    grid = voxels.grid
    with atomic_file.writing(folder / VOXELS, durable=False) as file:
        np.savez_compressed(
            file,
            origin_world_m=grid.origin_world_m,
            resolution_m=grid.resolution_m,
            state=voxels.state,
            distance2=voxels.distance2,
            revision=voxels.revision,
            map_epoch=voxels.map_epoch,
        )


def load_map(folder: Path) -> VoxelMap | None:
    """Read the map; None if the flight has none."""
    path = folder / VOXELS
    if not path.exists():
        return None
    with np.load(path) as data:
        state = data["state"]
        grid = GridSpec(data["origin_world_m"], float(data["resolution_m"]), (state.shape[0], state.shape[1], state.shape[2]))
        return VoxelMap.whole(grid, state, data["distance2"], int(data["revision"]), int(data["map_epoch"]))
