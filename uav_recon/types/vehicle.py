"""What the autopilot says of the vehicle, and what the mission says of itself."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from uav_recon.types.frames import FloatArray, frozen
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason


class FlightPhase(Enum):
    """The pilot's own account of where it stands with the autopilot."""

    CONNECTING = "connecting"  # no heartbeat, no pose, or the estimator does not follow yet
    READY = "ready"  # on the ground, everything needed for arming is there
    ARMING = "arming"  # stream runs, mode and arm requested, not confirmed yet
    FLYING = "flying"  # armed, our mode, following trajectories or holding
    LANDING = "landing"  # land mode commanded or met
    LANDED = "landed"  # disarmed after a flight
    YIELDED = "yielded"  # not ours any more (a human's, another's, silent, deaf): no setpoint, mode or arm command goes out


@dataclass(frozen=True, slots=True, eq=False)
class VehicleState:
    """Telemetry in our frames; world = odom at epoch 0.

    mode: '' until the autopilot has told it, and whether it is armed. battery_fraction: NaN if unknown.
    camera_pitch_down_rad: measured gimbal pitch, NaN on a fixed mount.
    trajectory_id: the trajectory being flown, -1 for none. refusals: proposals turned down by the guard so far.
    note: the newest reason (refused arming, failsafe, refusal). max_speed_mps: the guard's speed limit now.
    operator_received_s: when the pilot last answered its operator, companion's clock; -inf: not since it started.
    world_from_rest: of its setpoints, where braking from the newest ends; None before the first.
    """

    stamp_s: float
    world_from_body: Pose
    velocity_world_mps: FloatArray
    armed: bool
    mode: str
    phase: FlightPhase
    battery_fraction: float
    human_in_control: bool
    camera_pitch_down_rad: float
    trajectory_id: int
    refusals: int
    note: Reason | None
    max_speed_mps: float = math.inf
    operator_received_s: float = -math.inf
    world_from_rest: Pose | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity_world_mps", frozen(np.asarray(self.velocity_world_mps, dtype=np.float64)))


@dataclass(frozen=True, slots=True, eq=False)
class MissionProgress:
    """One line of the mission's life, for screens, recorders and the report."""

    stamp_s: float
    phase: str
    mode: str
    views: int
    views_budget: int
    explored_m3: float
    path_length_m: float
    frontiers: int
    tasks: int
    plans: int
    planning_s: float
    note: Reason | None
    finished: bool
    position_world: FloatArray = field(default_factory=lambda: np.zeros(3))
