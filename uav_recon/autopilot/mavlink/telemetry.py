"""Telemetry: the autopilot's reports as a frozen value, replaced with each of its messages.

Instants are on our clock; -inf = never.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from uav_recon.autopilot.mavlink.messages import (
    Attitude,
    EstimatorStatus,
    Firmware,
    GimbalAttitude,
    Heartbeat,
    LandedState,
    LocalPosition,
    Message,
    OriginSet,
    ParameterValue,
    StatusText,
    SystemStatus,
    UpwardRange,
)
from uav_recon.types.frames import FloatArray, frozen

_BATTERY_FRESH_S = 1.0  #: reject: an older value of the battery; it is reported twice a second
_WARNING = 4  #: internal: MAV_SEVERITY up to which a text is kept, to be shown with a refusal


@dataclass(frozen=True, slots=True)
class ModeReport:
    """Mode and motors, as reported by the newest heartbeat."""

    heartbeat_s: float = -math.inf
    firmware_family: int = 0  # MAV_AUTOPILOT
    armed: bool = False
    custom_mode: int = 0  # the firmware's own number


@dataclass(frozen=True, slots=True, eq=False)
class MotionEstimate:
    """The autopilot's own estimate, ENU about its origin.

    It is in odom where the link knows the local frame.

    position_m (3,), velocity_mps (3,), quat_wxyz (4,): world_from_body, Hamilton. boot_ms: of position and velocity, on the
    autopilot's clock; -1 before the first.
    """

    position_m: FloatArray = field(default_factory=lambda: frozen(np.zeros(3)))
    velocity_mps: FloatArray = field(default_factory=lambda: frozen(np.zeros(3)))
    quat_wxyz: FloatArray = field(default_factory=lambda: frozen(np.array([1.0, 0.0, 0.0, 0.0])))
    boot_ms: int = -1


@dataclass(frozen=True, slots=True)
class ArmingReadiness:
    """Conditions of arming; unknown after a reboot of the autopilot."""

    estimator_good: bool = False
    prearm_good: bool = False  # the autopilot's own checks pass
    origin_known: bool = False


@dataclass(frozen=True, slots=True)
class BatteryReport:
    """Remaining share of the battery."""

    fraction: float = math.nan  # NaN = unknown
    reported_s: float = -math.inf

    def fraction_at(self, now_s: float) -> float:
        """Return the remaining share, NaN if it is not reported (any more)."""
        return self.fraction if now_s - self.reported_s <= _BATTERY_FRESH_S else math.nan


@dataclass(frozen=True, slots=True)
class RangeReport:
    """The newest reading of a range finder, and when it was measured."""

    reading: UpwardRange
    measured_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """The newest values that the autopilot reported until one moment."""

    system: int = 0  # MAVLink system id of the vehicle; 0 = none received
    received_s: float = -math.inf
    mode: ModeReport = field(default_factory=ModeReport)
    estimate: MotionEstimate = field(default_factory=MotionEstimate)
    readiness: ArmingReadiness = field(default_factory=ArmingReadiness)
    battery: BatteryReport = field(default_factory=BatteryReport)
    on_ground_s: float = -math.inf  # when its land detector last reported the ground, unless it has reported otherwise since
    camera_pitch_down_rad: float = math.nan
    camera_pitch_s: float = math.nan  # when it was measured
    range_up: RangeReport | None = None
    version: tuple[int, int, int] | None = None
    warning: str = ""  # newest text of severity warning or worse
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)  # those that were requested, by name


def updated(t: Telemetry, message: Message, now_s: float) -> Telemetry:
    """Return the telemetry after a message; the same value if nothing of the message is kept."""
    update = _UPDATES.get(type(message))
    return t if update is None else update(t, message, now_s)


def rebooted(t: Telemetry) -> Telemetry:
    """Return the telemetry after a reboot: what may be lost is unknown until reported again."""
    return replace(t, readiness=ArmingReadiness(), parameters={})


def _heartbeat(t: Telemetry, message: Heartbeat, now_s: float) -> Telemetry:
    return replace(t, mode=ModeReport(now_s, message.autopilot, message.armed, message.custom_mode))


def _estimator_status(t: Telemetry, message: EstimatorStatus, now_s: float) -> Telemetry:
    return replace(t, readiness=replace(t.readiness, estimator_good=message.position_good))


def _landed_state(t: Telemetry, message: LandedState, now_s: float) -> Telemetry:
    return replace(t, on_ground_s=now_s if message.on_ground else -math.inf)


def _system_status(t: Telemetry, message: SystemStatus, now_s: float) -> Telemetry:
    readiness = replace(t.readiness, prearm_good=message.prearm_good)
    return replace(t, readiness=readiness, battery=BatteryReport(message.battery_fraction, now_s))


def _local_position(t: Telemetry, message: LocalPosition, now_s: float) -> Telemetry:
    position_m, velocity_mps, boot_ms = message.position_m, message.velocity_mps, message.boot_ms
    return replace(t, estimate=replace(t.estimate, position_m=position_m, velocity_mps=velocity_mps, boot_ms=boot_ms))


def _attitude(t: Telemetry, message: Attitude, now_s: float) -> Telemetry:
    return replace(t, estimate=replace(t.estimate, quat_wxyz=message.quat_wxyz))


def _origin_set(t: Telemetry, message: OriginSet, now_s: float) -> Telemetry:
    return replace(t, readiness=replace(t.readiness, origin_known=True))


def _firmware(t: Telemetry, message: Firmware, now_s: float) -> Telemetry:
    return replace(t, version=message.version)


def _status_text(t: Telemetry, message: StatusText, now_s: float) -> Telemetry:
    return replace(t, warning=message.text) if message.severity <= _WARNING else t


def _gimbal_attitude(t: Telemetry, message: GimbalAttitude, now_s: float) -> Telemetry:
    return replace(t, camera_pitch_down_rad=message.pitch_down_rad, camera_pitch_s=now_s)


def _upward_range(t: Telemetry, message: UpwardRange, now_s: float) -> Telemetry:
    return replace(t, range_up=RangeReport(message, now_s))


def _parameter_value(t: Telemetry, message: ParameterValue, now_s: float) -> Telemetry:
    return replace(t, parameters={**t.parameters, message.name: message})


_UPDATES: dict[type[Message], Callable[[Telemetry, Any, float], Telemetry]] = {
    Heartbeat: _heartbeat,
    EstimatorStatus: _estimator_status,
    LandedState: _landed_state,
    SystemStatus: _system_status,
    LocalPosition: _local_position,
    Attitude: _attitude,
    OriginSet: _origin_set,
    Firmware: _firmware,
    StatusText: _status_text,
    GimbalAttitude: _gimbal_attitude,
    UpwardRange: _upward_range,
    ParameterValue: _parameter_value,
}
