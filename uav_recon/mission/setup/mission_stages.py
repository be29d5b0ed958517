"""Stages of a mission, through their protocols."""

from __future__ import annotations

from dataclasses import dataclass

from uav_recon.interfaces import (
    LocalizabilityInterface,
    Mapper,
    OccupancyMapInterface,
    Planner,
    RecentViewMemoryInterface,
    SpeedLimitedMotion,
    ViewBudget,
)


@dataclass(frozen=True)
class MissionStages:
    """The stages, through their protocols.

    retreat: motion along paths that were flown already, with less clearance.
    localizability: None where poses do not come from the camera's view.
    """

    voxels: OccupancyMapInterface
    budget: ViewBudget
    mapper: Mapper
    planner: Planner
    motion: SpeedLimitedMotion
    retreat: SpeedLimitedMotion
    recent_views: RecentViewMemoryInterface
    localizability: LocalizabilityInterface | None = None
