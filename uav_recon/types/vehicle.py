"""State of the vehicle as the autopilot reports it, and progress of the mission."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from uav_recon.types.frames import FloatArray, frozen
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason


class FlightPhase(Enum):
    """The pilot's state towards the autopilot."""

    CONNECTING = "connecting"  # no heartbeat, no pose, or the estimator does not follow yet
    READY = "ready"  # on the ground, all conditions for arming are met
    ARMING = "arming"  # setpoints are sent, mode and arming requested, not confirmed yet
    FLYING = "flying"  # armed, our mode, following trajectories or holding
    LANDING = "landing"  # land mode commanded or observed
    LANDED = "landed"  # disarmed after a flight
    YIELDED = "yielded"  # no control (a human, another sender, an unresponsive autopilot): no setpoint, mode or arm command


IN_THE_AIR = (FlightPhase.FLYING, FlightPhase.LANDING)


@dataclass(frozen=True, slots=True, eq=False)
class VehicleState:
    """Telemetry in our frames; world = odom at epoch 0.

    mode: '' until the autopilot has reported it and whether it is armed. battery_fraction: NaN if unknown.
    camera_pitch_down_rad: measured gimbal pitch, NaN on a fixed mount. camera_pitch_s: when it was measured.
    trajectory_id: the trajectory being flown, -1 for none. refusals: number of proposals that the guard has rejected.
    note: the newest reason (refused arming, failsafe, refusal), None for none. max_speed_mps: the guard's speed limit now;
    slow_reason: why it is reduced, None if it is not.
    operator_received_s: when the pilot last answered its operator, companion's clock; -inf: not since it started.
    world_from_rest: where braking from the newest setpoint ends; None before the first.
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
    slow_reason: Reason | None = None
    camera_pitch_s: float = math.nan

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity_world_mps", frozen(np.asarray(self.velocity_world_mps, dtype=np.float64)))


@dataclass(frozen=True, slots=True, eq=False)
class TurnRates:
    """The newest turn rates of the autopilot's gyro, oldest first.

    stamps_s: (N,) on the companion's clock. rates_radps: (N, 3), body FLU.
    """

    stamps_s: FloatArray
    rates_radps: FloatArray

    def __post_init__(self) -> None:
        for name in ("stamps_s", "rates_radps"):
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name), dtype=np.float64)))


@dataclass(frozen=True, slots=True, eq=False)
class ReportedPoses:
    """The newest poses of an autopilot that navigates by itself, oldest first.

    On the companion's clock, body in a frame of the autopilot with z up.
    """

    poses: tuple[StampedPose, ...]


@dataclass(frozen=True, slots=True, eq=False)
class MissionProgress:
    """A sample of the mission's progress, for screens, recorders and the report.

    Standard deviations of the place, in the worst direction: predicted_sigma_m: by what the view shows of the map, None where
    poses do not come from it. measured_sigma_m: by the pose of the newest frame, however old; None if unknown.
    """

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
    predicted_sigma_m: float | None = None
    measured_sigma_m: float | None = None
