"""PX4's personality: its modes, what it must tell us, when it may arm, and how arming is asked for.

Facts from ../shared/AUTOPILOTS.md (measured on 1.17) and PX4's sources: commands are believed when HEARTBEAT shows
their effect, never by their ACK; OFFBOARD wants a running setpoint stream first; the origin may be set only once the
estimator follows the poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from uav_recon.autopilot.link import Telemetry

DO_SET_MODE, ARM_DISARM = 176, 400
_PX4_FAMILY = 12
_CUSTOM_MODE_ENABLED = 1.0
_OFFBOARD, _AUTO, _AUTO_LAND = 6, 4, 6
_MAIN_MODES = {1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED", 8: "RATTITUDE"}
_AUTO_MODES = {1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND", 8: "FOLLOW", 9: "PRECLAND"}

Command = tuple[int, tuple[float, ...]]

FLY: Command = (DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _OFFBOARD))
LAND: Command = (DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _AUTO, _AUTO_LAND))
ARM: Command = (ARM_DISARM, (1.0,))  # the second parameter stays 0: the autopilot's own checks are never forced

MIN_VERSION = (1, 15, 4)  # before 1.15.2, LAND without a global position flew to local (0, 0)

STREAMS_HZ = (
    (0, 5.0),  # HEARTBEAT: a human's mode is to be seen at once
    (1, 2.0),  # SYS_STATUS
    (31, 30.0),  # ATTITUDE_QUATERNION
    (32, 30.0),  # LOCAL_POSITION_NED
    (49, 1.0),  # GPS_GLOBAL_ORIGIN
    (230, 5.0),  # ESTIMATOR_STATUS
    (285, 10.0),  # GIMBAL_DEVICE_ATTITUDE_STATUS
)
ASKED_ONCE = (148,)  # AUTOPILOT_VERSION


def mode_name(custom_mode: int) -> str:
    """The mode as PX4's own tools call it."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    name = _MAIN_MODES.get(main, f"MODE{main}")
    return f"{name}.{_AUTO_MODES.get(sub, sub)}" if main == _AUTO else name


def is_ours(custom_mode: int) -> bool:
    """OFFBOARD: the vehicle follows our setpoints."""
    return custom_mode >> 16 & 0xFF == _OFFBOARD


def is_landing(custom_mode: int) -> bool:
    """AUTO.LAND, by our word or by a failsafe (a blind descent shows as LAND too)."""
    return custom_mode >> 16 & 0xFFFF == _AUTO_LAND << 8 | _AUTO


def missing_for_origin(t: Telemetry, time_known: bool, now_s: float) -> str:
    """What is missing before the origin may be sent, '' for nothing. Sent too early, PX4 puts local z at the altitude."""
    if not now_s - t.heartbeat_s <= 3.0:
        return "no heartbeat from the autopilot"
    if t.firmware_family != _PX4_FAMILY:
        return f"the autopilot is not PX4 (MAV_AUTOPILOT {t.firmware_family})"
    if t.twin_heard:
        return "another companion speaks with our id"
    if t.version is None:
        return "firmware version unknown"
    if t.version < MIN_VERSION:
        return f"PX4 {'.'.join(map(str, t.version))} is older than {'.'.join(map(str, MIN_VERSION))}"
    if not time_known:
        return "clocks not synchronised yet"
    if not now_s - t.pose_fed_s <= 0.5:
        return "no pose to feed"
    if not t.estimator_good:
        return "the estimator does not follow the poses yet"
    return ""


def missing_for_arming(t: Telemetry, time_known: bool, now_s: float) -> str:
    """What is missing before arming may be asked for, '' for nothing."""
    missing = missing_for_origin(t, time_known, now_s)
    if missing:
        return missing
    if not t.origin_known:
        return "no origin yet"
    return "" if t.prearm_good else f"pre-arm checks fail{': ' + t.warning if t.warning else ''}"


class Outcome(Enum):
    """Where an attempt to arm stands."""

    PENDING = "pending"
    ARMED = "armed"
    GIVEN_UP = "given up"


@dataclass(slots=True)
class _Request:
    """One command, asked for a few times until the state shows it."""

    command: Command
    patience_s: float
    tries: int = 0
    asked_s: float = -math.inf

    def due(self, now_s: float) -> bool:
        return now_s - self.asked_s >= self.patience_s


class Arming:
    """From a running stream to armed in OFFBOARD: the mode first, then the motors, three tries each."""

    STREAM_S = 1.0
    TRIES = 3

    def __init__(self, now_s: float) -> None:
        self._start_s = now_s
        self._mode, self._arm = _Request(FLY, 2.5), _Request(ARM, 5.0)
        self._mode_seen_s = math.inf
        self.reason = ""

    def step(self, now_s: float, t: Telemetry) -> tuple[Outcome, Command | None]:
        """What has been reached, and the command to send now. Setpoints must be streaming all the while."""
        if now_s - self._start_s < self.STREAM_S:
            return Outcome.PENDING, None
        if self._mode_seen_s == math.inf:
            if not (is_ours(t.custom_mode) and t.heartbeat_s > self._mode.asked_s > -math.inf):
                return self._ask(self._mode, now_s, f"mode stays {mode_name(t.custom_mode)}", t)
            self._mode_seen_s = now_s
        if not is_ours(t.custom_mode):
            return self._give_up(f"mode changed to {mode_name(t.custom_mode)}")
        if t.armed:
            return Outcome.ARMED, None
        return self._ask(self._arm, now_s, "motors stay off", t)

    def _ask(self, request: _Request, now_s: float, why: str, t: Telemetry) -> tuple[Outcome, Command | None]:
        if not request.due(now_s):
            return Outcome.PENDING, None
        if request.tries >= self.TRIES:
            return self._give_up(f"{why}{': ' + t.warning if t.warning else ''}")
        request.tries, request.asked_s = request.tries + 1, now_s
        return Outcome.PENDING, request.command

    def _give_up(self, why: str) -> tuple[Outcome, Command | None]:
        self.reason = f"arming given up: {why}"
        return Outcome.GIVEN_UP, None
