"""MAVLink proxy at the autopilot's end of the link.

Real-time flights use it: there, only that end of the link is in the simulator's process.
"""

from __future__ import annotations

from collections.abc import Callable

from sitl.autopilots.byte_links import ByteEnd
from sitl.faults.mavlink_proxy import DelayQueue, Fate, frames


class AutopilotSideProxy:
    """Proxy of the MAVLink link at the autopilot's end.

    It does the same as mavlink_proxy.Proxy. `sent` holds the datagrams with their arrival times, before the faults act on them.
    """

    def __init__(self, end: ByteEnd, now_s: Callable[[], float], up: Fate, down: Fate) -> None:
        self._end = end
        self._now_s = now_s
        self._up = up
        self._down = down
        self._rising = DelayQueue()
        self._falling = DelayQueue()
        self._forged: list[bytes] = []
        self.sent: list[tuple[float, bytes]] = []
        self.arrived: list[tuple[float, bytes]] = []
        self.heard: list[tuple[float, bytes]] = []

    @property
    def arrival_s(self) -> float | None:
        """Arrival time of the last datagram, in seconds; None where the link does not report it."""
        return self._end.arrival_s

    def read(self) -> bytes:
        """Return the bytes of the product that pass the faults and are due."""
        now_s = self._now_s()
        if data := self._end.read():
            self.sent.append((self._end.arrival_s or now_s, data))
            for frame in frames(data):
                self._rising.put(now_s, self._up(frame))
        ready = self._rising.take(now_s)
        self.arrived += [(now_s, frame) for frame in ready]
        data = b"".join((*ready, *self._forged))
        self._forged.clear()
        return data

    def write(self, data: bytes) -> None:
        """Send what the autopilot writes, altered or delayed by the faults."""
        for frame in frames(data):
            self._falling.put(self._now_s(), self._down(frame))
        self.forward()

    def forward(self) -> None:
        """Deliver the delayed frames that are due. Call it once per turn."""
        now_s = self._now_s()
        for frame in self._falling.take(now_s):
            self.heard.append((now_s, frame))
            self._end.write(frame)

    def inject_to_product(self, data: bytes) -> None:
        """Insert bytes into what the product reads next."""
        self.heard.append((self._now_s(), data))
        self._end.write(data)

    def inject_to_autopilot(self, data: bytes) -> None:
        """Insert bytes of another sender into what the autopilot reads next."""
        self._forged.append(data)
