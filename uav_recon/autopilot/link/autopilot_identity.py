"""Which autopilot it is that answers: known by its uid, and asked for again whenever another may have taken its place."""

from __future__ import annotations

import math

from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_SILENCE_S = 0.5  # a plug is not pulled and put into another vehicle in less
_AGAIN_S = 0.5


class AutopilotIdentity:
    """wanted: uid in hex, '' for that of whoever answers first. Who tells none is known by nothing."""

    def __init__(self, wanted: str = "") -> None:
        self._wanted, self._uid = wanted, ""
        self._received_s = self._asked_s = -math.inf
        self._asks = False
        self.fault: Reason | None = None  # why it is not the one that we fly

    def update(self, now_s: float, doubtful: bool) -> None:
        """The autopilot speaks. doubtful: with another clock than before."""
        self._asks = self._asks or doubtful or _SILENCE_S < now_s - self._received_s < math.inf
        self._received_s = now_s

    def told(self, uid: str) -> None:
        """What it answers, '' for nothing."""
        self._asks = False
        self._uid = self._uid or uid
        code = ReasonCode.AUTOPILOT_NOT_CONFIGURED if self._wanted else ReasonCode.AUTOPILOT_CHANGED
        wanted = self._wanted or self._uid
        same = int(uid or "0", 16) == int(wanted or "0", 16)
        self.fault = None if same else Reason(code, (uid or "none", wanted))

    def asks(self, now_s: float) -> bool:
        """Whether to ask now."""
        if not self._asks or now_s - self._asked_s < _AGAIN_S:
            return False
        self._asked_s = now_s
        return True
