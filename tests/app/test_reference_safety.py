"""Reference of [safety]: keys of the config, without those of the flight."""

from __future__ import annotations

from uav_recon.app.reference_safety import REFERENCE_SAFETY
from uav_recon.config import SafetyConfig

OF_THE_FLIGHT = {"fence_min_m", "fence_max_m", "fence_inset_m", "vehicle_radius_m", "vehicle_height_m", "blind_speed_mps"}


def test_the_reference_leaves_fence_hull_and_blind_speed_to_the_flight() -> None:
    assert set(SafetyConfig.model_fields) - set(REFERENCE_SAFETY) == OF_THE_FLIGHT
    assert set(REFERENCE_SAFETY) <= set(SafetyConfig.model_fields)
