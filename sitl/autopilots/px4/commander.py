"""PX4's commander: mode changes, arming checks and failsafes.

The behaviour was measured on PX4 1.17, except where a comment says that it is from the sources.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from sitl.autopilots.base_commands import ACCEPTED, DENIED, TEMPORARILY_REJECTED
from sitl.autopilots.px4.parameters import Px4Parameters

_OFFBOARD_PROOF_S = 1.0  # time a setpoint stream must run before OFFBOARD engages
_PREARM_AFTER_ORIGIN_S = 5.0
_POSE_LOSS_HYSTERESIS_S = 0.6  # from the loss of the position flag to LAND (measured: 0.6 to 0.9 s)
_STREAM_LOSS_REACTION_S = (0.1, 0.8)  # in addition to COM_OF_LOSS_T (measured: 0.6 to 1.3 s in total)

EMERGENCY = 0
CRITICAL = 2
WARNING = 4
INFO = 6


class Px4Mode(IntEnum):
    """custom_mode of HEARTBEAT: main mode << 16 | sub mode << 24."""

    MANUAL = 1 << 16
    ALTCTL = 2 << 16
    POSCTL = 3 << 16
    ACRO = 5 << 16
    OFFBOARD = 6 << 16
    STABILIZED = 7 << 16
    TAKEOFF = 4 << 16 | 2 << 24
    LOITER = 4 << 16 | 3 << 24
    MISSION = 4 << 16 | 4 << 24
    RTL = 4 << 16 | 5 << 24
    LAND = 4 << 16 | 6 << 24


_STICK_MODES = (Px4Mode.MANUAL, Px4Mode.ALTCTL, Px4Mode.POSCTL, Px4Mode.ACRO, Px4Mode.STABILIZED)
_NEED_POSITION = (Px4Mode.POSCTL, Px4Mode.OFFBOARD, Px4Mode.TAKEOFF, Px4Mode.LOITER, Px4Mode.MISSION, Px4Mode.RTL)


@dataclass(frozen=True, slots=True)
class Px4Condition:
    """Inputs of the commander, updated at 50 Hz."""

    now_s: float
    position_valid: bool
    landed: bool
    has_flown: bool  # since arming
    battery: float
    distance_from_home_m: float  # horizontal; NaN without a home
    height_above_home_m: float
    rc_lost_s: float  # time since the RC transmitter was last received; 0 while it is received


class OffboardStream:
    """Monitor of the setpoint stream: available after 1 s without a gap of COM_OF_LOSS_T."""

    def __init__(self) -> None:
        self.timeout_s = 1.0
        self.last_s = -math.inf
        self._since_s = math.inf

    def arrived(self, now_s: float) -> None:
        """Record a usable setpoint."""
        if now_s - self.last_s >= self.timeout_s:
            self._since_s = now_s
        self.last_s = now_s

    def available(self, now_s: float) -> bool:
        """Return True if OFFBOARD may be entered."""
        return now_s - self.last_s < self.timeout_s and now_s - self._since_s >= _OFFBOARD_PROOF_S


class CompanionMonitor:
    """Monitor of the companion's heartbeats: PX4 reports their loss and does nothing else.

    Inactive before the first heartbeat. say: as for Px4Commander.
    """

    def __init__(self, say: Callable[[int, str], None]) -> None:
        self._say = say
        self._received_s = math.inf
        self._lost = False
        self.timeout_s = 5.0

    def heard(self, now_s: float) -> None:
        """Record a heartbeat."""
        self._received_s = now_s
        if self._lost:
            self._lost = False
            self._say(INFO, "Connection to mission computer regained")

    def step(self, now_s: float) -> None:
        """Report the loss once, after a silence of COM_OBC_LOSS_T."""
        if not self._lost and now_s - self._received_s > self.timeout_s:
            self._lost = True
            self._say(CRITICAL, "Connection to mission computer lost")


class Px4Commander:
    """Mode, arming state and failsafes. say(severity, text) sends a STATUSTEXT."""

    def __init__(self, parameters: Px4Parameters, seed: int, say: Callable[[int, str], None]) -> None:
        self._random = random.Random(seed)
        self._say = say
        self.stream = OffboardStream()
        self.companion = CompanionMonitor(say)
        self.mode = Px4Mode.LOITER
        self.armed = False
        self.armed_at_s = math.inf
        self.origin_at_s = math.inf
        self.heading_known = False
        self.failsafes: list[str] = []
        self._wanted = Px4Mode.LOITER
        self._before_land = Px4Mode.LOITER
        self._invalid_since_s = math.inf
        self._reaction_s = 0.0
        self._landed_since_s = math.inf
        self._fence_since_s = math.inf
        self._active_failsafes: set[str] = set()
        self.configure(parameters)

    def configure(self, parameters: Px4Parameters) -> None:
        """Apply changed parameters. Raises ValueError for a failsafe action that is not simulated."""
        p = parameters
        self.stream.timeout_s, self.companion.timeout_s = p["COM_OF_LOSS_T"], p["COM_OBC_LOSS_T"]
        self._offboard_action = p.integer("COM_OBL_RC_ACT")
        self._act_delay_s = p["COM_FAIL_ACT_T"]
        self._disarm_land_s = p["COM_DISARM_LAND"]
        self._disarm_preflight_s = p["COM_DISARM_PRFLT"]
        self._low_battery_action = p.integer("COM_LOW_BAT_ACT")
        self._battery_low = p["BAT_LOW_THR"]
        self._battery_critical = p["BAT_CRIT_THR"]
        self._fence_action = p.integer("GF_ACTION")
        self._fence_xy = p["GF_MAX_HOR_DIST"]
        self._fence_z = p["GF_MAX_VER_DIST"]
        self._rc_needed = not p.integer("COM_RCL_EXCEPT") & 4
        self._rc_loss_s = p["COM_RC_LOSS_T"]
        self._rc_action = p.integer("NAV_RCL_ACT")
        if self._offboard_action not in (0, 4, 5):
            raise ValueError(f"COM_OBL_RC_ACT {self._offboard_action} is not simulated (0 Position, 4 Land, 5 Hold)")

    # -- requests -------------------------------------------------------------------------------------------------

    def request_mode(self, wanted: int, condition: Px4Condition) -> int:
        """Handle MAV_CMD_DO_SET_MODE; return the MAV_RESULT.

        ACCEPTED does not mean that OFFBOARD is active: without a setpoint stream the mode changes later.
        """
        try:
            mode = Px4Mode(wanted)
        except ValueError:
            return DENIED
        if mode in (Px4Mode.MISSION, Px4Mode.RTL) or (mode in _STICK_MODES and condition.rc_lost_s > 0.0):
            return self._refuse(mode)
        if self.armed and mode is not Px4Mode.OFFBOARD and mode in _NEED_POSITION and not condition.position_valid:
            return self._refuse(mode)
        if self.armed and mode is Px4Mode.LOITER and not self.has_global(condition.now_s):
            return self._refuse(mode)  # Hold needs a global position (from the sources)
        self._wanted = mode
        if mode is Px4Mode.OFFBOARD and not self.stream.available(condition.now_s):
            return ACCEPTED
        self._enter(mode)
        return ACCEPTED

    def request_arming(self, arm: bool, force: bool, condition: Px4Condition) -> int:
        """Handle MAV_CMD_COMPONENT_ARM_DISARM; return the MAV_RESULT."""
        if arm == self.armed:
            return ACCEPTED
        if not arm:
            if not condition.landed and not force:
                self._say(CRITICAL, "Disarming denied: not landed")
                return TEMPORARILY_REJECTED
            self._disarm("by external command")
            return ACCEPTED
        reason = self.arming_refusal(condition)
        if reason and not force:
            self._say(CRITICAL, f"Arming denied: {reason}")
            return TEMPORARILY_REJECTED
        self.armed = True
        self.armed_at_s = condition.now_s
        self._landed_since_s = math.inf
        self._active_failsafes.clear()
        self._say(INFO, "Armed by external command")
        return ACCEPTED

    def arming_refusal(self, condition: Px4Condition) -> str:
        """Return the reason why arming in the requested mode fails; '' if it is possible.

        Also decides the PREARM bit of SYS_STATUS.
        """
        wanted, now_s = self._wanted, condition.now_s
        refusals = {
            "No offboard signal": wanted is Px4Mode.OFFBOARD and not self.stream.available(now_s),
            "Mode not suitable for takeoff": wanted in (Px4Mode.LAND, Px4Mode.RTL),
            "Position estimate required": wanted in _NEED_POSITION and not condition.position_valid,
            "Global position estimate required": wanted is Px4Mode.LOITER and not self.has_global(now_s),
            "Low battery": condition.battery <= self._battery_low,
            "No manual control input": self._rc_needed and condition.rc_lost_s > self._rc_loss_s,
        }
        return next((text for text, holds in refusals.items() if holds), "")

    def has_global(self, now_s: float) -> bool:
        """Return True if the global position is valid.

        That needs an origin for _PREARM_AFTER_ORIGIN_S and a heading relative to north.
        """
        return self.heading_known and now_s - self.origin_at_s >= _PREARM_AFTER_ORIGIN_S

    def takeover(self, mode: Px4Mode) -> None:
        """Enter the mode of a pilot's switch at once, and cancel any pending request."""
        self._wanted = mode
        self._enter(mode)

    # -- 50 Hz ----------------------------------------------------------------------------------------------------

    def step(self, condition: Px4Condition) -> None:
        """Check the companion, enter a pending OFFBOARD, run the failsafes, disarm after landing."""
        now = condition.now_s
        self.companion.step(now)
        self._invalid_since_s = math.inf if condition.position_valid else min(self._invalid_since_s, now)
        pending = self._wanted is Px4Mode.OFFBOARD and self.mode is not Px4Mode.OFFBOARD
        if pending and self.stream.available(now) and (condition.position_valid or not self.armed):
            self._enter(Px4Mode.OFFBOARD)
        if self.armed:
            self._watch(condition)
            self._disarm_by_itself(condition)

    def _watch(self, c: Px4Condition) -> None:
        landing = self.mode is Px4Mode.LAND
        if self.mode in _NEED_POSITION and c.now_s - self._invalid_since_s >= _POSE_LOSS_HYSTERESIS_S:
            self._fail("pose", "position estimate lost", Px4Mode.LAND)
        elif self.mode is Px4Mode.OFFBOARD and self._stream_dead(c.now_s):
            action = {0: Px4Mode.POSCTL, 4: Px4Mode.LAND, 5: Px4Mode.LOITER}[self._offboard_action]
            self._fail("stream", "offboard signal lost", action)
        elif not landing and c.battery <= self._battery_critical and self._low_battery_action >= 2:
            self._fail("battery", "battery critical", Px4Mode.LAND)
        elif not landing and self._rc_needed and c.rc_lost_s > self._rc_loss_s + self._act_delay_s and self._rc_action == 3:
            self._fail("rc", "manual control lost", Px4Mode.LAND)
        elif not landing:
            self._watch_fence(c)

    def _stream_dead(self, now_s: float) -> bool:
        silent = now_s - self.stream.last_s
        if silent < self.stream.timeout_s:
            self._reaction_s = self._random.uniform(*_STREAM_LOSS_REACTION_S)
            return False
        return silent >= self.stream.timeout_s + self._reaction_s

    def _watch_fence(self, c: Px4Condition) -> None:
        """Check the geofence; inactive without a home, since comparisons with NaN are false."""
        out = 0.0 < self._fence_xy < c.distance_from_home_m or 0.0 < self._fence_z < c.height_above_home_m
        if not out or self._fence_action < 2:
            return
        if "fence" not in self._active_failsafes and self._fence_since_s == math.inf:
            self._fence_since_s = c.now_s
            self._fail("fence hold", "geofence breached", Px4Mode.LOITER)
        elif c.now_s - self._fence_since_s >= self._act_delay_s and self._fence_action == 5:
            self._fail("fence", "geofence breached", Px4Mode.LAND)

    def _disarm_by_itself(self, c: Px4Condition) -> None:
        if not c.landed:
            self._landed_since_s = math.inf
            return
        self._landed_since_s = min(self._landed_since_s, c.now_s)
        on_floor = c.now_s - self._landed_since_s
        if c.has_flown and on_floor >= self._disarm_land_s > 0.0:
            self._disarm("by landing")
        elif not c.has_flown and c.now_s - self.armed_at_s >= self._disarm_preflight_s > 0.0:
            self._disarm("by auto preflight disarming")

    # -- transitions ----------------------------------------------------------------------------------------------

    def _fail(self, key: str, cause: str, mode: Px4Mode) -> None:
        if key in self._active_failsafes:
            return
        self._active_failsafes.add(key)
        self._wanted = mode  # latched: leaving this mode needs a new request
        self._enter(mode)
        self.failsafes.append(f"{cause}: {mode.name}")
        self._say(EMERGENCY, f"Failsafe activated: {cause}, {mode.name.lower()}")

    def _enter(self, mode: Px4Mode) -> None:
        if mode is Px4Mode.LAND and self.mode is not Px4Mode.LAND:
            self._before_land = self.mode
        if mode is not Px4Mode.LAND:
            self._active_failsafes.discard("stream")
            self._active_failsafes.discard("pose")
        self.mode = mode

    def _disarm(self, how: str) -> None:
        self.armed = False
        self.armed_at_s = math.inf
        self._fence_since_s = math.inf
        self._say(INFO, f"Disarmed {how}")
        if self.mode is Px4Mode.LAND:  # measured: the mode before LAND returns, usually OFFBOARD
            self._wanted = self._before_land
            self.mode = self._before_land

    def _refuse(self, mode: Px4Mode) -> int:
        self._say(CRITICAL, f"Switching to {mode.name.capitalize()} is currently not available")
        return TEMPORARILY_REJECTED
