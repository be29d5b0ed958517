"""A task that can be flown to: what the tour orders and the memory keeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.free_space.subvoxel_clearance import CLEAR, blocking_voxel
from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.maps import VoxelMap
from uav_recon.types.tasks import Task

MIN_SEEN = 10  # frontier cells: a view of fewer is not worth a stop


@dataclass(frozen=True, slots=True, eq=False)
class CandidateView:
    """task; place: (3,) where its viewpoint is, padded voxel units of the flyable space.

    promised: (M,) flat indices into VoxelMap.state of the frontier cells, or of the voxels of surface, that it should settle.
    squareness: (M,) cosine under which each is seen; 1 for frontier cells.
    """

    task: Task
    place: FloatArray
    promised: IntArray
    squareness: FloatArray

    def gaining(self, gain: float) -> CandidateView:
        """The same with another gain."""
        task = Task(self.task.kind, self.task.centroid_world, self.task.viewpoint, float(gain))
        return CandidateView(task, self.place, self.promised, self.squareness)


@dataclass(frozen=True, slots=True, eq=False)
class PlanningContext:
    """What one plan looks at: the map, where the vehicle is and may fly, and the way out to the first such cell."""

    voxels: VoxelMap
    space: FlyableSpace
    exit_cells: IntArray
    position_world: FloatArray

    def holds(self, place: FloatArray) -> bool:
        """Whether a place (3,), padded voxel units, is in a voxel that can be flown to, and clear itself."""
        x, y, z = (place - 1.0).tolist()
        shape, space = self.voxels.grid.shape, self.space
        beside = blocking_voxel(self.voxels.distance2.reshape(-1), shape, space.berth, x, y, z)
        return bool(beside == CLEAR and space.reachable.reshape(-1)[space.flat(np.floor(place).astype(np.int64))])
