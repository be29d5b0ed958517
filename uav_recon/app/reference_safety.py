"""Protective numbers that a simulated flight and a replay have in common.

They are no defaults: [safety] has none, and nothing falls back to them. A real vehicle has a config of its own, see
systemd/config.toml. Fence, hull and speed outside the view are left to the flight.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

MAX_SPEED_MPS = 1.2

REFERENCE_SAFETY: Mapping[str, object] = MappingProxyType(
    {
        "fence_corners_m": [],
        "max_speed_mps": MAX_SPEED_MPS,
        "max_acceleration_mps2": 2.0,
        "max_yaw_rate_degps": 60.0,
        "stop_clearance_m": 0.1,
        "fast_clearance_m": 0.4,
        "blind_fresh_s": 3.0,
        "blind_stale_s": 10.0,
        "blind_memory_s": 60.0,  # space above and below a fixed camera's view was mostly seen more than 10 s ago
        "retreat_speed_mps": 0.3,
        "silence_way_m": 0.45,
        "intent_timeout_s": 0.5,
        "retreat_timeout_s": 5.0,
        "pose_timeout_s": 0.25,
        "pose_land_s": 0.7,
        "land_timeout_s": 20.0,
        "depth_timeout_s": 0.3,
        "depth_retreat_s": 3.0,
        "depth_land_s": 10.0,
    }
)
