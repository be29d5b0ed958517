"""ArduCopter's modes, arming checks and failsafes.

The behaviour was measured on ArduCopter 4.8-dev, except where a comment says that it is from the sources.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.base_commands import ACCEPTED, FAILED

_SETTLED_S = 25.0  # from boot until the pre-arm checks can pass
_EKF_FAILSAFE_S = 0.8  # from the loss of the flags to LAND
_PAUSE_S = 4.0  # LAND_WITH_DELAY_MS: time of hover before the descent of a failsafe's LAND
_BREACH = "Fence breached"
_SILENT = "Companion silent"
_WITHOUT_PAUSE = (_BREACH, _SILENT)  # failsafes that land without the pause
_PREARM_REPORT_PERIOD_S = 30.0  # interval at which a failing pre-arm check is reported
_LAND = 1
_ALWAYS_LAND = 2
_BRAKE_OR_LAND = 4
_RADIO_LAND = 3
_GCS_LAND = 5
# FENCE_TYPE
_ALT_MAX = 1
_CIRCLE = 2
_KEEP_PILOTS_MODES = 16  # FS_OPTIONS
_ONBOARD_CONTROLLER = 18  # MAV_TYPE

CRITICAL = 2
WARNING = 4
INFO = 6


class ArduPilotMode(IntEnum):
    """custom_mode of HEARTBEAT."""

    STABILIZE = 0
    ACRO = 1
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    POSHOLD = 16
    BRAKE = 17


_NEED_POSITION = (ArduPilotMode.GUIDED, ArduPilotMode.LOITER, ArduPilotMode.POSHOLD, ArduPilotMode.BRAKE)
_PILOTS = (ArduPilotMode.STABILIZE, ArduPilotMode.ACRO, ArduPilotMode.ALT_HOLD, ArduPilotMode.LOITER, ArduPilotMode.POSHOLD)
_ARMABLE = (*_PILOTS, ArduPilotMode.GUIDED)


@dataclass(frozen=True, slots=True)
class ArduPilotCondition:
    """Inputs of the commander, updated at 50 Hz."""

    now_s: float
    booted_s: float  # since boot
    position_valid: bool
    landed: bool
    has_home: bool
    battery_mah: float  # remaining
    distance_from_home_m: float  # horizontal; NaN without a home
    height_above_home_m: float
    rc_lost_s: float  # time since the RC transmitter was last received; 0 while it is received


class ArduPilotCommander:
    """Mode, arming state and failsafes. say(severity, text) sends a STATUSTEXT."""

    def __init__(self, parameters: ArduPilotParameters, say: Callable[[int, str], None]) -> None:
        self._say = say
        self.mode: ArduPilotMode = ArduPilotMode.STABILIZE
        self.pause_s = 0.0  # pause before the descent of LAND
        self.armed = False
        self.armed_at_s = math.inf
        self.failsafes: list[str] = []
        self.gcs_received_s = math.inf  # inf before the first heartbeat: the failsafe is inactive
        self.companion_received_s = math.inf  # the same for the script
        self._invalid_since_s = math.inf
        self._idle_since_s = math.inf
        self._active_failsafes: set[str] = set()
        self._reported_s = 0.0
        self.configure(parameters)

    def configure(self, parameters: ArduPilotParameters) -> None:
        """Apply changed parameters. Raises ValueError for a failsafe action that is not simulated."""
        p = parameters
        self._gcs_system = p.integer("MAV_GCS_SYSID")
        self._own_system = p.integer("MAV_SYSID")
        self._disarm_s = float(p.integer("DISARM_DELAY"))
        self._gcs_lands = self._lands(p, "FS_GCS_ENABLE", _GCS_LAND)
        self._gcs_timeout_s = p["FS_GCS_TIMEOUT"]
        self._silence_s = p["UVR_SILENCE_S"] if p.integer("SCR_ENABLE") else math.inf  # script ardupilot_silence.lua
        self._companion = p.integer("MAV_GCS_SYSID"), p.integer("UVR_COMP_ID")
        self._radio_lands = self._lands(p, "FS_THR_ENABLE", _RADIO_LAND)
        self._radio_timeout_s = p["RC_FS_TIMEOUT"]
        self._pilots_modes_stay = bool(p.integer("FS_OPTIONS") & _KEEP_PILOTS_MODES)
        self._ekf_lands = self._lands(p, "FS_EKF_ACTION", _LAND)
        self._low_lands = self._lands(p, "BATT_FS_LOW_ACT", _LAND)
        self._low_mah = p["BATT_LOW_MAH"]
        self._critical_lands = self._lands(p, "BATT_FS_CRT_ACT", _LAND)
        self._critical_mah = p["BATT_CRT_MAH"]
        self._arm_mah = p["BATT_ARM_MAH"]
        fenced = p.integer("FENCE_ENABLE") == 1
        self._fence_lands = self._lands(p, "FENCE_ACTION", _ALWAYS_LAND, _BRAKE_OR_LAND) if fenced else False
        self._fenced = fenced
        self._ceiling_m = p["FENCE_ALT_MAX"] if fenced and p.integer("FENCE_TYPE") & _ALT_MAX else math.inf
        self._radius_m = p["FENCE_RADIUS"] if fenced and p.integer("FENCE_TYPE") & _CIRCLE else math.inf

    @staticmethod
    def _lands(p: ArduPilotParameters, name: str, *landing: int) -> bool:
        if p.integer(name) not in (0, *landing):
            raise ValueError(f"{name} {p.integer(name)} is not simulated (0 nothing, {landing[0]} Land)")
        return p.integer(name) != 0

    # -- requests -------------------------------------------------------------------------------------------------

    def request_mode(self, wanted: int, c: ArduPilotCondition) -> int:
        """Handle MAV_CMD_DO_SET_MODE; return the MAV_RESULT.

        GUIDED is accepted after a failsafe, too; the flight then resumes.
        """
        try:
            mode = ArduPilotMode(wanted)
        except ValueError:
            self._say(WARNING, f"No such mode {wanted}")
            return FAILED
        if mode in (ArduPilotMode.AUTO, ArduPilotMode.RTL):
            return self._refuse(mode, "init failed")
        if mode in _NEED_POSITION and not c.position_valid:
            return self._refuse(mode, "requires position")
        self.mode = mode
        self.pause_s = 0.0
        return ACCEPTED

    def request_arming(self, arm: bool, force: bool, c: ArduPilotCondition) -> int:
        """Handle MAV_CMD_COMPONENT_ARM_DISARM; return the MAV_RESULT."""
        if arm == self.armed:
            return ACCEPTED
        if not arm:
            if not c.landed and not force:
                return FAILED
            self._disarm()
            return ACCEPTED
        if not force:
            reason = "" if self.mode in _ARMABLE else f"{self.mode.name} mode not armable"
            reason = reason or self.arming_refusal(c)
            if reason:
                self._say(CRITICAL, f"Arm: {reason}")
                return FAILED
        self.armed = True
        self.armed_at_s = c.now_s
        self._idle_since_s = math.inf
        self._active_failsafes.clear()
        self._say(INFO, "Arming motors")
        return ACCEPTED

    def may_take_off(self, c: ArduPilotCondition) -> bool:
        """Return True if MAV_CMD_NAV_TAKEOFF is accepted: armed, in GUIDED and on the ground."""
        return self.armed and self.mode is ArduPilotMode.GUIDED and c.landed

    def arming_refusal(self, c: ArduPilotCondition) -> str:
        """Return the failed pre-arm check, '' if none. Also decides the PREARM bit of SYS_STATUS."""
        if c.booted_s < _SETTLED_S:
            return "AHRS: not settled"
        if not c.position_valid:
            return "Need Position Estimate"
        if self._fenced and not c.has_home:
            return "Fence requires position"
        if c.battery_mah < self._arm_mah:
            return "Battery 1 below minimum arming capacity"
        if self._radio_lands and c.rc_lost_s > self._radio_timeout_s:
            return "RC not found"
        return ""

    def heartbeat_from(self, sender: tuple[int, int], kind: int, now_s: float) -> None:
        """Record a heartbeat of a sender (system and component id). kind: its MAV_TYPE.

        ArduPilot's failsafe asks for the system id MAV_GCS_SYSID only; another component with the vehicle's own system id does
        not count (measured). The script ardupilot_silence.lua asks for system id, component id and type.
        """
        if sender[0] == self._gcs_system and sender[0] != self._own_system:
            self.gcs_received_s = now_s
        if sender == self._companion and kind == _ONBOARD_CONTROLLER:
            self.companion_received_s = now_s

    def admits(self, distance_m: float, height_m: float) -> bool:
        """Return True if a distance from home and height above it, m, are inside the fence.

        NaN (no home) counts as inside.
        """
        return not (distance_m > self._radius_m or height_m > self._ceiling_m)

    def takeover(self, mode: ArduPilotMode) -> None:
        """Enter the mode of a pilot's switch at once."""
        self.mode = mode
        self.pause_s = 0.0

    # -- 50 Hz ----------------------------------------------------------------------------------------------------

    def step(self, c: ArduPilotCondition) -> None:
        """Run the failsafes, disarm after landing, report failing pre-arm checks."""
        self._invalid_since_s = math.inf if c.position_valid else min(self._invalid_since_s, c.now_s)
        if self.armed:
            self._watch(c)
            self._disarm_by_itself(c)
        elif c.booted_s - self._reported_s >= _PREARM_REPORT_PERIOD_S:
            self._reported_s = c.booted_s
            reason = self.arming_refusal(c)
            if reason:
                self._say(CRITICAL, f"PreArm: {reason}")

    def _watch(self, c: ArduPilotCondition) -> None:
        """Check the failsafes; each acts once, when its condition begins."""
        pilots = self.mode in _PILOTS
        blind = self.mode in _NEED_POSITION and c.now_s - self._invalid_since_s >= _EKF_FAILSAFE_S
        self._check_failsafe("EKF Failsafe", blind, self._ekf_lands)
        silent_s = c.now_s - self.companion_received_s
        self._check_failsafe(_SILENT, silent_s > self._silence_s and self.mode is ArduPilotMode.GUIDED, True)
        silent = c.now_s - self.gcs_received_s > self._gcs_timeout_s
        self._check_failsafe("GCS Failsafe", silent and not (pilots and self._pilots_modes_stay), self._gcs_lands)
        self._check_failsafe("Radio Failsafe", c.rc_lost_s > self._radio_timeout_s, self._radio_lands)
        self._check_failsafe("Battery is low", c.battery_mah < self._low_mah, self._low_lands)
        self._check_failsafe("Battery is critical", c.battery_mah < self._critical_mah, self._critical_lands)
        self._check_failsafe(_BREACH, not self.admits(c.distance_from_home_m, c.height_above_home_m), self._fence_lands)

    def _check_failsafe(self, cause: str, present: bool, lands: bool) -> None:
        if not present:
            self._active_failsafes.discard(cause)
        elif cause not in self._active_failsafes:
            self._active_failsafes.add(cause)
            self._say(CRITICAL, cause)
            if lands and self.mode is not ArduPilotMode.LAND:
                self.failsafes.append(f"{cause}: LAND")
                self.mode = ArduPilotMode.LAND
                self.pause_s = 0.0 if cause in _WITHOUT_PAUSE else _PAUSE_S

    def _disarm_by_itself(self, c: ArduPilotCondition) -> None:
        """Disarm after landing: at once in LAND, after DISARM_DELAY in other modes."""
        if not c.landed:
            self._idle_since_s = math.inf
            return
        self._idle_since_s = min(self._idle_since_s, c.now_s)
        if self.mode is ArduPilotMode.LAND or c.now_s - self._idle_since_s >= self._disarm_s > 0.0:
            self._disarm()

    # -- transitions ----------------------------------------------------------------------------------------------

    def _disarm(self) -> None:
        self.armed = False
        self.armed_at_s = math.inf
        self._say(INFO, "Disarming motors")

    def _refuse(self, mode: ArduPilotMode, why: str) -> int:
        self._say(WARNING, f"Mode change to {mode.name} failed: {why}")
        return FAILED
