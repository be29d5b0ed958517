"""MAVLink proxy on the byte link between product and autopilot.

It records what the product sends and passes frames to the injectors.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Protocol, TypeVar

from sitl.autopilots.byte_links import ByteEnd

T = TypeVar("T")
DelayedItems = list[tuple[float, T]]  # result of an injector: (delay in seconds, item) each; empty if the item is lost
_START = 0xFD
_HEADER = 10
_CHECK = 2
_SIGNATURE = 13


def frames(data: bytes) -> list[bytes]:
    """Split a clean stream into whole MAVLink 2 frames.

    From the first byte that begins no such frame, the rest is one piece.
    """
    out: list[bytes] = []
    at = 0
    while at < len(data):
        if data[at] != _START or len(data) - at < _HEADER:
            return [*out, data[at:]]
        end = at + _HEADER + data[at + 1] + _CHECK + (_SIGNATURE if data[at + 2] & 1 else 0)
        out.append(data[at:end])
        at = end
    return out


def message_id(frame: bytes) -> int:
    """Return the message id of a whole frame, -1 for anything else."""
    return int.from_bytes(frame[7:10], "little") if len(frame) >= _HEADER and frame[0] == _START else -1


Fate = Callable[[bytes], DelayedItems[bytes]]


class LinkEnd(ByteEnd, Protocol):
    """One end of the link, which the proxy owns."""

    def close(self) -> None:
        """Close this end."""
        ...


class DelayedFrames:
    """Frames of one direction in transit, by arrival time; equal times keep their order."""

    def __init__(self, fate: Fate) -> None:
        self._fate = fate
        self._waiting: list[tuple[float, int, bytes]] = []
        self._count = 0

    def put(self, now_s: float, data: bytes) -> None:
        """Pass the frames of these bytes to the faults, and queue the result with its delays."""
        for frame in frames(data):
            for delay_s, altered in self._fate(frame):
                self._count += 1
                self._waiting.append((now_s + delay_s, self._count, altered))

    def take(self, now_s: float) -> list[bytes]:
        """Return the frames that have arrived by now_s."""
        if not self._waiting:
            return []
        ready = sorted(item for item in self._waiting if item[0] <= now_s + 1e-9)
        if ready:
            self._waiting = [item for item in self._waiting if item[0] > now_s + 1e-9]
        return [frame for _, _, frame in ready]


class Side(Enum):
    """The end of the link at which a proxy is inserted: its owner reads and writes there."""

    PRODUCT = "product"
    AUTOPILOT = "autopilot"


class MavlinkProxy:
    """Proxy at one end of the link between product and autopilot.

    The faults act on whole frames.

    In lockstep it is the product's end. In real time only the autopilot's end is in the simulator's process.
    sent: (time, bytes) that the product wrote, with arrival times at the autopilot's end; before the faults act.
    arrived: (time, frame) of the product's frames that passed the faults, when the autopilot could read them.
    heard: (time, bytes) that the product was given to read.
    """

    def __init__(self, end: LinkEnd, side: Side, now_s: Callable[[], float], to_autopilot: Fate, to_product: Fate) -> None:
        self._end = end
        self._at_product = side is Side.PRODUCT
        self._now_s = now_s
        self._incoming = DelayedFrames(to_product if self._at_product else to_autopilot)
        self._outgoing = DelayedFrames(to_autopilot if self._at_product else to_product)
        self._injected: list[bytes] = []
        self.sent: list[tuple[float, bytes]] = []
        self.arrived: list[tuple[float, bytes]] = []
        self.heard: list[tuple[float, bytes]] = []

    @property
    def arrival_s(self) -> float | None:
        """Arrival time of the last datagram, in seconds; None where the link does not report it."""
        return self._end.arrival_s

    def read(self) -> bytes:
        """Return the bytes of the other side that pass the faults and are due."""
        now_s = self._now_s()
        received = self._end.read()
        if received and not self._at_product:
            self.sent.append((self._end.arrival_s or now_s, received))
        self._incoming.put(now_s, received)
        ready = self._incoming.take(now_s)
        data = b"".join((*ready, *self._injected))
        self._injected.clear()
        if not self._at_product:
            self.arrived += [(now_s, frame) for frame in ready]
        elif data:
            self.heard.append((now_s, data))
        return data

    def write(self, data: bytes) -> None:
        """Send what the owner of this end writes, altered or delayed by the faults."""
        now_s = self._now_s()
        if self._at_product:
            self.sent.append((now_s, data))
        self._outgoing.put(now_s, data)
        self.forward()

    def forward(self) -> None:
        """Deliver the delayed frames that are due. Call it once per turn."""
        now_s = self._now_s()
        delivered = self.arrived if self._at_product else self.heard
        for frame in self._outgoing.take(now_s):
            delivered.append((now_s, frame))
            self._end.write(frame)

    def inject_to_product(self, data: bytes) -> None:
        """Insert bytes into what the product reads next."""
        if self._at_product:
            self._injected.append(data)
        else:
            self.heard.append((self._now_s(), data))
            self._end.write(data)

    def inject_to_autopilot(self, data: bytes) -> None:
        """Insert bytes of another sender into what the autopilot reads next."""
        if self._at_product:
            self._end.write(data)
        else:
            self._injected.append(data)

    def wait(self, timeout_s: float) -> None:
        """Return at once: in lockstep the owner of the clock decides when bytes arrive."""

    def close(self) -> None:
        """Close this end of the link."""
        self._end.close()
