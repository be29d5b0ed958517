"""The MAVLink proxy on the byte pipe: it keeps what the product sent, and hands frames to the injectors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

T = TypeVar("T")
Late = list[tuple[float, T]]  # what becomes of an item: (seconds late, the item); an empty list is a loss
_START, _HEADER, _CHECK, _SIGNATURE = 0xFD, 10, 2, 13


class Bytes(Protocol):
    """The product's end of the link, as the flight made it."""

    def read(self) -> bytes:
        """Waiting bytes."""
        ...

    def write(self, data: bytes) -> None:
        """Send."""
        ...

    def wait(self, timeout_s: float) -> None:
        """Block until bytes come or the time is over."""
        ...

    def close(self) -> None:
        """End it."""
        ...


def frames(data: bytes) -> list[bytes]:
    """Whole MAVLink 2 frames of a clean stream; whatever is none stays one piece."""
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
    """Of a whole frame; -1 for anything else."""
    return int.from_bytes(frame[7:10], "little") if len(frame) >= _HEADER and frame[0] == _START else -1


Fate = Callable[[bytes], Late[bytes]]


class Tap(Protocol):
    """A proxy, at either end. sent and heard: (instant, bytes) of what the product wrote and was given to read; arrived: of the
    frames of it that the troubles left to the autopilot, when it could read them.
    """

    sent: list[tuple[float, bytes]]
    arrived: list[tuple[float, bytes]]
    heard: list[tuple[float, bytes]]

    def forward(self) -> None:
        """Let late frames arrive; once a turn."""
        ...

    def forge(self, data: bytes) -> None:
        """Slip bytes into what the product reads next."""
        ...


class Queue:
    """Frames under way, by the instant at which they arrive; equal instants keep their order."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, int, bytes]] = []
        self._count = 0

    def put(self, now_s: float, late: Late[bytes]) -> None:
        """Send them off."""
        for seconds, frame in late:
            self._count += 1
            self._waiting.append((now_s + seconds, self._count, frame))

    def take(self, now_s: float) -> list[bytes]:
        """What has arrived by now."""
        if not self._waiting:
            return []
        ready = sorted(item for item in self._waiting if item[0] <= now_s + 1e-9)
        if ready:
            self._waiting = [item for item in self._waiting if item[0] > now_s + 1e-9]
        return [frame for _, _, frame in ready]


class Proxy:
    """Stands at the product's end; see Tap."""

    def __init__(self, end: Bytes, now_s: Callable[[], float], up: Fate, down: Fate) -> None:
        self._end, self._now_s, self._up, self._down = end, now_s, up, down
        self._rising, self._falling = Queue(), Queue()
        self._forged: list[bytes] = []
        self.sent: list[tuple[float, bytes]] = []
        self.arrived: list[tuple[float, bytes]] = []
        self.heard: list[tuple[float, bytes]] = []

    def read(self) -> bytes:
        """What the autopilot said and the troubles let through."""
        now_s = self._now_s()
        for frame in frames(self._end.read()):
            self._falling.put(now_s, self._down(frame))
        data = b"".join((*self._falling.take(now_s), *self._forged))
        self._forged.clear()
        if data:
            self.heard.append((now_s, data))
        return data

    def write(self, data: bytes) -> None:
        """Keep what the product says, and pass on what the troubles leave of it."""
        now_s = self._now_s()
        self.sent.append((now_s, data))
        for frame in frames(data):
            self._rising.put(now_s, self._up(frame))
        self.forward()

    def forward(self) -> None:
        """Let late frames arrive; once a turn."""
        now_s = self._now_s()
        for frame in self._rising.take(now_s):
            self.arrived.append((now_s, frame))
            self._end.write(frame)

    def forge(self, data: bytes) -> None:
        """Slip bytes into what the product reads next."""
        self._forged.append(data)

    def wait(self, timeout_s: float) -> None:
        """As the link itself."""
        self._end.wait(timeout_s)

    def close(self) -> None:
        """As the link itself."""
        self._end.close()
