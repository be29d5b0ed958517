"""Sender of messages with our ids to one vehicle."""

from __future__ import annotations

from uav_recon.autopilot.link.frame_exchange import FrameExchange
from uav_recon.autopilot.mavlink.address import COMPANION_ADDRESS, MavlinkAddress
from uav_recon.autopilot.mavlink.codec import Encoder


class MessageSender:
    """Sends what its encoder builds.

    address: our own. target: system of the vehicle; 0 before its first heartbeat.
    """

    def __init__(self, frames: FrameExchange, address: MavlinkAddress = COMPANION_ADDRESS) -> None:
        self._frames = frames
        self.address = address
        self.encoder = Encoder(*address)
        self.target = 0

    def send(self, frame: bytes, now_s: float) -> None:
        """Send a frame of the encoder."""
        self._frames.write(frame, now_s)

    def command(self, now_s: float, command: int, *parameters: float) -> None:
        """Send COMMAND_LONG to the autopilot."""
        self.send(self.encoder.command(self.target, command, *parameters), now_s)
