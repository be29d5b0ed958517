"""Take-off sequence: arms the vehicle in our mode, monitors its climb, aborts both."""

from __future__ import annotations

import math

from uav_recon.autopilot.firmware.profile import ARM, ArmingOutcome, ArmingSequence
from uav_recon.autopilot.firmware.takeoff_monitor import TakeoffMonitor
from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.pilot.sequence.control_authority import ControlAuthority
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


class TakeoffSequence:
    """The newest take-off, and whether another may begin.

    ``allowed``: False after a take-off that was refused or aborted, until the mission withdraws its request to fly.
    ``abort_reason``: why arming was aborted. ``climb_fault``: why the climb must end, None while it may continue.
    """

    def __init__(self, link: VehicleLink, authority: ControlAuthority) -> None:
        self._link = link
        self._authority = authority
        self._arming: ArmingSequence | None = None  # None before the first take-off
        self._climb = TakeoffMonitor(math.nan)
        self.allowed = True
        self.abort_reason: Reason | None = None
        self.climb_fault: Reason | None = None

    @property
    def streams(self) -> bool:
        """True if setpoints must be sent while it arms; otherwise none may be sent before it flies."""
        return self._arming is not None and self._arming.streams

    @property
    def lifted(self) -> bool:
        """False while the vehicle is known to stand where its take-off began."""
        return self._arming is None or self._climb.lifted

    def begin(self, now_s: float) -> None:
        """Start a take-off from where the vehicle stands."""
        self._arming = self._link.firmware.arming(now_s)
        self._climb = TakeoffMonitor(float(self._link.telemetry.estimate.position_m[2]))
        self.abort_reason = self.climb_fault = None

    def arm(self, now_s: float, wanted: bool, land_wanted: Reason | None) -> ArmingOutcome:
        """Run one step of arming: send the command that is due, and return the state of the attempt.

        wanted: the mission still wants to fly, and nothing prevents it. land_wanted: why the operator wants no flight.
        """
        self.abort_reason = (
            land_wanted or self._link.status.duplicate_fault or (None if wanted else Reason(ReasonCode.ARMING_WITHDRAWN))
        )
        if self._arming is None or self.abort_reason:
            return ArmingOutcome.GIVEN_UP
        outcome, command = self._arming.step(now_s, self._link.telemetry)
        self.abort_reason = self._arming.reason
        if outcome is ArmingOutcome.PENDING and command is not None:
            if command == ARM:
                self._authority.asked_to_arm(now_s)
            self._link.command(now_s, command[0], *command[1])
        return outcome

    def begin_climb(self, now_s: float) -> None:
        """Record that a setpoint leads upwards; later calls have no effect."""
        self._climb.begin(now_s)

    def watch_climb(self, now_s: float) -> None:
        """Update the fault of the climb. Call it every step from begin() to the landing."""
        fault = self._climb.fault(now_s, self._link.telemetry)
        self.climb_fault = Reason(ReasonCode.TAKEOFF_GIVEN_UP, details=(fault,)) if fault else None

    def forbid(self) -> None:
        """Allow no further take-off before the mission has withdrawn its request to fly."""
        self.allowed = False

    def withdraw(self) -> None:
        """Record that the mission does not request to fly: the next request is a new one."""
        self.allowed = True
