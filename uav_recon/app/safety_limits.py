"""Limits of guard and failsafe: [safety] of the config as bounds, envelope and timeouts."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from uav_recon.config import Config
from uav_recon.errors import EXIT_CONFIG, UserError

if TYPE_CHECKING:  # each process imports only the stages that it runs
    from uav_recon.safety.envelope import Envelope
    from uav_recon.safety.failsafe_precedence import FailsafeTimeouts
    from uav_recon.safety.guard import GuardBounds
    from uav_recon.safety.recently_seen_space import RecentlySeenSpace


def failsafe_timeouts(config: Config) -> FailsafeTimeouts:
    """Return the timeouts of the failsafe, each under its key in [safety]."""
    from uav_recon.safety.failsafe_precedence import FailsafeTimeouts

    safety = config.safety
    return FailsafeTimeouts(
        pose_timeout_s=safety.pose_timeout_s,
        pose_land_s=safety.pose_land_s,
        intent_timeout_s=safety.intent_timeout_s,
        retreat_timeout_s=safety.retreat_timeout_s,
        land_timeout_s=safety.land_timeout_s,
        depth_timeout_s=safety.depth_timeout_s,
        depth_retreat_s=safety.depth_retreat_s,
        depth_land_s=safety.depth_land_s,
    )


def guard_bounds(config: Config) -> GuardBounds:
    """Return the guard's limits on ages, speeds and clearances, each under its key in [safety]."""
    from uav_recon.safety.guard import GuardBounds
    from uav_recon.safety.obstacle_speed_limit import Margins

    safety = config.safety
    return GuardBounds(
        pose_timeout_s=safety.pose_timeout_s,
        intent_timeout_s=safety.intent_timeout_s,
        silence_way_m=safety.silence_way_m,
        depth_timeout_s=safety.depth_timeout_s,
        blind_speed_mps=safety.blind_speed_mps,
        blind_fresh_s=safety.blind_fresh_s,
        blind_stale_s=safety.blind_stale_s,
        retreat_speed_mps=safety.retreat_speed_mps,
        margins=Margins(stop_clearance_m=safety.stop_clearance_m, fast_clearance_m=safety.fast_clearance_m),
    )


def envelope(config: Config) -> Envelope:
    """Return the guard's fence and limits.

    Raises UserError if the fence does not contain the take-off column.
    """
    from uav_recon.safety.envelope import Envelope, Fence

    safety = config.safety
    fence = Fence(
        plan=safety.fence_plan(), floor_m=safety.fence_min_m[2], ceiling_m=safety.fence_max_m[2], inset_m=safety.fence_inset_m
    )
    try:
        return Envelope(
            fence=fence,
            max_speed_mps=safety.max_speed_mps,
            max_acceleration_mps2=safety.max_acceleration_mps2,
            max_yaw_rate_radps=math.radians(safety.max_yaw_rate_degps),
        )
    except ValueError as error:
        raise UserError(f"safety: {error}", EXIT_CONFIG) from None


def recently_seen_space(config: Config) -> RecentlySeenSpace:
    """Return an empty memory of the space that the camera saw."""
    from uav_recon.safety.recently_seen_space import RecentlySeenSpace

    safety = config.safety
    return RecentlySeenSpace(blind_memory_s=safety.blind_memory_s, vehicle_radius_m=safety.vehicle_radius_m)
