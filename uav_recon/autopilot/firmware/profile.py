"""Firmware profiles: the differences between the firmwares, and common handshakes.

On both, a command counts as done when HEARTBEAT and telemetry show its effect, never by its ACK.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from uav_recon.autopilot.link.link_alerts import TWO
from uav_recon.autopilot.mavlink.telemetry import Telemetry
from uav_recon.types.reason import Reason, autopilot_text
from uav_recon.types.reason_code import ReasonCode

DO_SET_MODE, ARM_DISARM = 176, 400
_HEARTBEAT_S, _POSE_S = 3.0, 0.5

Command = tuple[int, tuple[float, ...]]
Version = tuple[int, int, int]

ARM: Command = (ARM_DISARM, (1.0,))  # the second parameter stays 0: the autopilot's own checks are never overridden
DISARM: Command = (ARM_DISARM, (0.0,))  # likewise: in flight the autopilot refuses it


class Outcome(Enum):
    """State of an attempt to arm."""

    PENDING = "pending"
    ARMED = "armed"
    GIVEN_UP = "given up"


class ArmingSequence(Protocol):
    """Sequence from the ground to where the vehicle follows setpoints.

    streams: True if setpoints must be sent all the time; otherwise none may be sent.
    """

    streams: bool
    reason: Reason | None

    def step(self, now_s: float, t: Telemetry) -> tuple[Outcome, Command | None]:
        """Return the state of the attempt, and the command to send now. GIVEN_UP has a reason."""
        ...


@dataclass(frozen=True, slots=True)
class FirmwareProfile:
    """Rules of a firmware. Modes are HEARTBEAT's custom_mode.

    missing_for_origin and missing_for_arming (telemetry, whether its clock is known, now) name what is missing, None for
    nothing. pose_frame: MAV_FRAME of our ODOMETRY. setpoint_mask: ignored fields of a setpoint. streams_hz: requested messages;
    asked_once: messages requested once; polled_hz: messages requested one by one at this rate, where a rate cannot be set.
    """

    mode_name: Callable[[int], str]
    is_ours: Callable[[int], bool]
    is_landing: Callable[[int], bool]
    missing_for_origin: Callable[[Telemetry, bool, float], Reason | None]
    missing_for_arming: Callable[[Telemetry, bool, float], Reason | None]
    arming: Callable[[float], ArmingSequence]
    land: Command
    pose_frame: int
    setpoint_mask: int
    streams_hz: tuple[tuple[int, float], ...]
    asked_once: tuple[int, ...]
    polled_hz: tuple[tuple[int, float], ...]


def missing_to_follow(
    t: Telemetry, time_known: bool, now_s: float, name: str, family: int, oldest: Version, unknown: Version | None = None
) -> Reason | None:
    """Return what is missing until the autopilot follows our poses, None for nothing.

    family: required MAV_AUTOPILOT. unknown: the first version whose source has not been reviewed; None if every newer one is
    accepted.
    """
    if not now_s - t.heartbeat_s <= _HEARTBEAT_S:
        return Reason(ReasonCode.NO_HEARTBEAT)
    if t.firmware_family != family:
        return Reason(ReasonCode.WRONG_FIRMWARE, (name, t.firmware_family))
    if t.own_id_in_use:
        return Reason(ReasonCode.OUR_ID_IN_USE)
    if t.duplicate_autopilot or t.identity_fault:
        return t.identity_fault or TWO
    if t.version is None:
        return Reason(ReasonCode.FIRMWARE_UNKNOWN)
    if t.version < oldest:
        return Reason(ReasonCode.FIRMWARE_TOO_OLD, (name, _dotted(t.version), _dotted(oldest)))
    if unknown is not None and t.version >= unknown:
        return Reason(ReasonCode.FIRMWARE_TOO_NEW, (name, _dotted(t.version), _dotted(unknown)))
    if not time_known:
        return Reason(ReasonCode.CLOCKS_NOT_SYNCHRONISED)
    if not now_s - t.pose_fed_s <= _POSE_S:
        return Reason(ReasonCode.NO_POSE_FED)
    if not t.estimator_good:
        return Reason(ReasonCode.ESTIMATOR_NOT_FOLLOWING)
    return None


def missing_to_arm(t: Telemetry) -> Reason | None:
    """Return what is missing once it follows our poses, None for nothing."""
    if not t.origin_known:
        return Reason(ReasonCode.NO_ORIGIN)
    return None if t.prearm_good else Reason(ReasonCode.PREARM_FAILED, details=autopilot_text(t.warning))


def _dotted(version: Version) -> str:
    return ".".join(map(str, version))


@dataclass(slots=True)
class Request:
    """One command, sent a few times until the state shows its effect."""

    command: Command
    patience_s: float
    tries: int = 3
    asked: int = 0
    asked_s: float = -math.inf

    def step(self, now_s: float, why: Reason, t: Telemetry) -> tuple[Command | None, Reason | None]:
        """Return the command when it is due, and a reason once it failed too often."""
        if now_s - self.asked_s < self.patience_s:
            return None, None
        if self.asked >= self.tries:
            return None, Reason(ReasonCode.ARMING_GIVEN_UP, details=(why, *autopilot_text(t.warning)))
        self.asked = self.asked + 1
        self.asked_s = now_s
        return self.command, None
