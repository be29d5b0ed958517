"""The last rung that is ours: ask for LAND until it is seen, then leave it alone until the motors stop. Asked for in vain, the
landing is the firmware's, whose own failsafe lands what nobody flies.
"""

from __future__ import annotations

import math

from uav_recon.autopilot.firmware.profile import DISARM
from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.telemetry import Telemetry
from uav_recon.autopilot.pilot.control_authority import ControlLoss, yielded
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import FlightPhase

_AGAIN_S = 0.7  # a fifth of all frames may be lost, the answer late; a human's mode is seen before we ask again in any case
_MODE_FRESH_S, _MODE_WAIT_S = 0.05, 0.1  # an operator who asks to land waits for no more than 0.15 s
_HEARD_S = 0.5  # a human may have taken over unseen in a longer silence
_IN_VAIN_S = 5.0  # seven requests, and the answer to the last
_GROUND_FRESH_S = 0.5
_STUCK_S, _STILL_M = 10.0, 0.05
_WANDER_MPS = 0.03  # an estimate's own at rest; a landing comes down ten times as fast


class Landing:
    """There is no way back up. ``seen``: the autopilot lands, and wants no more setpoints. ``alert``: what a human has to
    know, or see to: the motors are never stopped from here, but of a vehicle that has not ``lifted`` and whose autopilot says
    so too.
    """

    def __init__(self, seen: bool, lifted: bool = True) -> None:
        self.seen, self._lifted = seen, lifted
        self._disarm_asked_s = -math.inf
        self._asked_s = self._deaf_s = -math.inf
        self._wait_s = self._in_vain_s = math.inf
        self._height_m, self._still_s, self._watched_s = math.nan, math.inf, math.inf
        self.alert: Reason | None = None

    def step(self, link: VehicleLink, now_s: float) -> ControlLoss | None:
        """None while it lasts; LANDED, or YIELDED when somebody chose another mode, or the autopilot does not heed us."""
        t, firmware = link.telemetry, link.firmware
        if not t.armed:
            return ControlLoss(FlightPhase.LANDED, None)
        lands = firmware.is_landing(t.custom_mode)
        if not (lands or firmware.is_ours(t.custom_mode)):
            return yielded(Reason(ReasonCode.MODE_CHANGED, (firmware.mode_name(t.custom_mode),)))
        current = self._mode_is_current(t, now_s)
        stands = not self._lifted and now_s - t.on_ground_s <= _GROUND_FRESH_S
        if stands and current and now_s - self._disarm_asked_s >= _AGAIN_S:
            self._disarm_asked_s = now_s
            link.command(now_s, DISARM[0], *DISARM[1])
        if lands:
            self.seen, self._in_vain_s = True, math.inf
            self._watch_descent(float(t.position_m[2]), now_s)
            return None
        self.alert = Reason(ReasonCode.LAND_REQUESTED) if self.seen else self.alert
        self._in_vain_s = min(self._in_vain_s, now_s + _IN_VAIN_S)
        if now_s > self._in_vain_s:
            ignored = Reason(ReasonCode.LAND_NOT_ACCEPTED, (_IN_VAIN_S,))
            return yielded(ignored, Reason(ReasonCode.FAILSAFE_LANDS), abandoned=True)
        if current and now_s - self._asked_s >= _AGAIN_S:
            self._asked_s = now_s
            link.command(now_s, firmware.land[0], *firmware.land[1])
        return None

    def _watch_descent(self, height_m: float, now_s: float) -> None:
        """A landing that does not come down any more, and is not over.

        The height held against follows slowly: it is one of the last on the way down, or the estimate wanders.
        """
        off_m, follows_m = height_m - self._height_m, _WANDER_MPS * max(now_s - self._watched_s, 0.0)
        self._watched_s = now_s
        if abs(off_m) <= _STILL_M:
            self._height_m += min(max(off_m, -follows_m), follows_m)
        else:
            self._height_m, self._still_s = height_m, now_s
        if now_s - self._still_s >= _STUCK_S:
            self.alert = Reason(ReasonCode.LANDING_NOT_ENDING)

    def _mode_is_current(self, t: Telemetry, now_s: float) -> bool:
        """Whether no human can have taken over unseen: the mode was told this instant, or is not told often; and since the last
        silence and request.
        """
        if now_s - t.received_s > _HEARD_S:
            self._deaf_s = now_s
        self._wait_s = min(self._wait_s, now_s)
        waited = now_s - self._wait_s >= _MODE_WAIT_S
        return t.heartbeat_s > max(self._asked_s, self._deaf_s) and (waited or now_s - t.heartbeat_s < _MODE_FRESH_S)
