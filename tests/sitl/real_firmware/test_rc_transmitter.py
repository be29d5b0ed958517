"""RC transmitter, whose sticks counteract the motion, and relay to the firmware."""

from __future__ import annotations

import math
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest

from sitl.autopilots.base_autopilot import VehicleTruth
from sitl.autopilots.byte_links import UdpPeer
from sitl.faults.mavlink_proxy import DelayedItems, MavlinkProxy, Side
from sitl.geometry.quaternion import from_yaw
from sitl.real_firmware.rc_transmitter import RcTransmitter
from sitl.real_firmware.relay import Relay

LEFT = from_yaw(math.pi / 2.0)  # heading along the world's y axis


def truth(stamp_s: float, height_m: float = 1.0, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> VehicleTruth:
    return VehicleTruth(stamp_s, (0.0, 0.0, height_m), velocity, LEFT, (0.0,) * 3, (0.0,) * 3, 0.0, True, "GUIDED")


@pytest.fixture
def sticks() -> Iterator[tuple[RcTransmitter, Callable[[], tuple[int, ...]]]]:
    with closing(RcTransmitter({"LOITER": 1165})) as transmitter, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", transmitter.port))
        receiver.settimeout(2.0)
        yield transmitter, lambda: struct.unpack("<8H", receiver.recv(64))


def test_a_transmitter_sends_nothing_until_the_pilot_takes_over(
    sticks: tuple[RcTransmitter, Callable[[], tuple[int, ...]]],
) -> None:
    transmitter, heard = sticks
    transmitter.hold(truth(0.0))
    with pytest.raises(KeyError):
        transmitter.take("POSCTL", truth(0.0))
    transmitter.take("LOITER", truth(0.0))
    transmitter.hold(truth(1.0))
    transmitter.hold(truth(1.01))  # too early: no packet
    transmitter.hold(truth(1.03, height_m=0.9))
    assert heard() == (1500, 1500, 1500, 1500, 1165, 0, 0, 0)
    assert heard()[2] > 1500, "it sank"


@pytest.mark.parametrize(
    ("velocity", "moved"),
    [
        ((0.0, 0.5, 0.0), (0, 150, 0)),  # forwards: pitch up
        ((-0.5, 0.0, 0.0), (150, 0, 0)),  # to the left: roll right
        ((0.0, 0.0, 0.5), (0, 0, -100)),  # up: less throttle
        ((0.0, -9.0, 0.0), (0, -300, 0)),
    ],
)
def test_sticks_counteract_the_motion(
    sticks: tuple[RcTransmitter, Callable[[], tuple[int, ...]]],
    velocity: tuple[float, float, float],
    moved: tuple[int, int, int],
) -> None:
    transmitter, heard = sticks
    transmitter.take("LOITER", truth(0.0))
    transmitter.hold(truth(1.0, velocity=velocity))
    assert heard()[:4] == (*(1500 + m for m in moved), 1500)


def test_a_relay_forwards_the_frames_that_the_faults_leave() -> None:
    lost = [b""]

    def fate(frame: bytes) -> DelayedItems[bytes]:
        return [] if frame == lost[0] else [(0.0, frame)]

    product, firmware = UdpPeer(remote=None), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with closing(product), closing(firmware), closing(UdpPeer(remote=("127.0.0.1", product.local_port))) as end:
        proxy = MavlinkProxy(end, Side.AUTOPILOT, lambda: 0.0, fate, fate)
        with closing(Relay(proxy)) as relay:
            firmware.settimeout(2.0)
            firmware.connect(("127.0.0.1", relay.port))
            for word in (b"one", b"two"):
                lost[0] = b"one"
                firmware.send(word)
                relay.pass_on()
            product.wait(2.0)
            assert (product.read(), product.read()) == (b"two", b"")
            product.write(b"three")
            end.wait(2.0)
            relay.pass_on()
            assert firmware.recv(64) == b"three"
            assert [data for _, data in proxy.sent] == [b"three"]
            assert [data for _, data in proxy.heard] == [b"two"]
