"""What the tests of the guard fly in: an envelope, bounds, a free space of one's own, a camera that sees a wall."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from uav_recon.safety.envelope import Envelope, Fence, Vec3
from uav_recon.safety.failsafe_precedence import FailsafeTimeouts
from uav_recon.safety.free_space_check import FreeSpaceCheck
from uav_recon.safety.guard import Guard, GuardBounds, GuardInputs, SetpointProposal
from uav_recon.safety.obstacle_speed_limit import ForwardDepth, Margins
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.camera import body_from_camera
from uav_recon.types.frames import BoolArray
from uav_recon.types.maps import FreeSpace, GridSpec
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.polygon import Polygon
from uav_recon.types.trajectory import Setpoint

DT = 1 / 30
HULL_RADIUS_M, HULL_HEIGHT_M = 0.2, 0.2
ENVELOPE = Envelope(
    fence=Fence(plan=Polygon.box((-1.0, -2.0), (5.0, 2.0)), floor_m=-0.1, ceiling_m=2.4, inset_m=0.3),
    max_speed_mps=1.0,
    max_acceleration_mps2=2.0,
    max_yaw_rate_radps=0.8,
)
TIMEOUTS = FailsafeTimeouts(
    pose_timeout_s=0.2,
    pose_land_s=1.0,
    intent_timeout_s=0.5,
    retreat_timeout_s=5.0,
    land_timeout_s=20.0,
    depth_timeout_s=0.3,
    depth_retreat_s=3.0,
    depth_land_s=10.0,
)
BOUNDS = GuardBounds(
    pose_timeout_s=0.2,
    intent_timeout_s=0.5,
    silence_way_m=0.5,
    depth_timeout_s=0.3,
    blind_speed_mps=1.0,
    blind_fresh_s=3.0,
    blind_stale_s=10.0,
    retreat_speed_mps=0.3,
    margins=Margins(stop_clearance_m=0.1, fast_clearance_m=0.4),
)
GRID = GridSpec(np.array([-2.0, -3.0, -1.0]), 0.1, (80, 60, 45))
MOUNT = body_from_camera(np.array([0.1, 0.0, 0.0]), 0.0)


def everything() -> BoolArray:
    return np.ones(GRID.shape, dtype=np.bool_)


def known_free(free: BoolArray, epoch: int = 0) -> FreeSpaceCheck:
    return FreeSpaceCheck(FreeSpace(GRID, np.packbits(free), 1, epoch), HULL_RADIUS_M, HULL_HEIGHT_M)


def frame(range_m: float = 9.0, stamp_s: float = 0.0, share: float = 0.9) -> MinRangeGrid:
    return MinRangeGrid(stamp_s, MOUNT, np.full((12, 16), range_m, dtype=np.float32), (0.95, 0.55), share)


OPEN = known_free(everything())


def situation(now_s: float, **changes: Any) -> GuardInputs:
    ahead = ForwardDepth(frame(stamp_s=now_s - 0.1), HULL_RADIUS_M)
    usual = GuardInputs(now_s, (0.0, 0.0, 1.0), 0.0, np.eye(3), 0.03, 0.05, 0, OPEN, ahead)
    return dataclasses.replace(usual, **changes)


def proposal(
    position: Any = (0.0, 0.0, 1.0),
    velocity: Any = (0.0, 0.0, 0.0),
    acceleration: Any = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    yaw_rate: float = 0.0,
    identifier: int = 1,
    epoch: int = 0,
    retreating: bool = False,
) -> SetpointProposal:
    p, v, a = (np.array(vector, dtype=np.float64) for vector in (position, velocity, acceleration))
    return SetpointProposal(Setpoint(p, v, a, yaw, yaw_rate, 0.0), identifier, epoch, retreating)


def may_stand(envelope: Envelope, place_m: Vec3) -> bool:
    return envelope.admits(place_m, place_m)


def guard_of(envelope: Envelope = ENVELOPE, bounds: GuardBounds = BOUNDS, sight: RecentlySeenSpace | None = None) -> Guard:
    return Guard(envelope, bounds, sight or RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=HULL_RADIUS_M))
