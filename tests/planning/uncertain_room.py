"""Room with surface elements as the mapper gives them.

The elements are dense and mostly certain, with a few uncertain patches.
"""

from __future__ import annotations

import itertools

import numpy as np
from box_world import MEETING_ROOM, Solid, voxel_map

from uav_recon.planning.candidate_view import PlanningContext
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.frontier.frontiers import fence_box
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, SurfaceElements, VoxelMap


def elements_of(solid: Solid, per_face: int = 4, seed: int = 0) -> SurfaceElements:
    """Return elements on every face between air and solid.

    Normals point into the air. The uncertainty is low, with high patches.
    """
    rng = np.random.default_rng(seed)
    positions, normals = [], []
    for axis, sign in itertools.product(range(3), (-1, 1)):
        air_beside = np.roll(~solid, -sign, axis=axis) & solid
        air_beside[[0, -1] if axis == 0 else slice(None)] &= axis != 0 or sign * np.array([1, -1])[:, None, None] > 0
        cells = np.repeat(np.argwhere(air_beside), per_face, axis=0)
        points = cells + rng.random((len(cells), 3))
        points[:, axis] = cells[:, axis] + (1.0 if sign > 0 else 0.0)
        positions.append((points - 1.0) * 0.1)
        normals.append(np.tile(np.eye(3)[axis] * sign, (len(points), 1)))
    position, normal = np.concatenate(positions), np.concatenate(normals)
    blots = position[rng.integers(len(position), size=25)]
    away = np.sqrt(((position[:, None] - blots) ** 2).sum(axis=-1)).min(axis=1)
    uncertainty = 0.01 * rng.random(len(position)) + np.exp(-((away / 0.35) ** 2))
    order = rng.permutation(len(position))
    return SurfaceElements(position[order], normal[order], uncertainty[order], 1)


def seen_room(solid: Solid = MEETING_ROOM) -> VoxelMap:
    """Return a map in which the whole room is known."""
    return voxel_map(np.where(solid, OCCUPIED, FREE).astype(np.uint8), 1)


def situation_in(voxels: VoxelMap, position: FloatArray, clearance_m: float = 0.35) -> PlanningContext:
    size_m = (np.array(voxels.grid.shape) - 2) * voxels.grid.resolution_m
    low, high = fence_box(voxels.grid, np.full(3, clearance_m), size_m - clearance_m)
    space = FlyableSpace(voxels.grid, clearance_m, low, high)
    space.update(voxels)
    exit_cells = space.locate_vehicle(position)
    assert exit_cells is not None
    return PlanningContext(voxels, space, exit_cells, position)
