"""Trajectories and intents that the mission sends to the pilot, and the guard's refusals."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from uav_recon.types.frames import FloatArray, frozen
from uav_recon.types.reason import Reason


@dataclass(frozen=True, slots=True, eq=False)
class Setpoint:
    """The desired state at one instant, in odom.

    Position, velocity, acceleration (3,), heading and its rate, camera pitch down.
    """

    position_m: FloatArray
    velocity_mps: FloatArray
    acceleration_mps2: FloatArray
    yaw_rad: float
    yaw_rate_radps: float
    camera_pitch_down_rad: float

    @staticmethod
    def hold(position_m: FloatArray, yaw_rad: float, camera_pitch_down_rad: float = 0.0) -> Setpoint:
        """Return a setpoint at rest."""
        return Setpoint(np.asarray(position_m, dtype=np.float64), np.zeros(3), np.zeros(3), yaw_rad, 0.0, camera_pitch_down_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A sampled motion that ENDS AT REST in space that was known free when it was made.

    position_m, velocity_mps, acceleration_mps2: (N, 3) in odom; yaw_rad (N,) unwrapped; yaw_rate_radps (N,);
    camera_pitch_down_rad (N,). Sample i is at start_s + i * step_s. views_s: instants, relative to start_s, at which
    a view will be captured. clearance_m: that it keeps, None = not stated.
    """

    start_s: float
    step_s: float
    position_m: FloatArray
    velocity_mps: FloatArray
    acceleration_mps2: FloatArray
    yaw_rad: FloatArray
    yaw_rate_radps: FloatArray
    camera_pitch_down_rad: FloatArray
    views_s: FloatArray
    map_epoch: int
    identifier: int
    clearance_m: float | None = None

    def __post_init__(self) -> None:
        for name in (
            "position_m", "velocity_mps", "acceleration_mps2", "yaw_rad", "yaw_rate_radps", "camera_pitch_down_rad", "views_s",
        ):  # fmt: skip
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name), dtype=np.float64)))

    @property
    def duration_s(self) -> float:
        """Time from start to rest in seconds."""
        return float((len(self.yaw_rad) - 1) * self.step_s)

    def setpoint_at(self, now_s: float) -> Setpoint:
        """Return the setpoint at an instant.

        Before the start it is the first sample, after the end it is at rest at the last one.
        """
        t = min(max((now_s - self.start_s) / self.step_s, 0.0), len(self.yaw_rad) - 1.0)
        i = min(int(t), max(len(self.yaw_rad) - 2, 0))
        j = min(i + 1, len(self.yaw_rad) - 1)
        f = t - i

        def mix(a: FloatArray) -> FloatArray:
            mixed: FloatArray = (1 - f) * a[i] + f * a[j]
            return mixed

        return Setpoint(
            mix(self.position_m),
            mix(self.velocity_mps),
            mix(self.acceleration_mps2),
            float(mix(self.yaw_rad)),
            float(mix(self.yaw_rate_radps)),
            float(mix(self.camera_pitch_down_rad)),
        )


class Goal(Enum):
    """The action that the mission requests from the pilot."""

    STANDBY = "standby"  # on the ground: be ready, do not arm
    FLY = "fly"  # arm if on the ground, then follow the trajectory
    LAND = "land"  # land here and disarm


@dataclass(frozen=True, slots=True, eq=False)
class Intent:
    """The mission's proposal, renewed at every mission step: stamp_s is the mission's heartbeat.

    note: message for people in flight, None for nothing. operator_lost: no operator attends any more, so an operator's hold no
    longer applies. seeing_yaw_rad: the nearest heading, in the world, in which the camera shows where the vehicle is; None if
    none is known.
    """

    stamp_s: float
    goal: Goal
    trajectory: Trajectory | None = None
    note: Reason | None = None
    operator_lost: bool = False
    seeing_yaw_rad: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Refusal:
    """A proposal that the guard rejected, the reason, and the setpoint that is flown instead."""

    reason: Reason
    instead: Setpoint
