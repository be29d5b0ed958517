"""Control authority: whether the vehicle is ours.

It is ours from the mode that we requested until anybody else intervenes, and then never again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_recon.autopilot.firmware.profile import FirmwareProfile
from uav_recon.autopilot.link.link_alerts import TWO
from uav_recon.autopilot.mavlink.telemetry import Telemetry
from uav_recon.types.reason import Reason, autopilot_text
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import FlightPhase

_IDLE = (FlightPhase.CONNECTING, FlightPhase.READY)
IN_THE_AIR = (FlightPhase.FLYING, FlightPhase.LANDING)

_LATE_ARM_S = 5.0
_LINK_LOST_S = 3.0
_BACK_S = 1.0  # after a mode that was not ours: no human gives the vehicle back this soon


@dataclass(frozen=True, slots=True)
class ControlLoss:
    """The phase of the flight after an intervention, and the reason.

    stop_heartbeats: no one flies the vehicle now, so our heartbeats stop and the autopilot lands by itself.
    """

    phase: FlightPhase
    why: Reason | None
    stop_heartbeats: bool = False


class ControlAuthority:
    """Monitors who controls the vehicle.

    Everything that we did not request is the intervention of somebody else: yield, or accept the autopilot's landing.
    """

    def __init__(self, firmware: FirmwareProfile) -> None:
        self._firmware = firmware
        self._arm_asked_s = self._idle_s = -math.inf
        self._reboots = 0
        self._yielded_s = math.inf

    def asked_to_arm(self, now_s: float) -> None:
        """Record a request to arm: motors that start within a few seconds are ours."""
        self._arm_asked_s = now_s

    def motors_may_start(self, now_s: float) -> bool:
        """Return True while that time is not over."""
        return now_s - self._arm_asked_s < _LATE_ARM_S

    def watch(self, phase: FlightPhase, t: Telemetry, now_s: float) -> ControlLoss | None:
        """Return the consequence of the autopilot's state for the present phase, None for nothing.

        Motors are ours only in the attempt that requested them.
        """
        rebooted = t.reboots != self._reboots
        self._reboots = t.reboots
        if phase in _IDLE:
            self._idle_s = now_s
        if phase in (*_IDLE, FlightPhase.ARMING) and t.armed and self._arm_asked_s <= self._idle_s:
            ours = self._firmware.is_ours(t.custom_mode)
            if (ours or self._firmware.is_landing(t.custom_mode)) and self.motors_may_start(now_s):
                return ControlLoss(FlightPhase.LANDING, Reason(ReasonCode.ARMED_LATE))
            return yielded(Reason(ReasonCode.ARMED_BY_OTHER), stop_heartbeats=ours)  # ours: by us, before a restart
        if t.identity_fault and phase in (FlightPhase.ARMING, *IN_THE_AIR):
            return yielded(t.identity_fault, stop_heartbeats=True)
        if phase in IN_THE_AIR and rebooted:
            return yielded(Reason(ReasonCode.AUTOPILOT_RESTARTED))
        if phase in IN_THE_AIR and now_s - t.received_s > _LINK_LOST_S:
            return yielded(Reason(ReasonCode.AUTOPILOT_SILENT), stop_heartbeats=True)
        if phase is not FlightPhase.FLYING:
            return None
        if not t.armed:
            return ControlLoss(FlightPhase.LANDED, Reason(ReasonCode.DISARMED_IN_FLIGHT))
        if self._firmware.is_landing(t.custom_mode):
            return ControlLoss(FlightPhase.LANDING, Reason(ReasonCode.AUTOPILOT_LANDS, details=autopilot_text(t.warning)))
        if not self._firmware.is_ours(t.custom_mode):
            return yielded(Reason(ReasonCode.MODE_CHANGED, (self._firmware.mode_name(t.custom_mode),)))
        return None

    def reselected_message(self, t: Telemetry, now_s: float) -> Reason | None:
        """Return a message for a human who selected our mode again, None for nothing.

        Control is not taken again.
        """
        ours = t.armed and self._firmware.is_ours(t.custom_mode) and now_s - self._yielded_s > _BACK_S
        return Reason(ReasonCode.CONTROL_RETURNED, (self._firmware.mode_name(t.custom_mode),)) if ours else None

    def operator_lost(self, t: Telemetry, now_s: float) -> ControlLoss | None:
        """Check a vehicle that was yielded: if the mode that caused it was forged, no one flies it.

        A mode that a human chose stays without our heartbeats.
        """
        self._yielded_s = min(self._yielded_s, now_s)
        if t.identity_fault or t.duplicate_autopilot:
            return yielded(t.identity_fault or TWO, Reason(ReasonCode.FAILSAFE_LANDS), stop_heartbeats=True)
        back = t.armed and self._firmware.is_ours(t.custom_mode) and now_s - self._yielded_s <= _BACK_S
        if not back:
            return None
        return yielded(Reason(ReasonCode.MODE_STILL_OURS), Reason(ReasonCode.FAILSAFE_LANDS), stop_heartbeats=True)


def yielded(*why: Reason, stop_heartbeats: bool = False) -> ControlLoss:
    """Return the loss of control for the rest of the flight."""
    return ControlLoss(FlightPhase.YIELDED, Reason(ReasonCode.CONTROL_RELEASED, details=why), stop_heartbeats)
