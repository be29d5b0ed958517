from __future__ import annotations

import socket
import time
from collections.abc import Iterator

import pytest

from sitl.autopilots.byte_links import UdpPeer, pipe


def test_bytes_come_out_of_a_pipe_once_and_in_order() -> None:
    a, b = pipe()
    a.write(b"one")
    a.write(b"two")
    b.write(b"back")
    assert b.read() == b"onetwo"
    assert b.read() == b""
    assert a.read() == b"back"
    assert a.arrival_s is None
    a.wait(10.0)  # returns at once


def test_a_closed_pipe_end_raises_an_error() -> None:
    a, _ = pipe()
    a.close()
    with pytest.raises(OSError, match="closed"):
        a.read()
    with pytest.raises(OSError, match="closed"):
        a.write(b"x")


def test_a_pipe_without_a_reader_drops_the_oldest() -> None:
    a, b = pipe(depth=2)
    for data in (b"1", b"2", b"3"):
        a.write(data)
    assert b.read() == b"23"


@pytest.fixture
def companion() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        s.settimeout(5.0)
        yield s


def test_udp_sends_first_and_receives_with_the_kernels_arrival_time(companion: socket.socket) -> None:
    peer = UdpPeer(remote=companion.getsockname())
    try:
        assert peer.read() == b""
        peer.write(b"hello")
        data, sender = companion.recvfrom(100)
        assert data == b"hello"
        assert sender == ("127.0.0.1", peer.local_port)
        before = time.monotonic()
        companion.sendto(b"first", sender)
        companion.sendto(b"second", sender)
        after = time.monotonic()
        peer.wait(5.0)
        assert peer.read() == b"first"
        assert peer.arrival_s is not None
        assert before - 0.005 <= peer.arrival_s <= after + 0.005
        assert peer.read() == b"second"
    finally:
        peer.close()


def test_udp_ignores_other_senders(companion: socket.socket) -> None:
    peer = UdpPeer(remote=companion.getsockname())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(b"evil", ("127.0.0.1", peer.local_port))
    companion.sendto(b"good", ("127.0.0.1", peer.local_port))
    peer.wait(5.0)
    heard = peer.read() or peer.read()
    assert heard == b"good"
    peer.close()


def test_udp_survives_a_missing_remote() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = free.getsockname()
    peer = UdpPeer(remote=address)
    for _ in range(5):
        peer.write(b"anyone?")
        assert peer.read() == b""
    peer.close()


def test_udp_refuses_addresses_off_this_machine() -> None:
    with pytest.raises(ValueError, match="loopback"):
        UdpPeer(remote=("192.0.2.1", 14540))


def test_udp_raises_an_error_if_its_port_is_in_use(companion: socket.socket) -> None:
    with pytest.raises(OSError, match="in use"):
        UdpPeer(local_port=companion.getsockname()[1])


def test_a_peer_without_a_remote_adopts_the_first_sender(companion: socket.socket) -> None:
    peer = UdpPeer(remote=None)
    try:
        peer.write(b"to nobody")
        companion.sendto(b"here", ("127.0.0.1", peer.local_port))
        peer.wait(5.0)
        assert peer.read() == b"here"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(b"me too", ("127.0.0.1", peer.local_port))
            peer.wait(5.0)
            assert peer.read() == b""
        peer.write(b"hello")
        assert companion.recvfrom(100)[0] == b"hello"
    finally:
        peer.close()
