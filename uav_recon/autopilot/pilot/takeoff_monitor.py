"""A take-off has to show: so high within so long, and level; a vehicle that cannot lift itself is not left to try."""

from __future__ import annotations

import math

from uav_recon.autopilot.mavlink.telemetry import Telemetry
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_TILT_RAD = math.radians(15.0)


class TakeoffMonitor:
    """From the first word that makes it climb until it is LIFTED_M up. within_s: how long that may take; PX4 spools up for a
    second and ramps for half a second (MPC_TKO_RAMP_T), and by itself stops the motors after five.
    """

    LIFTED_M = 0.2

    def __init__(self, ground_m: float, within_s: float = 4.0) -> None:
        self._ground_m, self._within_s = ground_m, within_s
        self._begun_s = math.inf
        self.lifted = False

    def begin(self, now_s: float) -> None:
        """It is told to climb now, if it was not before."""
        self._begun_s = min(self._begun_s, now_s)

    def fault(self, now_s: float, t: Telemetry) -> Reason | None:
        """Why it is not to go on, None while it may; by the autopilot's own estimate."""
        climbed_m, took_s = float(t.position_m[2]) - self._ground_m, now_s - self._begun_s
        self.lifted = self.lifted or climbed_m >= self.LIFTED_M
        if self.lifted or took_s < 0.0:
            return None
        tilt_rad = _tilt_rad(*t.quat_wxyz.tolist())
        if tilt_rad > _TILT_RAD:
            return Reason(ReasonCode.TILTED, (math.degrees(tilt_rad),))
        return Reason(ReasonCode.CLIMB_TOO_SLOW, (max(climbed_m, 0.0), took_s)) if took_s > self._within_s else None


def _tilt_rad(w: float, x: float, y: float, z: float) -> float:
    """Between the body's vertical and the world's."""
    return math.acos(min(max(1.0 - 2.0 * (x * x + y * y), -1.0), 1.0))
