"""Take-off monitor: the vehicle must reach a height in time and stay level.

A vehicle that cannot lift itself must not continue to try.
"""

from __future__ import annotations

import math

from uav_recon.autopilot.mavlink.telemetry import Telemetry
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_TILT_RAD = math.radians(15.0)  #: land: a larger tilt before the vehicle has lifted
_WITHIN_S = 4.0  #: land: not lifted within this time: PX4 by itself stops the motors after five seconds


class TakeoffMonitor:
    """Monitors the take-off from the first climb command until the vehicle is LIFTED_M up.

    within_s: time allowed for it. PX4 spools up for a second and ramps for half a second (MPC_TKO_RAMP_T), and by itself stops
    the motors after five.
    """

    LIFTED_M = 0.2  #: land: a vehicle that is not this high in time cannot lift itself, and must not continue to try

    def __init__(self, ground_m: float, within_s: float = _WITHIN_S) -> None:
        self._ground_m = ground_m
        self._within_s = within_s
        self._begun_s = math.inf
        self.lifted = False

    def begin(self, now_s: float) -> None:
        """Record the start of the climb command; later calls have no effect."""
        self._begun_s = min(self._begun_s, now_s)

    def fault(self, now_s: float, t: Telemetry) -> Reason | None:
        """Return why the take-off must end, None while it may continue.

        The autopilot's own estimate decides.
        """
        climbed_m, took_s = float(t.estimate.position_m[2]) - self._ground_m, now_s - self._begun_s
        self.lifted = self.lifted or climbed_m >= self.LIFTED_M
        if self.lifted or took_s < 0.0:
            return None
        tilt_rad = _tilt_rad(*t.estimate.quat_wxyz.tolist())
        if tilt_rad > _TILT_RAD:
            return Reason(ReasonCode.TILTED, (math.degrees(tilt_rad),))
        return Reason(ReasonCode.CLIMB_TOO_SLOW, (max(climbed_m, 0.0), took_s)) if took_s > self._within_s else None


def _tilt_rad(w: float, x: float, y: float, z: float) -> float:
    """Return the angle between the body's vertical and the world's."""
    return math.acos(min(max(1.0 - 2.0 * (x * x + y * y), -1.0), 1.0))
