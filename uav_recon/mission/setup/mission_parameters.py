"""Parameters of a mission, from the config."""

from __future__ import annotations

import math
from dataclasses import dataclass


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
