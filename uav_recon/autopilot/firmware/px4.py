"""PX4 profile: its modes, required telemetry, conditions for arming, and arming sequence.

Facts from ../shared/AUTOPILOTS.md (measured on 1.17) and PX4's sources: OFFBOARD requires a running setpoint stream first;
the origin may be set only once the estimator follows the poses.
"""

from __future__ import annotations

import math

from uav_recon.autopilot.firmware.profile import (
    ARM,
    ARM_AGAIN_S,
    DO_SET_MODE,
    MODE_AGAIN_S,
    ArmingOutcome,
    Command,
    FirmwareProfile,
    Request,
    SupportedFirmware,
    missing_to_arm,
    missing_to_follow,
)
from uav_recon.autopilot.mavlink.link_status import LinkStatus
from uav_recon.autopilot.mavlink.telemetry import Telemetry
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_CUSTOM_MODE_ENABLED = 1.0
_OFFBOARD = 6
_AUTO = 4
_AUTO_LAND = 6
_MAIN_MODES = {1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED", 8: "RATTITUDE"}
_AUTO_MODES = {1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND", 8: "FOLLOW", 9: "PRECLAND"}

FLY: Command = (DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _OFFBOARD))
LAND: Command = (DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _AUTO, _AUTO_LAND))

LOCAL_NED = 1  # MAV_FRAME: PX4 does not use a heading in LOCAL_FRD, so no global position, no Hold and no arming
#: refuse: arming on a link that repeats frames, until PX4 got this many answers and accepts stamps: fifty seconds
CLOCK_ANSWERS = 500
#: refuse: arming with an older PX4: before 1.15.2, LAND without a global position flew to local (0, 0)
MIN_VERSION = (1, 15, 4)
UNKNOWN_VERSION = (1, 18, 0)  #: refuse: arming with this PX4 or a newer one: what it does with our messages is known up to 1.17
_SUPPORTED = SupportedFirmware("PX4", family=12, oldest=MIN_VERSION, unknown=UNKNOWN_VERSION)

STREAMS_HZ = (
    (1, 2.0),  # SYS_STATUS
    (31, 30.0),  # ATTITUDE_QUATERNION
    (32, 30.0),  # LOCAL_POSITION_NED
    (49, 1.0),  # GPS_GLOBAL_ORIGIN
    (230, 5.0),  # ESTIMATOR_STATUS
    (245, 5.0),  # EXTENDED_SYS_STATE
    (285, 10.0),  # GIMBAL_DEVICE_ATTITUDE_STATUS
)
POLLED_HZ = ((0, 10.0),)  # HEARTBEAT: sent once a second at any requested rate (measured): too late for a human's mode
ASKED_ONCE = (148,)  # AUTOPILOT_VERSION


def mode_name(custom_mode: int) -> str:
    """Return the mode as PX4's own tools call it."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    name = _MAIN_MODES.get(main, f"MODE{main}")
    return f"{name}.{_AUTO_MODES.get(sub, sub)}" if main == _AUTO else name


def is_ours(custom_mode: int) -> bool:
    """Return True for OFFBOARD: the vehicle follows our setpoints."""
    return custom_mode >> 16 & 0xFF == _OFFBOARD


def is_landing(custom_mode: int) -> bool:
    """Return True for AUTO.LAND, by our command or by a failsafe.

    A blind descent shows as LAND too.
    """
    return custom_mode >> 16 & 0xFFFF == _AUTO_LAND << 8 | _AUTO


def missing_for_origin(t: Telemetry, status: LinkStatus, now_s: float) -> Reason | None:
    """Return what is missing before the origin may be sent, None for nothing.

    If it is sent too early, PX4 sets local z to the altitude.
    """
    return missing_to_follow(t, status, now_s, _SUPPORTED)


def missing_for_arming(t: Telemetry, status: LinkStatus, now_s: float) -> Reason | None:
    """Return what is missing before arming may be requested, None for nothing.

    Until its TIMESYNC has converged PX4 takes a pose for as old as its arrival: on a link that repeats frames or
    delays some, old poses would pass for new ones.
    """
    missing = missing_for_origin(t, status, now_s) or missing_to_arm(t)
    if not missing and status.stale_frames and status.clock_answers < CLOCK_ANSWERS:
        return Reason(ReasonCode.WAITING_FOR_TIMESYNC, (status.clock_answers, CLOCK_ANSWERS))
    return missing


class Px4ArmingSequence:
    """From a running stream to armed in OFFBOARD: mode first, then motors, three tries each.

    A mode that is neither the initial one nor ours was chosen by someone else.
    """

    STREAM_S = 1.0  #: refuse: no request for OFFBOARD before setpoints stream for this time: PX4 refuses it

    def __init__(self, now_s: float) -> None:
        self.streams = True
        self.reason: Reason | None = None
        self._start_s = now_s
        self._mode = Request(FLY, MODE_AGAIN_S)
        self._arm = Request(ARM, ARM_AGAIN_S)
        self._mode_before: int | None = None
        self._mode_seen = False

    def step(self, now_s: float, t: Telemetry) -> tuple[ArmingOutcome, Command | None]:
        """Return the state of the attempt, and the command to send now.

        Setpoints must be streaming all the time.
        """
        self._mode_before = t.mode.custom_mode if self._mode_before is None else self._mode_before
        if not is_ours(t.mode.custom_mode) and (self._mode_seen or t.mode.custom_mode != self._mode_before):
            changed = Reason(ReasonCode.MODE_CHANGED, (mode_name(t.mode.custom_mode),))
            self.reason = Reason(ReasonCode.ARMING_GIVEN_UP, details=(changed,))
            return ArmingOutcome.GIVEN_UP, None
        if now_s - self._start_s < self.STREAM_S:
            return ArmingOutcome.PENDING, None
        if not self._mode_seen:
            if not (is_ours(t.mode.custom_mode) and t.mode.heartbeat_s > self._mode.asked_s > -math.inf):
                return self._ask(self._mode, now_s, Reason(ReasonCode.MODE_UNCHANGED, (mode_name(t.mode.custom_mode),)), t)
            self._mode_seen = True
        if t.mode.armed:
            return ArmingOutcome.ARMED, None
        return self._ask(self._arm, now_s, Reason(ReasonCode.MOTORS_STAY_OFF), t)

    def _ask(self, request: Request, now_s: float, why: Reason, t: Telemetry) -> tuple[ArmingOutcome, Command | None]:
        command, self.reason = request.step(now_s, why, t)
        return (ArmingOutcome.GIVEN_UP if self.reason else ArmingOutcome.PENDING), command


PX4 = FirmwareProfile(
    mode_name, is_ours, is_landing, missing_for_origin, missing_for_arming, Px4ArmingSequence,
    land=LAND, pose_frame=LOCAL_NED, setpoint_mask=0, streams_hz=STREAMS_HZ, asked_once=ASKED_ONCE,
    polled_hz=POLLED_HZ,
)  # fmt: skip
