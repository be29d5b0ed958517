"""Firmware profiles: the differences between the firmwares, and common handshakes.

On both, a command counts as done when HEARTBEAT and telemetry show its effect, never by its ACK.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Protocol

from uav_recon.autopilot.mavlink.link_status import LinkStatus
from uav_recon.autopilot.mavlink.telemetry import Telemetry
from uav_recon.types.reason import Reason, autopilot_text
from uav_recon.types.reason_code import ReasonCode

DO_SET_MODE = 176
ARM_DISARM = 400
_HEARTBEAT_S = 3.0  #: refuse: arming, if the autopilot's last heartbeat is older
MODE_AGAIN_S = 2.5  #: refuse: the mode is requested again after this time, Request.tries times, then arming is given up
ARM_AGAIN_S = 5.0  #: refuse: the same for the motors
_POSE_S = 0.5  #: refuse: arming, if the last pose sent to the autopilot is older

Command = tuple[int, tuple[float, ...]]
Version = tuple[int, int, int]

ARM: Command = (ARM_DISARM, (1.0,))  # the second parameter stays 0: the autopilot's own checks are never overridden
DISARM: Command = (ARM_DISARM, (0.0,))  # likewise: in flight the autopilot refuses it


class ArmingOutcome(Enum):
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

    def step(self, now_s: float, t: Telemetry) -> tuple[ArmingOutcome, Command | None]:
        """Return the state of the attempt, and the command to send now. GIVEN_UP has a reason."""
        ...


@dataclass(frozen=True, slots=True)
class FirmwareProfile:
    """Rules of a firmware. Modes are HEARTBEAT's custom_mode.

    missing_for_origin and missing_for_arming (telemetry, link status, now) name what is missing, None for nothing.
    pose_frame: MAV_FRAME of our ODOMETRY. setpoint_mask: ignored fields of a setpoint. streams_hz: requested messages;
    asked_once: messages requested once; polled_hz: messages requested one by one at this rate, where a rate cannot be set.
    """

    mode_name: Callable[[int], str]
    is_ours: Callable[[int], bool]
    is_landing: Callable[[int], bool]
    missing_for_origin: Callable[[Telemetry, LinkStatus, float], Reason | None]
    missing_for_arming: Callable[[Telemetry, LinkStatus, float], Reason | None]
    arming: Callable[[float], ArmingSequence]
    land: Command
    pose_frame: int
    setpoint_mask: int
    streams_hz: tuple[tuple[int, float], ...]
    asked_once: tuple[int, ...]
    polled_hz: tuple[tuple[int, float], ...]

    def with_stream(self, identifier: int, rate_hz: float) -> FirmwareProfile:
        """Return the profile with one more requested message.

        Of two rates of a message the higher one counts.
        """
        rates_hz = dict(self.streams_hz)
        rates_hz[identifier] = max(rate_hz, rates_hz.get(identifier, 0.0))
        return replace(self, streams_hz=tuple(rates_hz.items()))


@dataclass(frozen=True, slots=True)
class SupportedFirmware:
    """The firmware of a profile, and its versions.

    family: MAV_AUTOPILOT. unknown: the first version whose source has not been reviewed; None if every newer one is accepted.
    """

    name: str
    family: int
    oldest: Version
    unknown: Version | None = None

    def version_fault(self, version: Version | None) -> Reason | None:
        """Return why a version is not accepted, None if it is. version: None if it was not reported."""
        if version is None:
            return Reason(ReasonCode.FIRMWARE_UNKNOWN)
        if version < self.oldest:
            return Reason(ReasonCode.FIRMWARE_TOO_OLD, (self.name, _dotted(version), _dotted(self.oldest)))
        if self.unknown is not None and version >= self.unknown:
            return Reason(ReasonCode.FIRMWARE_TOO_NEW, (self.name, _dotted(version), _dotted(self.unknown)))
        return None


def missing_to_follow(t: Telemetry, status: LinkStatus, now_s: float, supported: SupportedFirmware) -> Reason | None:
    """Return what is missing until the autopilot follows our poses, None for nothing."""
    return (
        _missing_autopilot(t, status, now_s, supported)
        or supported.version_fault(t.version)
        or _missing_poses(t, status, now_s)
    )


def _missing_autopilot(t: Telemetry, status: LinkStatus, now_s: float, supported: SupportedFirmware) -> Reason | None:
    """Return why there is no autopilot of this firmware, or more than one; None if there is one."""
    if not now_s - t.mode.heartbeat_s <= _HEARTBEAT_S:
        return Reason(ReasonCode.NO_HEARTBEAT)
    if t.mode.firmware_family != supported.family:
        return Reason(ReasonCode.WRONG_FIRMWARE, (supported.name, t.mode.firmware_family))
    if status.own_id_in_use:
        return Reason(ReasonCode.OUR_ID_IN_USE)
    return status.autopilot_fault


def _missing_poses(t: Telemetry, status: LinkStatus, now_s: float) -> Reason | None:
    """Return why our poses do not reach its estimator, None if they do."""
    if not status.time_known:
        return Reason(ReasonCode.CLOCKS_NOT_SYNCHRONISED)
    if not now_s - status.pose_fed_s <= _POSE_S:
        return Reason(ReasonCode.NO_POSE_FED)
    return None if t.readiness.estimator_good else Reason(ReasonCode.ESTIMATOR_NOT_FOLLOWING)


def missing_to_arm(t: Telemetry) -> Reason | None:
    """Return what is missing once it follows our poses, None for nothing."""
    if not t.readiness.origin_known:
        return Reason(ReasonCode.NO_ORIGIN)
    return None if t.readiness.prearm_good else Reason(ReasonCode.PREARM_FAILED, details=autopilot_text(t.warning))


def _dotted(version: Version) -> str:
    return ".".join(map(str, version))


@dataclass(slots=True)
class Request:
    """One command, sent a few times until the state shows its effect."""

    command: Command
    patience_s: float
    tries: int = 3  #: refuse: the attempt to arm ends after this many requests for mode or motors: a lost frame is no refusal
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
