"""Whether an operator attends, by when the pilot last answered one (HAZARDS, D8). Who only sends HEARTBEAT is none (S7)."""

from __future__ import annotations

import math

from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

WARN_S = 5.0  # of silence
BACK_S = 5.0  # of signs of life without such a silence between them: a single one ends no warning, so none comes twice
_FUTURE_S = 0.1


class OperatorWatchdog:
    """One mission's. hear() what the pilot says, step by step.

    timeout_s: of silence in flight, until it goes home; inf: nobody need attend. One sign of life begins the count anew, but
    who was missed is back only after BACK_S of them. note: what people are to be told in flight; lost: why it has to go home
    now; None for nothing.
    """

    def __init__(self, timeout_s: float = math.inf) -> None:
        self._timeout_s, self._warn_s = timeout_s, WARN_S if timeout_s < math.inf else math.inf
        self._received_s, self._steady_s = (
            -math.inf,
            math.inf,
        )  # the newest sign, and the first of those without a silence between
        self._silent_s, self._missed = math.inf, False
        self.note: Reason | None = None
        self.lost: Reason | None = None

    @property
    def missing(self) -> Reason | None:
        """Why no flight begins now, None for nothing."""
        return Reason(ReasonCode.OPERATOR_MISSING) if self._silent_s > self._warn_s else None

    def update(self, now_s: float, received_s: float, flying: bool) -> Reason | None:
        """received_s: when the pilot last heard the operator. Returns what is new in note, None for nothing."""
        if self._received_s < received_s <= now_s + _FUTURE_S:
            broken = self._steady_s == math.inf or received_s - self._received_s > WARN_S
            self._steady_s, self._received_s = received_s if broken else self._steady_s, received_s
        elif flying and self._received_s == -math.inf:
            self._received_s = now_s  # a pilot that has forgotten: nobody knows since when
        self._silent_s, before = now_s - self._received_s, self.note
        self._judge(flying)
        return self.note if self.note != before else None

    def _judge(self, flying: bool) -> None:
        lost = flying and self._silent_s > self._timeout_s
        self.lost = Reason(ReasonCode.OPERATOR_LOST, (self._timeout_s,)) if lost else None
        if not flying:
            self._missed, self.note = False, None
        elif self.lost:
            self.note = Reason(ReasonCode.OPERATOR_LOST_RETURNING, (self._timeout_s,))
        elif self._silent_s > self._warn_s and not self._missed:
            self._missed, self._steady_s = True, math.inf
            self.note = Reason(ReasonCode.OPERATOR_SILENT, (WARN_S, self._timeout_s))
        elif self._missed and self._received_s - self._steady_s >= BACK_S:
            self._missed, self.note = False, Reason(ReasonCode.OPERATOR_BACK)
