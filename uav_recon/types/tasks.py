"""What the planner works on and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from uav_recon.types.frames import FloatArray, frozen
from uav_recon.types.maps import SurfaceElements, VoxelMap
from uav_recon.types.reason import Reason


class TaskKind(Enum):
    """Why a place is worth a look."""

    EXPLORE = "explore"
    RECONSTRUCT = "reconstruct"


class PlanMode(Enum):
    """The planner's mode (paper, section III-C): frontiers only, or frontiers and uncertain surface together."""

    EXPLORE = "explore"
    MERGED = "merged"


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """Where the BODY is to be: position (3,), heading, and how far the camera looks down (fixed mounts: their angle)."""

    position_world: FloatArray
    yaw_rad: float
    pitch_down_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_world", frozen(np.asarray(self.position_world, dtype=np.float64)))


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """One place worth a look, and the best view of it. gain: unknown voxels beyond a frontier, or sum of |n.v| sigma."""

    kind: TaskKind
    centroid_world: FloatArray
    viewpoint: Viewpoint
    gain: float


@dataclass(frozen=True, slots=True, eq=False)
class ViewPath:
    """Views in order, and the way to each: waypoints_world[i] is (Ni, 3), from the previous view to view i, ends included.

    mode: how it was chosen. task_s: seconds spent making tasks, step_s: the whole plan (compute time, for the report).
    clearance_m: what its way keeps, body centre to anything not known free; None = what ways usually keep.
    """

    viewpoints: tuple[Viewpoint, ...]
    waypoints_world: tuple[FloatArray, ...]
    mode: PlanMode
    map_revision: int
    map_epoch: int
    tasks: tuple[Task, ...]
    task_s: float
    step_s: float
    clearance_m: float | None = None


@dataclass(frozen=True, slots=True)
class NothingLeft:
    """No task is worth a flight. reason says why, with counts of frontiers as its details."""

    reason: Reason
    task_s: float
    step_s: float


@dataclass(frozen=True, slots=True, eq=False)
class PlanRequest:
    """Everything a plan depends on; the same request gives the same plan."""

    voxels: VoxelMap
    surface: SurfaceElements | None
    position_world: FloatArray
    yaw_rad: float
    views_left: int
    velocity_world_mps: FloatArray = field(default_factory=lambda: np.zeros(3))
