"""Control authority: whether the vehicle is ours.

It is ours from the mode that we requested until anybody else intervenes, and then never again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_recon.autopilot.firmware.profile import FirmwareProfile
from uav_recon.autopilot.mavlink.link_status import LinkStatus
from uav_recon.autopilot.mavlink.telemetry import ModeReport, Telemetry
from uav_recon.types.reason import Reason, autopilot_text
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import IN_THE_AIR, FlightPhase

_IDLE = (FlightPhase.CONNECTING, FlightPhase.READY)

_LATE_ARM_S = 5.0  #: land: motors that start within this time after our request are ours, even if it was withdrawn
_LINK_LOST_S = 3.0  #: release: autopilot silent for longer in flight; our heartbeats stop, and its failsafe lands
#: release: our mode again within this time after another: no human gives the vehicle back this soon, it was forged
_BACK_S = 1.0


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

    def watch(self, phase: FlightPhase, t: Telemetry, status: LinkStatus, now_s: float) -> ControlLoss | None:
        """Return the consequence of the autopilot's state for the present phase, None for nothing."""
        rebooted = status.reboots != self._reboots
        self._reboots = status.reboots
        if phase in _IDLE:
            self._idle_s = now_s
        return (
            self._unrequested_motors(phase, t.mode, now_s)
            or _lost_autopilot(phase, t, status, rebooted, now_s)
            or self._changed_mode(phase, t)
        )

    def _unrequested_motors(self, phase: FlightPhase, mode: ModeReport, now_s: float) -> ControlLoss | None:
        """Check motors that run before the take-off.

        They are ours only in the attempt that requested them.
        """
        if phase not in (*_IDLE, FlightPhase.ARMING) or not mode.armed or self._arm_asked_s > self._idle_s:
            return None
        ours = self._firmware.is_ours(mode.custom_mode)
        if (ours or self._firmware.is_landing(mode.custom_mode)) and self.motors_may_start(now_s):
            return ControlLoss(FlightPhase.LANDING, Reason(ReasonCode.ARMED_LATE))
        return yielded(Reason(ReasonCode.ARMED_BY_OTHER), stop_heartbeats=ours)  # ours: by us, before a restart

    def _changed_mode(self, phase: FlightPhase, t: Telemetry) -> ControlLoss | None:
        """Check that the vehicle still flies in our mode."""
        if phase is not FlightPhase.FLYING:
            return None
        if not t.mode.armed:
            return ControlLoss(FlightPhase.LANDED, Reason(ReasonCode.DISARMED_IN_FLIGHT))
        if self._firmware.is_landing(t.mode.custom_mode):
            return ControlLoss(FlightPhase.LANDING, Reason(ReasonCode.AUTOPILOT_LANDS, details=autopilot_text(t.warning)))
        if not self._firmware.is_ours(t.mode.custom_mode):
            return yielded(Reason(ReasonCode.MODE_CHANGED, (self._firmware.mode_name(t.mode.custom_mode),)))
        return None

    def reselected_message(self, mode: ModeReport, now_s: float) -> Reason | None:
        """Return a message for a human who selected our mode again, None for nothing.

        Control is not taken again.
        """
        ours = mode.armed and self._firmware.is_ours(mode.custom_mode) and now_s - self._yielded_s > _BACK_S
        return Reason(ReasonCode.CONTROL_RETURNED, (self._firmware.mode_name(mode.custom_mode),)) if ours else None

    def operator_lost(self, mode: ModeReport, status: LinkStatus, now_s: float) -> ControlLoss | None:
        """Check a vehicle that was yielded: if the mode that caused it was forged, no one flies it.

        A mode that a human chose stays without our heartbeats.
        """
        self._yielded_s = min(self._yielded_s, now_s)
        back = mode.armed and self._firmware.is_ours(mode.custom_mode) and now_s - self._yielded_s <= _BACK_S
        why = status.autopilot_fault or (Reason(ReasonCode.MODE_STILL_OURS) if back else None)
        return yielded(why, Reason(ReasonCode.FAILSAFE_LANDS), stop_heartbeats=True) if why else None


def _lost_autopilot(phase: FlightPhase, t: Telemetry, status: LinkStatus, rebooted: bool, now_s: float) -> ControlLoss | None:
    """Check that the autopilot is the one that is flown, did not restart, and is not silent."""
    in_the_air = phase in IN_THE_AIR
    if status.identity_fault and (in_the_air or phase is FlightPhase.ARMING):
        return yielded(status.identity_fault, stop_heartbeats=True)
    if in_the_air and rebooted:
        return yielded(Reason(ReasonCode.AUTOPILOT_RESTARTED))
    if in_the_air and now_s - t.received_s > _LINK_LOST_S:
        return yielded(Reason(ReasonCode.AUTOPILOT_SILENT), stop_heartbeats=True)
    return None


def yielded(*why: Reason, stop_heartbeats: bool = False) -> ControlLoss:
    """Return the loss of control for the rest of the flight."""
    return ControlLoss(FlightPhase.YIELDED, Reason(ReasonCode.CONTROL_RELEASED, details=why), stop_heartbeats)
