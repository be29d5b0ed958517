"""Commands to the gimbal manager of the autopilot."""

from __future__ import annotations

import math

from uav_recon.autopilot.link.message_sender import MessageSender
from uav_recon.clock import RateKeeper

_MAX_RATE_HZ = 10.0
_CONFIGURE = 1001  # DO_GIMBAL_MANAGER_CONFIGURE


class GimbalCommands:
    """Claims the gimbal, and turns it."""

    def __init__(self, sender: MessageSender, start_s: float) -> None:
        self._sender = sender
        self._keeper = RateKeeper(_MAX_RATE_HZ, start_s)

    def claim(self, now_s: float) -> None:
        """Send DO_GIMBAL_MANAGER_CONFIGURE: we have primary control, secondary control is unused."""
        address = self._sender.address
        self._sender.command(now_s, _CONFIGURE, float(address.system), float(address.component), -1.0, -1.0)

    def turn(self, pitch_down_rad: float, now_s: float) -> None:
        """Send a camera pitch, at most ten times a second."""
        if self._keeper.due(now_s):
            pitch_rad = min(max(pitch_down_rad, -math.pi / 2), math.pi / 2)
            self._sender.send(self._sender.encoder.gimbal_pitch(self._sender.target, pitch_rad), now_s)
