"""Requests to the mission: start, hold, return and abort.

They come from the operator and from the mission's own events.
"""

from __future__ import annotations

from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.requests.operator_watchdog import OperatorWatchdog
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_OPERATOR_RETURN = Reason(ReasonCode.OPERATOR_RETURN)


class MissionRequests:
    """The requests of one mission, given at any time and read in each step.

    held: the operator's hold is active. return_reason: the first reason to go home, None for no such request.
    """

    def __init__(self, watchdog: OperatorWatchdog, log: MissionLog) -> None:
        self._watchdog = watchdog
        self._log = log
        self._released = False
        self.started = self.held = self.aborted = False
        self.return_reason: Reason | None = None

    @property
    def startable(self) -> bool:
        """True if the flight was started and no operator is missing."""
        return self.started and not self._watchdog.missing

    @property
    def start_blocker(self) -> Reason | None:
        """Reason why a start that was given has no effect now, None for nothing."""
        return self._watchdog.missing if self.started else None

    def start(self) -> None:
        """Start the flight: by the operator's command or by autostart."""
        self.started = True

    def hold(self) -> None:
        """Hold position until resume() or return_home(); the mission's own events wait."""
        self.held = True

    def return_home(self, reason: Reason = _OPERATOR_RETURN) -> None:
        """Fly home and land; never taken back."""
        self.return_reason = self.return_reason or reason
        self.resume()

    def resume(self) -> None:
        """Continue after a hold; without one nothing changes."""
        self._released = self._released or self.held
        self.held = False

    def abort(self, reason: Reason) -> None:
        """Land now; never taken back."""
        self.aborted = True
        self._log.aborted = self._log.aborted or reason

    def take_release(self) -> bool:
        """Return True once after each hold that has ended."""
        released, self._released = self._released, False
        return released
