"""Input and output of the planner."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from uav_recon.types.frames import FloatArray, frozen
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.maps import SurfaceElements, VoxelMap
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason


class TaskKind(Enum):
    """Kind of a task: the purpose of its view."""

    EXPLORE = "explore"
    RECONSTRUCT = "reconstruct"


class PlanMode(Enum):
    """Mode of the planner (paper, section III-C).

    Either frontiers only, or frontiers and uncertain surface together.
    """

    EXPLORE = "explore"
    MERGED = "merged"


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """Pose of the BODY for a view.

    position_world: (3,). yaw_rad: heading. pitch_down_rad: how far the camera looks down (fixed mounts: their angle).
    """

    position_world: FloatArray
    yaw_rad: float
    pitch_down_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_world", frozen(np.asarray(self.position_world, dtype=np.float64)))


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """One position worth a view, and its best view.

    gain: unknown voxels beyond a frontier, or sum of |n.v| sigma.
    """

    kind: TaskKind
    centroid_world: FloatArray
    viewpoint: Viewpoint
    gain: float


@dataclass(frozen=True, slots=True, eq=False)
class ViewPath:
    """Views in order, and the path to each.

    waypoints_world[i] is (Ni, 3), from the previous view to view i, both ends included.

    mode: of the planner. task_s: seconds spent on making tasks; step_s: on the whole plan (compute time, for the report).
    clearance_m: what the path keeps, body centre to anything not known free; None = the usual clearance.
    frontiers: number of frontiers that are left to view, those beyond the end of this path included.
    explored: no opening into unknown space can be viewed any more.
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
    frontiers: int = 0
    explored: bool = False

    def first(self) -> ViewPath:
        """Return the path to its first view alone."""
        return replace(self, viewpoints=self.viewpoints[:1], waypoints_world=self.waypoints_world[:1], tasks=self.tasks[:1])


@dataclass(frozen=True, slots=True)
class NothingLeft:
    """No task is worth a flight.

    reason: with the counts of frontiers as its details.
    """

    reason: Reason
    task_s: float
    step_s: float


class NextView(Enum):
    """Outcome of the next view of a path, and the reason if no image of it will come."""

    KEPT = "kept"
    REFUSED = "refused"  # the guard refused the motion to it, because space on it was not seen lately, or none was found
    LEFT = "left"  # the vehicle left the way to it, because its place is uncertain there


@dataclass(frozen=True, slots=True, eq=False)
class PlanRequest:
    """All inputs of a plan; the same request gives the same plan.

    next_view: what became of the next view of the accepted path. cells: surface by which the camera tells where it is; None if
    that does not matter. keyframes: world_from_depth of the keyframes of this map epoch, oldest first.
    """

    voxels: VoxelMap
    surface: SurfaceElements | None
    position_world: FloatArray
    yaw_rad: float
    views_left: int
    velocity_world_mps: FloatArray = field(default_factory=lambda: np.zeros(3))
    next_view: NextView = NextView.KEPT
    cells: SurfaceCells | None = None
    keyframes: tuple[Pose, ...] = ()
