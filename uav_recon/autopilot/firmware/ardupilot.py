"""ArduCopter profile: its modes, required telemetry, conditions for arming, and take-off.

Facts from ../shared/AUTOPILOTS.md (measured on 4.8-dev) and its sources: an origin is accepted once per boot, and leaves the
vehicle without a home if it comes before the estimator follows the poses; on the ground setpoints do nothing, or end a
take-off, so none is sent before the vehicle flies; when setpoints end it hovers for ever, so we have to command the landing,
and if our process dies, the missing heartbeat makes it land.
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
from uav_recon.autopilot.firmware.takeoff_monitor import TakeoffMonitor
from uav_recon.autopilot.mavlink.link_status import LinkStatus
from uav_recon.autopilot.mavlink.telemetry import Telemetry
from uav_recon.types.reason import Reason, autopilot_text
from uav_recon.types.reason_code import ReasonCode

TAKE_OFF = 22
CLIMB_M = 0.5  #: land: height of the climb by command, to be reached within CLIMB_S; from there on setpoints are followed
MIN_VERSION = (4, 5, 2)  #: refuse: arming with an older ArduPilot: before it, VISO_DELAY_MS had no effect
_SUPPORTED = SupportedFirmware("ArduPilot", family=3, oldest=MIN_VERSION)
LOCAL_FRD = 20  # MAV_FRAME: odometry in any other is dropped without a message
_CUSTOM_MODE_ENABLED = 1.0
_GUIDED = 4
_LAND = 9
_MODES = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE", 9: "LAND",
    11: "DRIFT", 13: "SPORT", 14: "FLIP", 15: "AUTOTUNE", 16: "POSHOLD", 17: "BRAKE", 18: "THROW", 19: "AVOID_ADSB",
    20: "GUIDED_NOGPS", 21: "SMART_RTL", 22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG", 25: "SYSTEMID", 26: "AUTOROTATE",
    27: "AUTO_RTL", 28: "TURTLE",
}  # fmt: skip

FLY: Command = (DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _GUIDED))
LAND: Command = (DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _LAND))
CLIMB: Command = (TAKE_OFF, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, CLIMB_M))

# Place, speed, acceleration and yaw (read). Measured was 2496, without accelerations: in simulation it strays twice as far.
ALL_BUT_YAW_RATE = 2048

STREAMS_HZ = (
    (0, 10.0),  # HEARTBEAT: a mode that a human selects must be seen at once
    (1, 2.0),  # SYS_STATUS
    (31, 30.0),  # ATTITUDE_QUATERNION
    (32, 30.0),  # LOCAL_POSITION_NED
    (49, 1.0),  # GPS_GLOBAL_ORIGIN
    (193, 5.0),  # EKF_STATUS_REPORT
    (245, 5.0),  # EXTENDED_SYS_STATE
    (285, 10.0),  # GIMBAL_DEVICE_ATTITUDE_STATUS
)
ASKED_ONCE = (148,)  # AUTOPILOT_VERSION


def mode_name(custom_mode: int) -> str:
    """Return the mode as ArduPilot's own tools call it."""
    return _MODES.get(custom_mode, f"MODE{custom_mode}")


def is_ours(custom_mode: int) -> bool:
    """Return True for GUIDED: the vehicle follows our setpoints."""
    return custom_mode == _GUIDED


def is_landing(custom_mode: int) -> bool:
    """Return True for LAND, by our command or by a failsafe."""
    return custom_mode == _LAND


def missing_for_origin(t: Telemetry, status: LinkStatus, now_s: float) -> Reason | None:
    """Return what is missing before the origin may be sent, None for nothing."""
    return missing_to_follow(t, status, now_s, _SUPPORTED)


def missing_for_arming(t: Telemetry, status: LinkStatus, now_s: float) -> Reason | None:
    """Return what is missing before arming may be requested, None for nothing."""
    return missing_for_origin(t, status, now_s) or missing_to_arm(t)


class ArduPilotArmingSequence:
    """GUIDED, motors, and a climb by command; each counts when telemetry shows it.

    The climb is requested once. A mode that is neither the initial one nor ours was chosen by someone else.
    """

    LIFT_S = 5.0  #: land: not lifted in this time; a real vehicle takes 3.95 s: its motors alone take three
    ARRIVED_M = 0.10  #: land: the climb may end this far below CLIMB_M
    CLIMB_S = 12.0  #: land: the climb by command takes longer

    def __init__(self, now_s: float) -> None:
        self.streams = False
        self.reason: Reason | None = None
        self._start_s = now_s
        self._mode = Request(FLY, MODE_AGAIN_S)
        self._arm = Request(ARM, ARM_AGAIN_S)
        self._mode_before: int | None = None
        self._mode_seen = False
        self._ground_m = math.nan
        self._climb_s = math.inf
        self._lift_off = TakeoffMonitor(math.nan)

    def step(self, now_s: float, t: Telemetry) -> tuple[ArmingOutcome, Command | None]:
        """Return the state of the attempt, and the command to send now.

        No setpoint may be sent before the state is ARMED.
        """
        self._mode_before = t.mode.custom_mode if self._mode_before is None else self._mode_before
        if not is_ours(t.mode.custom_mode) and (self._mode_seen or t.mode.custom_mode != self._mode_before):
            return self._give_up(Reason(ReasonCode.MODE_CHANGED, (mode_name(t.mode.custom_mode),)))
        if not self._mode_seen:
            if not (is_ours(t.mode.custom_mode) and t.mode.heartbeat_s > self._mode.asked_s > -math.inf):
                return self._ask(self._mode, now_s, Reason(ReasonCode.MODE_UNCHANGED, (mode_name(t.mode.custom_mode),)), t)
            self._mode_seen = True
        if not t.mode.armed:
            if self._climb_s < math.inf:
                return self._give_up(Reason(ReasonCode.DISARMED_BEFORE_TAKEOFF, details=autopilot_text(t.warning)))
            return self._ask(self._arm, now_s, Reason(ReasonCode.MOTORS_STAY_OFF), t)
        return self._climb(now_s, t)

    def _climb(self, now_s: float, t: Telemetry) -> tuple[ArmingOutcome, Command | None]:
        height_m = float(t.estimate.position_m[2])
        if self._climb_s == math.inf:
            self._climb_s = now_s
            self._ground_m = height_m
            self._lift_off = TakeoffMonitor(height_m, self.LIFT_S)
            self._lift_off.begin(now_s)
            return ArmingOutcome.PENDING, CLIMB
        fault = self._lift_off.fault(now_s, t)
        if fault:
            return self._give_up(fault)
        climbed_m, took_s = height_m - self._ground_m, now_s - self._climb_s
        if climbed_m >= CLIMB_M - self.ARRIVED_M:
            return ArmingOutcome.ARMED, None
        if took_s > self.CLIMB_S:
            return self._give_up(Reason(ReasonCode.CLIMB_TOO_SLOW, (climbed_m, took_s)))
        return ArmingOutcome.PENDING, None

    def _ask(self, request: Request, now_s: float, why: Reason, t: Telemetry) -> tuple[ArmingOutcome, Command | None]:
        command, self.reason = request.step(now_s, why, t)
        return (ArmingOutcome.GIVEN_UP if self.reason else ArmingOutcome.PENDING), command

    def _give_up(self, why: Reason) -> tuple[ArmingOutcome, Command | None]:
        self.reason = Reason(ReasonCode.TAKEOFF_GIVEN_UP, details=(why,))
        return ArmingOutcome.GIVEN_UP, None


ARDUPILOT = FirmwareProfile(
    mode_name, is_ours, is_landing, missing_for_origin, missing_for_arming, ArduPilotArmingSequence,
    land=LAND, pose_frame=LOCAL_FRD, setpoint_mask=ALL_BUT_YAW_RATE, streams_hz=STREAMS_HZ, asked_once=ASKED_ONCE,
    polled_hz=(),
)  # fmt: skip
