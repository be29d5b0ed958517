"""Allow list of a link: one system's autopilot and gimbal.

Other senders are counted, and each is logged once.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

from uav_recon.autopilot.mavlink.codec import Decoder
from uav_recon.autopilot.mavlink.messages import Heartbeat, Received
from uav_recon.autopilot.mavlink.signing import NullSigner, Signer

_MAX_NAMES = 32


@dataclass(frozen=True, slots=True)
class AllowList:
    """MAVLink ids of the vehicle: its system, and its autopilot and gimbal components.

    uid: of the autopilot's hardware, in hex; '' for any autopilot.
    """

    system: int = 1
    autopilot: int = 1
    gimbal: int = 154
    uid: str = ""


class AllowListFilter:
    """The allow list of one link.

    refused: number of rejected frames and datagrams. seal: signer of the frames.
    """

    def __init__(self, allowed: AllowList | None = None, seal: Signer | None = None) -> None:
        self._allowed = allowed or AllowList()
        self.seal = seal or NullSigner()
        self._named: set[str] = set()
        self.refused = 0

    @property
    def uid(self) -> str:
        """Hardware id of the one autopilot that may be flown, '' for any."""
        return self._allowed.uid

    def has_heartbeat(self, data: bytes) -> bool:
        """Return True if a datagram holds a heartbeat of the vehicle's autopilot. Changes nothing."""
        return any(self._is_greeting(received) for received in Decoder().feed(data))

    def admits(self, received: Received) -> bool:
        """Return True if the frame's sender is allowed and its signature valid. Others are logged."""
        ours = (self._allowed.autopilot, self._allowed.gimbal)
        known = received.system == self._allowed.system and received.component in ours
        if known and self.seal.accept(received.frame):
            return True
        fault = " without a true and new signature" if known else ""
        self.refuse(f"system {received.system}, component {received.component}{fault}")
        return False

    def is_autopilot(self, received: Received) -> bool:
        """Return True if the sender has the ids of the vehicle's autopilot."""
        return (received.system, received.component) == (self._allowed.system, self._allowed.autopilot)

    def refuse(self, who: str, times: int = 1) -> None:
        """Count rejected input and log its sender.

        Each sender is logged once, and at most _MAX_NAMES of them: a forger can use any number of ids.
        """
        self.refused += times
        if times and who not in self._named and len(self._named) < _MAX_NAMES:
            self._named.add(who)
            logging.getLogger(__name__).warning("link: %s: not listened to", who)

    def close(self) -> None:
        """Save what a restart needs."""
        self.seal.close()

    def _is_greeting(self, received: Received) -> bool:
        message = received.message
        from_autopilot = isinstance(message, Heartbeat) and message.from_autopilot
        return from_autopilot and self.is_autopilot(received) and self.seal.verify(received.frame)
