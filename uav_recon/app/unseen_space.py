"""Space of the room that a flight left unknown, with the reason and the remedy."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from uav_recon.app.room_check import MountAdvice, advise
from uav_recon.config import Config
from uav_recon.recording.map_file import load_map
from uav_recon.recording.report import Report, ReportUnseen
from uav_recon.types.frames import BoolArray
from uav_recon.types.maps import FREE, UNKNOWN, VoxelMap

UPPER_M = 1.7  # height over the floor: the upper part of a room begins here
BODY_M = 0.8  # height over the floor: a column that is free between here and UPPER_M belongs to the room
MUCH = 0.15  # of one part of the room: a larger unknown share is reported first


def with_unseen(report: Report, config: Config, folder: Path) -> Report:
    """Return the report with the space that the map in a flight folder does not know."""
    voxels = load_map(folder)
    found = None if voxels is None else unseen_space(voxels, config, report.views)
    return dataclasses.replace(report, unseen=found)


def unseen_space(voxels: VoxelMap, config: Config, views: int) -> ReportUnseen | None:
    """Return the unknown shares of the room, None if the map shows no room.

    Only columns that are known free at the height of flight count: beside them there may be no room. views: taken.
    """
    floor_m = -0.5 * config.safety.vehicle_height_m
    heights_m = voxels.grid.origin_world_m[2] + (np.arange(voxels.grid.shape[2]) + 0.5) * voxels.grid.resolution_m
    over_floor_m = heights_m - floor_m
    inside = (heights_m > config.safety.fence_min_m[2]) & (heights_m < config.safety.fence_max_m[2])
    flown = (over_floor_m > BODY_M) & (over_floor_m <= UPPER_M)
    columns: BoolArray = (voxels.state[:, :, flown] == FREE).any(axis=2)
    if not columns.any():
        return None
    unknown = voxels.state[columns] == UNKNOWN
    upper, lower = (_share(unknown[:, inside & part]) for part in (over_floor_m > UPPER_M, over_floor_m <= UPPER_M))
    text = _text(upper, lower, config, advise(config), views)
    return ReportUnseen(upper, lower, UPPER_M, text)


def _share(unknown: BoolArray) -> float:
    return float(unknown.mean()) if unknown.size else 0.0


def _text(upper: float, lower: float, config: Config, advice: MountAdvice | None, views: int) -> str:
    """Return one sentence with reason and remedy, '' if little is unknown."""
    if max(upper, lower) <= MUCH:
        return ""
    above = upper > lower
    part = f"{100.0 * max(upper, lower):.0f} % of the room {'above' if above else 'below'} {UPPER_M:g} m"
    if above and advice is not None and not advice.fits:
        return (
            f"{part} was out of the camera's sight: a tilt of {advice.recommended_deg:g}° "
            f"would have shown {advice.recommended_share:.2f} of the room, {advice.tilt_deg:g}° shows {advice.share:.2f}"
        )
    if views >= config.mission.views:
        return f"{part} was not seen: the view budget of {config.mission.views} is too small (mission.views)"
    if above and config.voxels.takeoff_top_m is None:
        return f"{part} was not seen: voxels.takeoff_top_m can declare how far the vehicle may climb above the pad"
    return f"{part} was not seen"
