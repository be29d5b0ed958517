"""Byte links between autopilot and product: in memory (lockstep), loopback UDP (real time)."""

from __future__ import annotations

import select
import socket
import struct
import time
from collections import deque
from typing import Protocol

_TIMESTAMPNS = 35  # SO_TIMESTAMPNS on Linux; the socket module does not name it
_TIMESPEC = struct.Struct("@qq")
_DATAGRAM_MAX = 65535
_BACKLOG_BYTES = 1 << 20


class ByteEnd(Protocol):
    """One end of a byte link. arrival_s is None if bytes arrive at the time they are read."""

    @property
    def arrival_s(self) -> float | None:
        """Arrival time of the bytes of the last read(), s on the world clock."""
        ...

    def read(self) -> bytes:
        """Return the waiting bytes, b'' if none. Never blocks. Raises OSError if the link is closed."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes. Never blocks. Raises OSError if the link is closed."""
        ...


class PipeEnd:
    """One end of a pipe in memory. Never blocks.

    For one thread, or one reader and one writer per direction.
    """

    def __init__(self, inbox: deque[bytes], outbox: deque[bytes]) -> None:
        self._inbox = inbox
        self._outbox = outbox
        self._closed = False

    @property
    def arrival_s(self) -> float | None:
        """None: the bytes count as arrived at the time they are read."""
        return None

    def read(self) -> bytes:
        """Return all waiting bytes, b'' if none. Raises OSError once this end is closed."""
        if self._closed:
            raise OSError("the pipe is closed")
        if not self._inbox:
            return b""
        pieces = []
        while self._inbox:
            pieces.append(self._inbox.popleft())
        return b"".join(pieces)

    def write(self, data: bytes) -> None:
        """Send bytes; the oldest unread ones may be lost. Raises OSError once this end is closed."""
        if self._closed:
            raise OSError("the pipe is closed")
        if data:
            self._outbox.append(bytes(data))

    def wait(self, timeout_s: float) -> None:
        """Return at once: in lockstep the owner of the clock decides when bytes arrive."""

    def close(self) -> None:
        """Close this end."""
        self._closed = True


def pipe(depth: int = 20000) -> tuple[PipeEnd, PipeEnd]:
    """Return two connected ends. depth: writes kept per direction before the oldest is dropped."""
    there: deque[bytes] = deque(maxlen=depth)
    back: deque[bytes] = deque(maxlen=depth)
    return PipeEnd(back, there), PipeEnd(there, back)


class UdpPeer:
    """A loopback UDP socket with one peer; as PX4's onboard link it sends first, to port 14540.

    If remote is None, the sender of the first datagram becomes the peer. Raises ValueError for an address that is not
    loopback, OSError if local_port is in use.
    """

    def __init__(self, local_port: int = 0, remote: tuple[str, int] | None = ("127.0.0.1", 14540)) -> None:
        if remote is not None and not remote[0].startswith("127."):
            raise ValueError(f"the simulated autopilot speaks on loopback only, not to {remote[0]}")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BACKLOG_BYTES)
            self._socket.setsockopt(socket.SOL_SOCKET, _TIMESTAMPNS, 1)
            self._socket.setblocking(False)
            self._socket.bind(("127.0.0.1", local_port))
        except OSError:
            self._socket.close()
            raise
        self._remote = remote
        self._arrival_s: float | None = None

    @property
    def local_port(self) -> int:
        """The local port."""
        return int(self._socket.getsockname()[1])

    @property
    def arrival_s(self) -> float | None:
        """Time at which the kernel received the datagram of the last read(); None before the first.

        Seconds of time.monotonic().
        """
        return self._arrival_s

    def read(self) -> bytes:
        """Return the next datagram of the peer, b'' if none. Raises OSError if the socket is closed."""
        while True:
            try:
                data, ancillary, _, sender = self._socket.recvmsg(_DATAGRAM_MAX, 64)
            except BlockingIOError:
                return b""
            except ConnectionRefusedError:
                continue  # the peer has not opened its socket yet
            if self._remote is None:
                self._remote = sender
            if sender != self._remote:
                continue
            self._arrival_s = time.monotonic()
            for level, kind, value in ancillary:
                if level == socket.SOL_SOCKET and kind == _TIMESTAMPNS:
                    seconds, nanoseconds = _TIMESPEC.unpack_from(value)
                    waited = time.time() - (seconds + nanoseconds * 1e-9)
                    self._arrival_s -= min(max(waited, 0.0), 5.0)  # the wall clock may have been set in between
            return data

    def write(self, data: bytes) -> None:
        """Send a datagram, which is lost silently without a peer. Raises OSError if closed."""
        if self._remote is None:
            return
        try:
            self._socket.sendto(data, self._remote)
        except (BlockingIOError, ConnectionRefusedError):
            return  # a datagram may be lost

    def wait(self, timeout_s: float) -> None:
        """Block until a datagram arrives or the timeout expires."""
        select.select([self._socket], [], [], timeout_s)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
