"""Byte links to an autopilot: a UDP socket or a serial line, neither of which ever blocks the loop."""

from __future__ import annotations

import fcntl
import os
import select
import socket
import termios
from typing import Any

from uav_recon.protocols import ByteLink

_READ_BUDGET = 1 << 16
_BAUDS = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 500000, 921600, 1000000, 1500000, 2000000, 3000000)


class LinkError(Exception):
    """A link that cannot be opened; its text is one line that names the port."""


def open_link(url: str) -> ByteLink:
    """Open ``udp:HOST:PORT`` (listens there) or ``serial:DEVICE:BAUD``. Raises LinkError with one line."""
    kind, _, rest = url.partition(":")
    place, _, number = rest.rpartition(":")
    if kind not in ("udp", "serial") or not place or not number.isdigit():
        raise LinkError(f"link {url!r}: write udp:HOST:PORT or serial:DEVICE:BAUD")
    return UdpLink(place, int(number)) if kind == "udp" else SerialLink(place, int(number))


class UdpLink:
    """Listens on one address and answers whoever spoke last. Before anybody did, what is written goes nowhere."""

    def __init__(self, host: str, port: int) -> None:
        if host in ("0.0.0.0", "::", "*", ""):  # noqa: S104  (refused, not used)
            raise LinkError(f"link udp:{host}:{port}: name one address; listening on every network would let anybody fly")
        if not 0 < port < 65536:
            raise LinkError(f"link udp:{host}:{port}: a port is 1 to 65535")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peer: Any = None
        self.dropped_writes = 0
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise LinkError(f"link udp:{host}:{port}: {error.strerror or error}") from None

    def read(self) -> bytes:
        """Datagrams that arrived, at most 64 KiB a call. Raises OSError if the socket is closed."""
        parts, size = [], 0
        while size < _READ_BUDGET:
            try:
                data, self._peer = self._socket.recvfrom(2048)
            except (BlockingIOError, ConnectionRefusedError):  # a peer that ended is silence, not a broken link
                break
            parts.append(data)
            size += len(data)
        return b"".join(parts)

    def write(self, data: bytes) -> None:
        """Send to the last peer; what the kernel cannot take at once is dropped and counted."""
        if self._peer is None:
            return
        try:
            self._socket.sendto(data, self._peer)
        except (BlockingIOError, ConnectionRefusedError):
            self.dropped_writes += 1

    def wait(self, timeout_s: float) -> None:
        """Block until a datagram is there or the time is over."""
        select.select([self._socket], [], [], max(timeout_s, 0.0))

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


class SerialLink:
    """A serial line, raw, eight bits, exclusive."""

    def __init__(self, device: str, baud: int) -> None:
        if baud not in _BAUDS:
            raise LinkError(f"link serial:{device}:{baud}: baud must be one of {', '.join(map(str, _BAUDS))}")
        self._pending = bytearray()
        self.dropped_writes = 0
        try:
            self._file = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise LinkError(f"link serial:{device}:{baud}: {error.strerror}") from None
        try:
            fcntl.ioctl(self._file, termios.TIOCEXCL)
            _make_raw(self._file, getattr(termios, f"B{baud}"))
        except (OSError, termios.error) as error:
            os.close(self._file)
            raise LinkError(f"link serial:{device}:{baud}: not a serial line ({error.args[-1]})") from None

    def read(self) -> bytes:
        """Bytes that arrived, at most 64 KiB. Raises OSError if the device is gone."""
        self._flush()
        try:
            return os.read(self._file, _READ_BUDGET)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send. A frame that does not fit behind what still waits is dropped whole and counted."""
        self._flush()
        if len(self._pending) > 4096:
            self.dropped_writes += 1
            return
        self._pending += data
        self._flush()

    def _flush(self) -> None:
        if not self._pending:
            return
        try:
            del self._pending[: os.write(self._file, self._pending)]
        except BlockingIOError:
            return

    def wait(self, timeout_s: float) -> None:
        """Block until bytes are there or the time is over."""
        select.select([self._file], [], [], max(timeout_s, 0.0))

    def close(self) -> None:
        """Release the device."""
        os.close(self._file)


def _make_raw(file: int, speed: int) -> None:
    """cfmakeraw(3) by hand: no echo, no line editing, no flow control, 8N1."""
    attributes = termios.tcgetattr(file)
    control = termios.CREAD | termios.CLOCAL | termios.CS8
    termios.tcsetattr(file, termios.TCSANOW, [0, 0, control, 0, speed, speed, attributes[6]])
    termios.tcflush(file, termios.TCIOFLUSH)
