"""Failsafe monitor: the failsafe action of a flight, its reason, and the flight's refusals."""

from __future__ import annotations

from uav_recon.safety.failsafe import Failsafe
from uav_recon.safety.failsafe_precedence import FailsafeAction, FailsafeInputs, FailsafeTimeouts
from uav_recon.safety.refusals import RefusalCounter, RefusalHistory
from uav_recon.types.reason import Reason


class FailsafeMonitor:
    """The failsafe of the present flight.

    counter: of refusals. ``refusals``: those of this flight. ``action``: the action in flight; FLY until the vehicle flies.
    ``reason``: why it is not FLY.
    """

    def __init__(self, timeouts: FailsafeTimeouts, counter: RefusalCounter) -> None:
        self._timeouts = timeouts
        self._counter = counter
        self.begin_flight()

    def begin_flight(self) -> None:
        """Start a flight: nothing is remembered of the one before."""
        self._failsafe = Failsafe(self._timeouts)
        self.refusals = RefusalHistory(self._counter, quiet_s=self._timeouts.land_timeout_s)
        self.action = FailsafeAction.FLY
        self.reason: Reason | None = None

    @property
    def landing_reason(self) -> Reason | None:
        """Reason for a landing, None unless the action is LAND."""
        return self.reason if self.action is FailsafeAction.LAND else None

    def prevents_takeoff(self, inputs: FailsafeInputs) -> bool:
        """Return True if a flight would have to end at once.

        Call it every step before the flight.
        """
        return self._failsafe.step(inputs)[0] is FailsafeAction.LAND

    def update(self, inputs: FailsafeInputs, detail: Reason | None) -> bool:
        """Update action and reason in flight; return True if the action became more severe.

        detail: what is added to the reason.
        """
        before = self.action
        self.action, reason = self._failsafe.step(inputs)
        self.reason = reason.with_detail(detail) if reason is not None and detail is not None else reason
        return self.action > before
