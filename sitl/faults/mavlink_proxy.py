"""MAVLink proxy on the byte pipe.

It records what the product sends and passes frames to the injectors.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

T = TypeVar("T")
DelayedItems = list[tuple[float, T]]  # result of an injector: (delay in seconds, item) each; empty if the item is lost
_START = 0xFD
_HEADER = 10
_CHECK = 2
_SIGNATURE = 13


class Bytes(Protocol):
    """The product's end of the link, as the flight makes it."""

    def read(self) -> bytes:
        """Return the waiting bytes."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes."""
        ...

    def wait(self, timeout_s: float) -> None:
        """Block until bytes arrive or the timeout has passed."""
        ...

    def close(self) -> None:
        """Close the link."""
        ...


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


class ProxyInterface(Protocol):
    """Proxy at either end of the link.

    sent: (time, bytes) that the product wrote.
    arrived: (time, frame) of the product's frames that passed the faults, when the autopilot could read them.
    heard: (time, bytes) that the product was given to read.
    """

    sent: list[tuple[float, bytes]]
    arrived: list[tuple[float, bytes]]
    heard: list[tuple[float, bytes]]

    def forward(self) -> None:
        """Deliver the delayed frames that are due. Call it once per turn."""
        ...

    def inject_to_product(self, data: bytes) -> None:
        """Insert bytes into what the product reads next."""
        ...

    def inject_to_autopilot(self, data: bytes) -> None:
        """Insert bytes of another sender into what the autopilot reads next."""
        ...


class DelayQueue:
    """Frames in transit, ordered by arrival time; frames with equal times keep their order."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, int, bytes]] = []
        self._count = 0

    def put(self, now_s: float, late: DelayedItems[bytes]) -> None:
        """Queue frames with their delays."""
        for seconds, frame in late:
            self._count += 1
            self._waiting.append((now_s + seconds, self._count, frame))

    def take(self, now_s: float) -> list[bytes]:
        """Return the frames that have arrived by now_s."""
        if not self._waiting:
            return []
        ready = sorted(item for item in self._waiting if item[0] <= now_s + 1e-9)
        if ready:
            self._waiting = [item for item in self._waiting if item[0] > now_s + 1e-9]
        return [frame for _, _, frame in ready]


class Proxy:
    """Proxy at the product's end of the link; see Tap."""

    def __init__(self, end: Bytes, now_s: Callable[[], float], up: Fate, down: Fate) -> None:
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

    def read(self) -> bytes:
        """Return the bytes of the autopilot that pass the faults and are due."""
        now_s = self._now_s()
        for frame in frames(self._end.read()):
            self._falling.put(now_s, self._down(frame))
        data = b"".join((*self._falling.take(now_s), *self._forged))
        self._forged.clear()
        if data:
            self.heard.append((now_s, data))
        return data

    def write(self, data: bytes) -> None:
        """Record what the product sends, and forward it, altered or delayed by the faults."""
        now_s = self._now_s()
        self.sent.append((now_s, data))
        for frame in frames(data):
            self._rising.put(now_s, self._up(frame))
        self.forward()

    def forward(self) -> None:
        """Deliver the delayed frames that are due. Call it once per turn."""
        now_s = self._now_s()
        for frame in self._rising.take(now_s):
            self.arrived.append((now_s, frame))
            self._end.write(frame)

    def inject_to_product(self, data: bytes) -> None:
        """Insert bytes into what the product reads next."""
        self._forged.append(data)

    def inject_to_autopilot(self, data: bytes) -> None:
        """Insert bytes of another sender into what the autopilot reads next."""
        self._end.write(data)

    def wait(self, timeout_s: float) -> None:
        """Block until the link has bytes or the timeout has passed."""
        self._end.wait(timeout_s)

    def close(self) -> None:
        """Close the link."""
        self._end.close()
