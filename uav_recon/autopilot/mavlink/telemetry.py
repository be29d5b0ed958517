"""Telemetry: the newest data of the one autopilot that is flown."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from uav_recon.autopilot.mavlink.messages import ParameterValue
from uav_recon.types.frames import FloatArray
from uav_recon.types.reason import Reason

_BATTERY_FRESH_S = 1.0  # it is reported twice a second


@dataclass(slots=True)
class Telemetry:
    """The newest values that the autopilot reported. Instants are on our clock; -inf = never."""

    system: int = 0  # MAVLink system id of the vehicle; 0 = none received
    received_s: float = -math.inf
    heartbeat_s: float = -math.inf
    firmware_family: int = 0  # MAV_AUTOPILOT
    armed: bool = False
    custom_mode: int = 0
    on_ground_s: float = -math.inf  # when its land detector last reported the ground, unless it has reported otherwise since
    version: tuple[int, int, int] | None = None
    estimator_good: bool = False
    prearm_good: bool = False
    origin_known: bool = False
    battery_fraction: float = math.nan
    battery_s: float = -math.inf
    position_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    velocity_mps: FloatArray = field(default_factory=lambda: np.zeros(3))
    quat_wxyz: FloatArray = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    camera_pitch_down_rad: float = math.nan
    refused_command: int = 0  # newest command answered with anything but "accepted" or "in progress"
    warning: str = ""  # newest text of severity warning or worse
    pose_fed_s: float = -math.inf
    own_id_in_use: bool = False  # another sender uses our own id
    identity_fault: Reason | None = None  # why the autopilot that answers is not the one that is flown
    duplicate_autopilot: bool = False  # two autopilots use its id: their messages cannot be distinguished
    slow: bool = False  # our messages are too late: the lag uses up the clearance of planned paths
    reboots: int = 0
    stale_frames: int = 0  # repeated, or overtaken by newer ones
    clock_answers: int = 0  # prompt answers to its requests for our clock
    parameters: dict[str, ParameterValue] = field(default_factory=dict)  # those that were requested, by name
    failure: Reason | None = None  # why the byte link failed last

    def battery_at(self, now_s: float) -> float:
        """Return the remaining share of the battery, NaN if it is not reported (any more)."""
        return self.battery_fraction if now_s - self.battery_s <= _BATTERY_FRESH_S else math.nan
