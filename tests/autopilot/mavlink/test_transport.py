"""Byte links on this machine's own loopback and pseudo terminals."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as wire

from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.mavlink.transport import PEER_SILENT_S, LinkError, SerialLink, UdpLink, open_link
from uav_recon.clock import ManualClock
from uav_recon.interfaces import ByteLink


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Peer:
    """Somebody on this machine, with an address of their own."""

    def __init__(self, port: int, system: int = 1, component: int = 1, host: str = "127.0.0.1") -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, 0))
        self._socket.settimeout(2.0)
        self._voice = wire.MAVLink(None, system, component)
        self._to = ("127.0.0.1", port)

    def send(self, data: bytes) -> None:
        self._socket.sendto(data, self._to)

    def greet(self, mavlink1: bool = False) -> bytes:
        told = wire.MAVLink_heartbeat_message(2, 12, 0x80, 6 << 16, 4, 3)
        frame = bytes(told.pack(self._voice, force_mavlink1=mavlink1))
        self.send(frame)
        return frame

    def heard(self) -> bytes:
        self._socket.setblocking(False)
        try:
            return self._socket.recv(100)
        except BlockingIOError:
            return b""

    def close(self) -> None:
        self._socket.close()


class Udp:
    """A link, its allow list, its clock, and its peers."""

    def __init__(self, peer_host: str | None = None) -> None:
        self.port = free_port()
        self.allow_list = AllowListFilter()
        self.clock = ManualClock()
        self.link = open_link(f"udp:127.0.0.1:{self.port}", self.allow_list, self.clock, peer_host)
        self._peers: list[Peer] = []

    def peer(self, system: int = 1, component: int = 1, host: str = "127.0.0.1") -> Peer:
        self._peers.append(Peer(self.port, system, component, host))
        return self._peers[-1]

    def close(self) -> None:
        for peer in self._peers:
            peer.close()
        self.link.close()


@pytest.fixture
def udp() -> Iterator[Udp]:
    rig = Udp()
    yield rig
    rig.close()


def test_udp_answers_the_first_who_is_the_vehicle(udp: Udp) -> None:
    link = udp.link
    vehicle, others = udp.peer(), [udp.peer(255, 190), udp.peer(2, 1), udp.peer(1, 77)]
    link.write(b"into the void")
    assert link.read() == b""
    for other in others:
        other.greet()
    udp.peer().greet(mavlink1=True)
    vehicle.send(b"what no decoder takes")
    link.wait(2.0)
    assert link.read() == b""
    link.write(b"still into the void")
    frame = vehicle.greet()
    link.wait(2.0)
    assert link.read() == frame
    link.write(b"to you")
    vehicle.send(b"anything from here")
    link.wait(2.0)
    assert link.read() == b"anything from here"
    assert vehicle.heard() == b"to you"
    assert [other.heard() for other in others] == [b""] * 3


def test_a_forger_cannot_take_the_stream(udp: Udp, caplog: pytest.LogCaptureFixture) -> None:
    """The vehicle's own ids, every hundredth of a second, from another port of this machine."""
    link, vehicle, forger = udp.link, udp.peer(), udp.peer()
    vehicle.greet()
    link.wait(2.0)
    assert link.read()
    for turn in range(1, 1000):
        udp.clock.advance_to(turn / 100)
        forger.greet()
        frame = vehicle.greet() if turn % 100 == 0 else b""
        link.wait(2.0)
        assert link.read() == frame
        link.write(b"x")
        assert (vehicle.heard(), forger.heard()) == (b"x", b"")
    assert udp.allow_list.refused == 999
    assert [record.getMessage().count("127.0.0.1:") for record in caplog.records] == [1], "named once"


def test_the_vehicle_may_come_back_at_another_port_once_it_was_silent(udp: Udp) -> None:
    link, vehicle, restarted = udp.link, udp.peer(), udp.peer()
    vehicle.greet()
    link.wait(2.0)
    assert link.read()
    for instant_s, heard in ((PEER_SILENT_S - 0.01, False), (PEER_SILENT_S + 0.01, True)):
        udp.clock.advance_to(instant_s)
        frame = restarted.greet()
        link.wait(2.0)
        assert link.read() == (frame if heard else b"")
    vehicle.greet()
    link.wait(2.0)
    assert link.read() == b""
    link.write(b"to the new one")
    assert (vehicle.heard(), restarted.heard()) == (b"", b"to the new one")


@pytest.mark.parametrize(("host", "heard"), [(None, True), ("127.0.0.2", True), ("127.0.0.3", False), ("10.41.1.2", False)])
def test_a_configured_host_alone_may_be_the_peer(host: str | None, heard: bool) -> None:
    rig = Udp(host)
    rig.peer(host="127.0.0.2").greet()
    rig.link.wait(2.0)
    assert bool(rig.link.read()) is heard
    assert rig.allow_list.refused == (not heard)
    rig.close()


def test_a_peer_that_ended_is_silence(udp: Udp) -> None:
    vehicle = udp.peer()
    vehicle.greet()
    udp.link.wait(2.0)
    assert udp.link.read()
    vehicle.close()
    udp.link.write(b"nobody is there any more")
    assert udp.link.read() == b""
    udp.link.wait(0.0)


def test_a_port_in_use_is_named(udp: Udp) -> None:
    with pytest.raises(LinkError, match=rf"udp:127\.0\.0\.1:{udp.port}: Address already in use"):
        open_link(f"udp:127.0.0.1:{udp.port}", udp.allow_list, udp.clock)


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
        open_link(url, AllowListFilter(), ManualClock())
    assert "\n" not in str(caught.value)


def test_serial_carries_every_byte_untouched() -> None:
    far, near = os.openpty()
    name = os.ttyname(near)
    link = open_link(f"serial:{name}:921600", AllowListFilter(), ManualClock())
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
        link.read()
    link.close()


def test_a_serial_line_that_went_is_opened_again_once_it_is_back(tmp_path: Path) -> None:
    clock, device = ManualClock(), tmp_path / "autopilot"

    def plug() -> tuple[int, int]:
        far, near = os.openpty()
        device.symlink_to(os.ttyname(near))
        return far, near

    def unplug(ends: tuple[int, int]) -> None:
        device.unlink()
        for end in ends:
            os.close(end)

    ends = plug()
    link = open_link(f"serial:{device}:921600", AllowListFilter(), clock)
    assert isinstance(link, SerialLink)
    while not link.dropped_writes:
        link.write(bytes(1000))
    unplug(ends)
    with pytest.raises(OSError):
        link.read()
    ends = plug()
    for _ in range(2):
        link.wait(0.0)  # there is nothing to wait for, and no busy loop either
        with pytest.raises(OSError, match="No such device"):
            link.read()
        with pytest.raises(OSError, match="No such device"):
            link.write(b"lost")
    clock.advance_to(clock.now_s() + 0.1)
    assert link.read() == b""
    link.write(b"hello")
    assert os.read(ends[0], 1000) == b"hello", "and nothing of what waited for the line that went"
    unplug(ends)
    with pytest.raises(OSError):
        link.write(b"x")
    clock.advance_to(clock.now_s() + 0.1)
    with pytest.raises(FileNotFoundError):
        link.read()
    with pytest.raises(OSError, match="No such device"):
        link.read()
    link.close()


def test_links_satisfy_the_protocol(udp: Udp) -> None:
    assert isinstance(udp.link, ByteLink)
    assert isinstance(udp.link, UdpLink)
