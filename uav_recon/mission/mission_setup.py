"""Parts of a mission: its stages, channels and parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_recon.interfaces import (
    Channel,
    Mapper,
    OccupancyMapInterface,
    Planner,
    RecentViewMemoryInterface,
    SpeedLimitedMotion,
    ViewBudget,
)
from uav_recon.types.camera import PosedFrame
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.maps import FreeSpace, SurfaceElements, VoxelMap
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import MapCorrection
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Intent
from uav_recon.types.vehicle import MissionProgress, VehicleState


@dataclass(frozen=True)
class MissionStages:
    """The stages, through their protocols.

    retreat: motion along paths that were flown already, with less clearance.
    """

    voxels: OccupancyMapInterface
    budget: ViewBudget
    mapper: Mapper
    planner: Planner
    motion: SpeedLimitedMotion
    retreat: SpeedLimitedMotion
    recent_views: RecentViewMemoryInterface


@dataclass(frozen=True)
class MissionChannels:
    """The channels of the mission process."""

    frames: Channel[PosedFrame]
    vehicle: Channel[VehicleState]
    intent: Channel[Intent]
    progress: Channel[MissionProgress]
    voxels: Channel[VoxelMap]
    surface: Channel[SurfaceElements]
    plan: Channel[ViewPath]
    correction: Channel[MapCorrection]
    free: Channel[FreeSpace]
    perception: Channel[PerceptionStatus]
    cones: Channel[FreeCone]


@dataclass(frozen=True)
class MissionParameters:
    """Parameters of this mission, in SI units.

    takeoff_top_m: height to which the operator knows the column above the pad, takeoff_top_radius_m wide, to be free.
    clear_radius_m: every position where the vehicle flew is free within this radius. clearance_m: of planned paths.
    operator_timeout_s: see OperatorWatchdog.
    """

    views: int
    survey_views: int
    view_spacing_m: float
    takeoff_height_m: float
    takeoff_radius_m: float
    takeoff_top_m: float
    takeoff_top_radius_m: float
    vehicle_height_m: float
    clear_radius_m: float
    camera_pitch_down_rad: float
    max_flight_s: float
    plan_cost_s: float
    clearance_m: float
    operator_timeout_s: float = math.inf
