"""Identity of the autopilot by its hardware uid.

The uid is requested again whenever another autopilot may have replaced it.
"""

from __future__ import annotations

import math

from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

#: release: after a longer silence another uid counts: a cable is not plugged into another vehicle in less time
_SILENCE_S = 0.5
_AGAIN_S = 0.5  #: internal: interval of the requests for the uid


class AutopilotIdentity:
    """Checks the autopilot's uid.

    wanted: uid in hex, '' for that of the first autopilot that answers. An autopilot without a uid cannot be identified.
    """

    def __init__(self, wanted: str = "") -> None:
        self._wanted = wanted
        self._uid = ""
        self._received_s = self._asked_s = -math.inf
        self._asks = False
        self.fault: Reason | None = None  # why it is not the one that is flown

    def update(self, now_s: float, doubtful: bool) -> None:
        """Record that the autopilot sent a message. doubtful: its clock may differ from before."""
        self._asks = self._asks or doubtful or _SILENCE_S < now_s - self._received_s < math.inf
        self._received_s = now_s

    def check_uid(self, uid: str) -> None:
        """Compare the uid that it answers, None for nothing."""
        self._asks = False
        self._uid = self._uid or uid
        code = ReasonCode.AUTOPILOT_NOT_CONFIGURED if self._wanted else ReasonCode.AUTOPILOT_CHANGED
        wanted = self._wanted or self._uid
        same = int(uid or "0", 16) == int(wanted or "0", 16)
        self.fault = None if same else Reason(code, (uid or "none", wanted))

    def request_due(self, now_s: float) -> bool:
        """Return True if the uid should be requested now, and count it as requested."""
        if not self._asks or now_s - self._asked_s < _AGAIN_S:
            return False
        self._asked_s = now_s
        return True
