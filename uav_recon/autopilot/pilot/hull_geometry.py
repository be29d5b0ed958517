"""Geometry of the vehicle and its flight, as the pilot needs it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class HullGeometry:
    """Hull (m), hover height over the pad (m), gimbal."""

    vehicle_radius_m: float
    vehicle_height_m: float
    hover_height_m: float
    gimbal: bool = False
