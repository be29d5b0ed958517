"""Byte links to an autopilot: UDP and serial. Neither ever blocks the loop."""

from __future__ import annotations

import errno
import fcntl
import math
import os
import select
import socket
import termios
from typing import Any

from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.interfaces import ByteLink, Clock
from uav_recon.types.link_url import BAUDS, EVERYWHERE

PEER_SILENT_S = 3.0  #: reject: another address of the vehicle before this silence: by then the pilot has given up a flight
_READ_BUDGET = 1 << 16
_LOOK_AGAIN_S = 0.1  # opening costs microseconds, and without the line the vehicle is not controlled


class LinkError(Exception):
    """A link that cannot be opened; its text is one line that names the port."""


def open_link(url: str, allow_list: AllowListFilter, clock: Clock, peer_host: str | None = None) -> ByteLink:
    """Open ``udp:HOST:PORT`` (listens there) or ``serial:DEVICE:BAUD``.

    allow_list: its first valid heartbeat makes the sender the peer of a UDP link. peer_host: the only host that may become the
    peer; None is this machine. A serial line has only one other end. Raises LinkError with one line.
    """
    kind, _, rest = url.partition(":")
    place, _, number = rest.rpartition(":")
    if kind not in ("udp", "serial") or not place or not number.isdigit():
        raise LinkError(f"link {url!r}: write udp:HOST:PORT or serial:DEVICE:BAUD")
    if kind == "serial":
        return SerialLink(place, int(number), clock)
    return UdpLink(place, int(number), allow_list, clock, peer_host)


class UdpLink:
    """Listens on one address and exchanges data with one peer.

    The peer is the sender of the first datagram with a heartbeat that the allow list accepts as the vehicle's. Another sender
    becomes the peer only after the peer was silent for PEER_SILENT_S. Data of other senders is dropped and reported to the
    allow list. Before there is a peer, written data is discarded.
    """

    def __init__(self, host: str, port: int, allow_list: AllowListFilter, clock: Clock, peer_host: str | None = None) -> None:
        if host in (*EVERYWHERE, ""):
            raise LinkError(f"link udp:{host}:{port}: name one address; listening on every network would let anybody fly")
        if not 0 < port < 65536:
            raise LinkError(f"link udp:{host}:{port}: a port is 1 to 65535")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._allow_list = allow_list
        self._clock = clock
        self._peer_host = peer_host
        self._peer: Any = None
        self._spoke_s = -math.inf
        self.dropped_writes = 0
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise LinkError(f"link udp:{host}:{port}: {error.strerror or error}") from None

    def read(self) -> bytes:
        """Return the peer's datagrams; at most 64 KiB of received data are read per call.

        Raises OSError if the socket is closed.
        """
        parts, size = [], 0
        while size < _READ_BUDGET:
            try:
                data, sender = self._socket.recvfrom(2048)
            except (BlockingIOError, ConnectionRefusedError):  # a peer that ended is silence, not a broken link
                break
            size += len(data)
            if self._is_peer(sender, data):
                parts.append(data)
        return b"".join(parts)

    def _is_peer(self, sender: tuple[str, int], data: bytes) -> bool:
        now_s = self._clock.now_s()
        if sender != self._peer:
            taken = self._peer is not None and now_s - self._spoke_s <= PEER_SILENT_S
            if taken or not self._may_be_peer(sender[0]):
                self._allow_list.refuse(f"{sender[0]}:{sender[1]}")
                return False
            if not self._allow_list.has_heartbeat(data):  # the vehicle's other messages may come before its heartbeat
                return False
            self._peer = sender
        self._spoke_s = now_s
        return True

    def _may_be_peer(self, host: str) -> bool:
        return host.startswith("127.") if self._peer_host is None else host == self._peer_host

    def write(self, data: bytes) -> None:
        """Send to the peer; what the kernel cannot take at once is dropped and counted."""
        if self._peer is None:
            return
        try:
            self._socket.sendto(data, self._peer)
        except (BlockingIOError, ConnectionRefusedError):
            self.dropped_writes += 1

    def wait(self, timeout_s: float) -> None:
        """Block until a datagram is available or the timeout ends."""
        select.select([self._socket], [], [], max(timeout_s, 0.0))

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


class SerialLink:
    """A raw serial line, eight bits, exclusive.

    A line that disappears is checked ten times a second and opened when it is back.
    """

    def __init__(self, device: str, baud: int, clock: Clock) -> None:
        """Open the line. Raises LinkError if it does not exist or is no serial line."""
        if baud not in BAUDS:
            raise LinkError(f"link serial:{device}:{baud}: baud must be one of {', '.join(map(str, BAUDS))}")
        self._device = device
        self._speed = getattr(termios, f"B{baud}")
        self._clock = clock
        self._pending = bytearray()
        self._look_s = -math.inf
        self.dropped_writes = 0
        try:
            self._file: int | None = _opened(device, self._speed)
        except OSError as error:
            raise LinkError(f"link serial:{device}:{baud}: {error.strerror}") from None

    def read(self) -> bytes:
        """Return received bytes, at most 64 KiB. Raises OSError while the device is gone."""
        file = self._line()
        self._flush(file)
        try:
            data = os.read(file, _READ_BUDGET)
        except BlockingIOError:
            return b""
        except OSError:
            self._lose()
            raise
        if not data and _hung_up(file):
            self._lose()
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        return data

    def write(self, data: bytes) -> None:
        """Send the bytes.

        A frame that does not fit behind what still waits is dropped as a whole and counted. Raises OSError while the device is
        gone.
        """
        file = self._line()
        self._flush(file)
        if len(self._pending) > 4096:
            self.dropped_writes += 1
            return
        self._pending += data
        self._flush(file)

    def _line(self) -> int:
        """Return the open device; reopen it if it disappeared. Raises OSError."""
        if self._file is None:
            if self._clock.now_s() < self._look_s + _LOOK_AGAIN_S:
                raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
            self._look_s = self._clock.now_s()
            self._file = _opened(self._device, self._speed)
        return self._file

    def _lose(self) -> None:
        """Close the line and discard what waited for it."""
        self.close()
        self._pending.clear()
        self._look_s = self._clock.now_s()

    def _flush(self, file: int) -> None:
        if not self._pending:
            return
        try:
            del self._pending[: os.write(file, self._pending)]
        except BlockingIOError:
            return
        except OSError:
            self._lose()
            raise

    def wait(self, timeout_s: float) -> None:
        """Block until bytes are available or the timeout ends."""
        select.select([] if self._file is None else [self._file], [], [], max(timeout_s, 0.0))

    def close(self) -> None:
        """Release the device."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


def _opened(device: str, speed: int) -> int:
    """Return the file descriptor of a raw line, opened exclusively. Raises OSError."""
    file = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.ioctl(file, termios.TIOCEXCL)
        _make_raw(file, speed)
    except (OSError, termios.error) as error:
        os.close(file)
        raise OSError(error.args[0], f"not a serial line ({error.args[-1]})") from None
    return file


def _hung_up(file: int) -> bool:
    """Return True if the device is gone for ever."""
    poll = select.poll()
    poll.register(file, 0)  # a hang-up is reported in any case
    return bool(poll.poll(0))


def _make_raw(file: int, speed: int) -> None:
    """Set the line like cfmakeraw(3): no echo, no line editing, no flow control, 8N1."""
    attributes = termios.tcgetattr(file)
    control = termios.CREAD | termios.CLOCAL | termios.CS8
    termios.tcsetattr(file, termios.TCSANOW, [0, 0, control, 0, speed, speed, attributes[6]])
    termios.tcflush(file, termios.TCIOFLUSH)
