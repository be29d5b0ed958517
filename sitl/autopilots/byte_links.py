"""Byte links between the simulated autopilot and the product: memory for lockstep, loopback UDP for real time."""

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
    """What the autopilot needs of a link; arrival_s is None where reading is arriving."""

    @property
    def arrival_s(self) -> float | None:
        """When the bytes of the last read() arrived, on the world's clock."""
        ...

    def read(self) -> bytes:
        """Waiting bytes, b'' if none. Never blocks. Raises OSError if the link is gone."""
        ...

    def write(self, data: bytes) -> None:
        """Send. Never blocks. Raises OSError if the link is gone."""
        ...


class PipeEnd:
    """One end of a pipe in memory. Never blocks. For one thread, or one reader and one writer per direction."""

    def __init__(self, inbox: deque[bytes], outbox: deque[bytes]) -> None:
        self._inbox = inbox
        self._outbox = outbox
        self._closed = False

    @property
    def arrival_s(self) -> float | None:
        """Unknown: what is read was written before the reader's own instant."""
        return None

    def read(self) -> bytes:
        """All waiting bytes, b'' if none. Raises OSError once this end is closed."""
        if self._closed:
            raise OSError("the pipe is closed")
        if not self._inbox:
            return b""
        pieces = []
        while self._inbox:
            pieces.append(self._inbox.popleft())
        return b"".join(pieces)

    def write(self, data: bytes) -> None:
        """Hand over bytes; a reader that never comes loses the oldest. Raises OSError once this end is closed."""
        if self._closed:
            raise OSError("the pipe is closed")
        if data:
            self._outbox.append(bytes(data))

    def wait(self, timeout_s: float) -> None:
        """Return at once: in lockstep the owner of the clock decides when bytes come."""

    def close(self) -> None:
        """Refuse further use of this end."""
        self._closed = True


def pipe(depth: int = 20000) -> tuple[PipeEnd, PipeEnd]:
    """Two connected ends. depth: writes kept per direction before the oldest is dropped."""
    there: deque[bytes] = deque(maxlen=depth)
    back: deque[bytes] = deque(maxlen=depth)
    return PipeEnd(back, there), PipeEnd(there, back)


class UdpPeer:
    """A loopback UDP socket that talks to one address; PX4's onboard link sends first, to the companion's 14540.

    A remote of None is whoever speaks first. Raises ValueError for an address that is not loopback, OSError if local_port is
    in use.
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
        """The port this peer is bound to."""
        return int(self._socket.getsockname()[1])

    @property
    def arrival_s(self) -> float | None:
        """When the kernel took in the datagram that read() last returned, on time.monotonic(); None before the first."""
        return self._arrival_s

    def read(self) -> bytes:
        """The next datagram of the remote, b'' if none. Raises OSError if the socket is closed."""
        while True:
            try:
                data, ancillary, _, sender = self._socket.recvmsg(_DATAGRAM_MAX, 64)
            except BlockingIOError:
                return b""
            except ConnectionRefusedError:
                continue  # the remote is not up yet
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
        """Send; lost silently while the remote is not there. Raises OSError if the socket is closed."""
        if self._remote is None:
            return
        try:
            self._socket.sendto(data, self._remote)
        except (BlockingIOError, ConnectionRefusedError):
            return  # a datagram may be lost

    def wait(self, timeout_s: float) -> None:
        """Block until a datagram is there or the time is over."""
        select.select([self._socket], [], [], timeout_s)

    def close(self) -> None:
        """Release the port."""
        self._socket.close()
