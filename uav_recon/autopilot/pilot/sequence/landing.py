"""Landing: the last action that is ours.

It requests LAND until the mode shows it, and then waits until the motors stop. If the requests have no effect, the firmware's
own failsafe lands a vehicle that no one flies.
"""

from __future__ import annotations

import math

from uav_recon.autopilot.firmware.profile import DISARM
from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.telemetry import Telemetry
from uav_recon.autopilot.pilot.sequence.control_authority import ControlLoss, yielded
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import FlightPhase

#: land: requested again after this: a fifth of all frames may be lost; a human's mode is always seen before the next request
_AGAIN_S = 0.7
_MODE_FRESH_S = 0.05  #: land: requested only if the mode was reported within this time, so that no human's mode is overridden
#: land: after this wait an older report of the mode is enough: an operator who asks to land waits for 0.15 s at most
_MODE_WAIT_S = 0.1
_SILENCE_S = 0.5  #: land: not requested after a longer silence before a new report: a human may have taken over unseen
#: release: LAND not obeyed for longer, seven requests and the answer to the last; the autopilot's failsafe lands
_NO_REACTION_S = 5.0
#: land: a vehicle that has not lifted is disarmed only if its autopilot reported the ground within this time
_GROUND_FRESH_S = 0.5
_STUCK_S = 10.0  #: warn: a landing that has not descended for longer does not end by itself
_STILL_M = 0.05  #: warn: a smaller change of height is no descent
_WANDER_MPS = 0.03  #: warn: a slower change of height is drift of an estimate at rest; a landing descends ten times as fast


class Landing:
    """The landing of a flight; it cannot be taken back.

    ``seen``: the autopilot lands, and needs no more setpoints. ``alert``: what a human has to know or do. The motors are never
    stopped from here, except those of a vehicle that has not ``lifted`` and whose autopilot reports the ground too.
    """

    def __init__(self, seen: bool, lifted: bool = True) -> None:
        self.seen = seen
        self._lifted = lifted
        self._disarm_asked_s = -math.inf
        self._asked_s = self._deaf_s = -math.inf
        self._wait_s = self._in_vain_s = math.inf
        self._height_m = math.nan
        self._still_s = math.inf
        self._watched_s = math.inf
        self.alert: Reason | None = None

    def step(self, link: VehicleLink, now_s: float) -> ControlLoss | None:
        """Return None while it lasts, LANDED at its end, or YIELDED.

        YIELDED: somebody chose another mode, or the autopilot does not react to our requests.
        """
        t, firmware = link.telemetry, link.firmware
        if not t.mode.armed:
            return ControlLoss(FlightPhase.LANDED, None)
        lands = firmware.is_landing(t.mode.custom_mode)
        if not (lands or firmware.is_ours(t.mode.custom_mode)):
            return yielded(Reason(ReasonCode.MODE_CHANGED, (firmware.mode_name(t.mode.custom_mode),)))
        current = self._mode_is_current(t, now_s)
        stands = not self._lifted and now_s - t.on_ground_s <= _GROUND_FRESH_S
        if stands and current and now_s - self._disarm_asked_s >= _AGAIN_S:
            self._disarm_asked_s = now_s
            link.command(now_s, DISARM[0], *DISARM[1])
        if lands:
            self.seen = True
            self._in_vain_s = math.inf
            self._watch_descent(float(t.estimate.position_m[2]), now_s)
            return None
        self.alert = Reason(ReasonCode.LAND_REQUESTED) if self.seen else self.alert
        self._in_vain_s = min(self._in_vain_s, now_s + _NO_REACTION_S)
        if now_s > self._in_vain_s:
            ignored = Reason(ReasonCode.LAND_NOT_ACCEPTED, (_NO_REACTION_S,))
            return yielded(ignored, Reason(ReasonCode.FAILSAFE_LANDS), stop_heartbeats=True)
        if current and now_s - self._asked_s >= _AGAIN_S:
            self._asked_s = now_s
            link.command(now_s, firmware.land[0], *firmware.land[1])
        return None

    def _watch_descent(self, height_m: float, now_s: float) -> None:
        """Detect a landing that no longer descends and has not ended.

        The reference height follows slowly: it is one of the last of the descent, or the estimate drifts.
        """
        off_m, follows_m = height_m - self._height_m, _WANDER_MPS * max(now_s - self._watched_s, 0.0)
        self._watched_s = now_s
        if abs(off_m) <= _STILL_M:
            self._height_m += min(max(off_m, -follows_m), follows_m)
        else:
            self._height_m = height_m
            self._still_s = now_s
        if now_s - self._still_s >= _STUCK_S:
            self.alert = Reason(ReasonCode.LANDING_NOT_ENDING)

    def _mode_is_current(self, t: Telemetry, now_s: float) -> bool:
        """Return True if no human can have taken over unseen.

        The mode was reported this instant, or is not reported often; and it was reported after the last silence and request.
        """
        if now_s - t.received_s > _SILENCE_S:
            self._deaf_s = now_s
        self._wait_s = min(self._wait_s, now_s)
        waited = now_s - self._wait_s >= _MODE_WAIT_S
        return t.mode.heartbeat_s > max(self._asked_s, self._deaf_s) and (waited or now_s - t.mode.heartbeat_s < _MODE_FRESH_S)
