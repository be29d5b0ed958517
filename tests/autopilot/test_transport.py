"""Byte links on this machine's own loopback and pseudo terminals."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator

import pytest

from uav_recon.autopilot.transport import LinkError, SerialLink, UdpLink, open_link
from uav_recon.protocols import ByteLink


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def udp() -> Iterator[tuple[ByteLink, int]]:
    port = free_port()
    link = open_link(f"udp:127.0.0.1:{port}")
    yield link, port
    link.close()


def test_udp_answers_whoever_spoke_last(udp: tuple[ByteLink, int]) -> None:
    link, port = udp
    link.write(b"into the void")
    assert link.read() == b""
    for text in (b"one", b"two"):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
            peer.settimeout(2.0)
            peer.sendto(text, ("127.0.0.1", port))
            link.wait(2.0)
            assert link.read() == text
            link.write(b"to " + text)
            assert peer.recv(100) == b"to " + text
    link.write(b"nobody is there any more")
    assert link.read() == b""
    link.wait(0.0)


def test_a_port_in_use_is_named(udp: tuple[ByteLink, int]) -> None:
    with pytest.raises(LinkError, match=rf"udp:127\.0\.0\.1:{udp[1]}: Address already in use"):
        open_link(f"udp:127.0.0.1:{udp[1]}")


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("tcp:127.0.0.1:1", "write udp:HOST:PORT"),
        ("udp:14540", "write udp:HOST:PORT"),
        ("udp:127.0.0.1:x", "write udp:HOST:PORT"),
        ("udp:0.0.0.0:14540", "let anybody fly"),
        ("udp:127.0.0.1:70000", "1 to 65535"),
        ("serial:/dev/not-there:921600", "No such file"),
        ("serial:/dev/null:921600", "not a serial line"),
        ("serial:/dev/null:12345", "baud must be one of"),
    ],
)
def test_what_cannot_be_opened_is_one_line(url: str, says: str) -> None:
    with pytest.raises(LinkError, match=says) as caught:
        open_link(url)
    assert "\n" not in str(caught.value)


def test_serial_carries_every_byte_untouched() -> None:
    far, near = os.openpty()
    name = os.ttyname(near)
    link = open_link(f"serial:{name}:921600")
    os.close(near)
    assert isinstance(link, SerialLink)
    every = bytes(range(256))
    assert link.read() == b""
    os.write(far, every)
    link.wait(2.0)
    assert link.read() == every
    link.write(every)
    assert os.read(far, 1000) == every
    for _ in range(200):
        link.write(every)
    assert link.dropped_writes > 0, "nobody reads: frames are dropped, the loop goes on"
    os.close(far)
    with pytest.raises(OSError):
        for _ in range(3):
            link.write(b"x")
            if link.read() == b"":
                raise OSError("end of file")
    link.close()


def test_links_satisfy_the_protocol(udp: tuple[ByteLink, int]) -> None:
    assert isinstance(udp[0], ByteLink)
    assert isinstance(udp[0], UdpLink)
