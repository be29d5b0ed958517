"""Candidate views: reachable tasks that the tour orders and the view history keeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.free_space.subvoxel_clearance import CLEAR, blocking_voxel
from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.maps import VoxelMap
from uav_recon.types.tasks import Task, Viewpoint

MIN_SEEN = 10  # frontier cells; a view of fewer is not worth a stop


@dataclass(frozen=True, slots=True, eq=False)
class CandidateView:
    """A task with its view position and the voxels that the view should settle.

    position_padded: (3,) position of the viewpoint, in padded voxel units of the flyable space.
    expected_voxels: (M,) flat indices into VoxelMap.state of the frontier cells or surface voxels that the view should settle.
    view_cosine: (M,) cosine of the angle between surface normal and direction to the camera; 1 for frontier cells.
    """

    task: Task
    position_padded: FloatArray
    expected_voxels: IntArray
    view_cosine: FloatArray

    def with_gain(self, gain: float) -> CandidateView:
        """Return a copy with another gain."""
        task = Task(self.task.kind, self.task.centroid_world, self.task.viewpoint, float(gain))
        return CandidateView(task, self.position_padded, self.expected_voxels, self.view_cosine)

    def with_heading(self, yaw_rad: float) -> CandidateView:
        """Return a copy with another heading of its view."""
        view = self.task.viewpoint
        turned = Viewpoint(view.position_world, yaw_rad, view.pitch_down_rad)
        task = Task(self.task.kind, self.task.centroid_world, turned, self.task.gain)
        return CandidateView(task, self.position_padded, self.expected_voxels, self.view_cosine)


@dataclass(frozen=True, slots=True, eq=False)
class PlanningContext:
    """The inputs of one plan: map, flyable space, vehicle position and exit cells.

    exit_cells: flat cells from the vehicle's cell to the nearest flyable cell, see FlyableSpace.locate_vehicle().
    """

    voxels: VoxelMap
    space: FlyableSpace
    exit_cells: IntArray
    position_world: FloatArray

    def is_clear(self, position_padded: FloatArray) -> bool:
        """Return True if a position (3,) is reachable and has the full clearance.

        The position is in padded voxel units.
        """
        x, y, z = (position_padded - 1.0).tolist()
        shape, space = self.voxels.grid.shape, self.space
        blocking = blocking_voxel(self.voxels.distance2.reshape(-1), shape, space.clearance_box, x, y, z)
        cell = space.flat_index(np.floor(position_padded).astype(np.int64))
        return bool(blocking == CLEAR and space.reachable.reshape(-1)[cell])
