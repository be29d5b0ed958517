"""Operator watchdog: detects a missing operator from the pilot's answers (hazard D8).

A sender of HEARTBEAT does not count as an operator (S7).
"""

from __future__ import annotations

import math

from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

WARN_S = 5.0  #: warn: operator silent for longer; on the ground no flight begins
BACK_S = 5.0  #: warn: ends after heartbeats for this time without a gap: a single one does not end it, so none comes twice
_FUTURE_S = 0.1  #: reject: a heartbeat of the operator stamped later than the clock by this


class OperatorWatchdog:
    """The watchdog of one mission; call update() in each step.

    timeout_s: silence in flight until the vehicle goes home; inf: no operator is needed. One heartbeat restarts the count, but
    a missing operator counts as back only after BACK_S of them. note: message for people in flight; lost: why the vehicle has
    to go home now; None for nothing.
    """

    def __init__(self, timeout_s: float = math.inf) -> None:
        self._timeout_s = timeout_s
        self._warn_s = WARN_S if timeout_s < math.inf else math.inf
        # the newest heartbeat, and the first of those without a gap
        self._received_s = -math.inf
        self._steady_s = math.inf
        self._silent_s = math.inf
        self._missed = False
        self.note: Reason | None = None
        self.lost: Reason | None = None

    @property
    def missing(self) -> Reason | None:
        """Reason why no flight begins now, None for nothing."""
        return Reason(ReasonCode.OPERATOR_MISSING) if self._silent_s > self._warn_s else None

    def update(self, now_s: float, received_s: float, flying: bool) -> Reason | None:
        """Update the state, and return what is new in note, None for nothing.

        received_s: when the pilot last received the operator's request.
        """
        if self._received_s < received_s <= now_s + _FUTURE_S:
            broken = self._steady_s == math.inf or received_s - self._received_s > WARN_S
            self._steady_s = received_s if broken else self._steady_s
            self._received_s = received_s
        elif flying and self._received_s == -math.inf:
            self._received_s = now_s  # a restarted pilot: the last heartbeat is unknown
        self._silent_s = now_s - self._received_s
        before = self.note
        self._judge(flying)
        return self.note if self.note != before else None

    def _judge(self, flying: bool) -> None:
        lost = flying and self._silent_s > self._timeout_s
        self.lost = Reason(ReasonCode.OPERATOR_LOST, (self._timeout_s,)) if lost else None
        if not flying:
            self._missed = False
            self.note = None
        elif self.lost:
            self.note = Reason(ReasonCode.OPERATOR_LOST_RETURNING, (self._timeout_s,))
        elif self._silent_s > self._warn_s and not self._missed:
            self._missed = True
            self._steady_s = math.inf
            self.note = Reason(ReasonCode.OPERATOR_SILENT, (WARN_S, self._timeout_s))
        elif self._missed and self._received_s - self._steady_s >= BACK_S:
            self._missed = False
            self.note = Reason(ReasonCode.OPERATOR_BACK)
