"""What is known of the one autopilot we fly."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from uav_recon.autopilot.mavlink.messages import ParameterValue
from uav_recon.types.frames import FloatArray
from uav_recon.types.reason import Reason

_BATTERY_FRESH_S = 1.0  # it is told twice a second


@dataclass(slots=True)
class Telemetry:
    """The newest word of the autopilot. Instants are ours; -inf = never."""

    system: int = 0  # MAVLink system id of the vehicle; 0 = nobody heard
    received_s: float = -math.inf
    heartbeat_s: float = -math.inf
    firmware_family: int = 0  # MAV_AUTOPILOT
    armed: bool = False
    custom_mode: int = 0
    on_ground_s: float = -math.inf  # when its land detector said so last, unless it has said otherwise since
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
    twin_heard: bool = False  # somebody else speaks with our own id
    stranger: Reason | None = None  # why the autopilot that answers is not the one that we fly
    doubled: bool = False  # two autopilots speak with its id: whose word is whose is not known
    slow: bool = False  # what we say takes so long that the vehicle lags by what planned ways keep from walls
    reboots: int = 0
    stale_frames: int = 0  # repeated, or overtaken by newer ones
    clock_answers: int = 0  # given to its questions for our clock, at once
    parameters: dict[str, ParameterValue] = field(default_factory=dict)  # those that were asked for, by name
    failure: Reason | None = None  # why the byte link failed last

    def battery_at(self, now_s: float) -> float:
        """Share that is left, NaN where it is not told (any more)."""
        return self.battery_fraction if now_s - self.battery_s <= _BATTERY_FRESH_S else math.nan
