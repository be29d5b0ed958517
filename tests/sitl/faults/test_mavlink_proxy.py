"""The proxy on the byte pipe: whole frames, each fault on its way, and a capture of what was really said."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.byte_links import PipeEnd, UdpPeer, pipe
from sitl.faults.injectors.base import Injector
from sitl.faults.injectors.mavlink_link import (
    Corrupted,
    DuplicatedFrames,
    FalseBatteryCharge,
    Jitter,
    PacketLoss,
    RewrittenFrames,
    version,
)
from sitl.faults.mavlink_proxy import DelayedItems, MavlinkProxy, Side, frames, message_id
from sitl.faults.wire_capture import decode, heartbeats_in, setpoints_in

VOICE = mavlink.MAVLink(None, 233, 191)


def setpoint(x: float, y: float = 0.0, z: float = -1.0) -> bytes:
    message = mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0, x, y, z, 0.1, 0.2, -0.3, 0.0, 0.0, 0.0, 0.0, 0.0
    )
    return bytes(message.pack(VOICE))


def heartbeat(mode: int) -> bytes:
    return bytes(mavlink.MAVLink_heartbeat_message(2, 12, 129, mode, 4, 3).pack(mavlink.MAVLink(None, 1, 1)))


def proxied(injector: Injector) -> tuple[MavlinkProxy, list[float], PipeEnd]:
    ours, theirs = pipe()
    clock = [0.0]

    def up(frame: bytes) -> DelayedItems[bytes]:
        return injector.to_autopilot(clock[0], frame)

    def down(frame: bytes) -> DelayedItems[bytes]:
        return injector.to_product(clock[0], frame)

    return MavlinkProxy(ours, Side.PRODUCT, lambda: clock[0], up, down), clock, theirs


def test_frames_are_cut_where_they_end() -> None:
    pieces = [setpoint(1.0), heartbeat(7), setpoint(2.0)]
    assert frames(b"".join(pieces)) == pieces
    assert [message_id(p) for p in pieces] == [84, 0, 84]
    assert frames(b"garbage") == [b"garbage"]
    assert message_id(b"garbage") == -1


def test_a_clean_proxy_changes_nothing() -> None:
    proxy, clock, theirs = proxied(Injector())
    proxy.write(setpoint(1.0))
    assert message_id(theirs.read()) == 84
    theirs.write(heartbeat(1) + heartbeat(2))
    clock[0] = 0.1
    assert len(frames(proxy.read())) == 2
    assert [mode for _, mode, _ in heartbeats_in(proxy.heard)] == [1, 2]


def test_what_is_lost_was_said_all_the_same() -> None:
    proxy, _, theirs = proxied(PacketLoss("up"))
    proxy.write(setpoint(1.0))
    assert theirs.read() == b""
    assert len(decode(proxy.sent).setpoint_s) == 1


def test_a_late_frame_waits_for_its_time() -> None:
    proxy, clock, theirs = proxied(Jitter(0.3, seed=1))
    for _ in range(20):
        proxy.write(setpoint(1.0))
    early = len(frames(theirs.read()))
    clock[0] = 0.31
    proxy.forward()
    assert early < 20
    assert early + len(frames(theirs.read())) == 20


def test_repeats_and_errors() -> None:
    proxy, clock, theirs = proxied(DuplicatedFrames(0.5))
    proxy.write(setpoint(1.0))
    clock[0] = 1.0
    proxy.forward()
    assert len(frames(theirs.read())) == 3
    proxy, _, theirs = proxied(Corrupted(1.0))
    proxy.write(setpoint(1.0))
    assert theirs.read() != setpoint(1.0)


def test_a_gauge_slips_in_its_spells_alone_and_every_frame_keeps_its_number() -> None:
    proxy, clock, theirs = proxied(FalseBatteryCharge((1.0, 2.0, 0.2), (3.0, 9.0, math.nan)))
    voice, told = mavlink.MAVLink(None, 1, 1), []
    for k in range(5):
        voice.seq, clock[0] = 40 + k, float(k)
        theirs.write(bytes(mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 15000, 0, 71, 0, 0, 0, 0, 0, 0).pack(voice)))
        heard = mavlink.MAVLink(None).decode(bytearray(proxy.read()))
        told.append((heard.battery_remaining, heard.voltage_battery, heard.get_seq()))
    assert told == [(71, 15000, 40), (20, 15000, 41), (71, 15000, 42), (-1, 15000, 43), (-1, 15000, 44)]


def test_another_firmware_is_told() -> None:
    told = mavlink.MAVLink_autopilot_version_message(0, 17 << 16, 0, 0, 0, b"\0" * 8, b"\0" * 8, b"\0" * 8, 0, 0, 0)
    frame = bytes(told.pack(mavlink.MAVLink(None, 1, 1)))
    late = RewrittenFrames(148, version(1, 13, 0)).to_product(0.0, frame)
    changed = mavlink.MAVLink(None).decode(bytearray(late[0][1]))
    assert changed.flight_sw_version >> 16 == 1 << 8 | 13
    assert RewrittenFrames(0, version(1, 13, 0)).to_product(0.0, frame) == [(0.0, frame)]


def test_heartbeats_are_heard_among_anything_else() -> None:
    torn, garbage = heartbeat(3), bytes([0xFD, 0x0B]) + b"no frame" * 9
    heard = [heartbeat(1), setpoint(1.0), setpoint(2.0) + heartbeat(2), torn[:7], torn[7:] + setpoint(3.0)]
    heard += [setpoint(4.0)[:20], setpoint(5.0) * 9, heartbeat(6), garbage, setpoint(7.0) * 9, heartbeat(8)]
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    plain = [m.custom_mode for data in heard for m in parser.parse_buffer(data) or () if m.get_type() == "HEARTBEAT"]
    assert plain[:3] == [1, 2, 3]
    assert [mode for _, mode, _ in heartbeats_in(list(enumerate(heard)))] == plain


def test_the_capture_is_in_the_worlds_axes() -> None:
    wire = decode([(3.0, setpoint(1.0, 2.0, -1.5)), (4.0, setpoint(math.nan))])
    np.testing.assert_allclose(wire.position_m[0], [2.0, 1.0, 1.5])
    np.testing.assert_allclose(wire.velocity_mps[0], [0.2, 0.1, 0.3], atol=1e-6)
    assert wire.not_finite == 1
    order = bytes(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1.0, 21196.0, 0, 0, 0, 0, 0).pack(VOICE))
    assert decode([(1.0, order)]).orders[0].second == 21196.0


@pytest.mark.parametrize(("mask", "yaw_rad"), [(0, 0.3), (2048, 0.3), (1024, math.nan)])
def test_the_heading_of_setpoints_is_in_the_worlds_axes_where_they_say_one(mask: int, yaw_rad: float) -> None:
    from_north = math.pi / 2.0 - 0.3
    message = mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, mask, *[0.0] * 9, from_north, 0.0)
    wire = decode([(3.0, bytes(message.pack(VOICE)))])
    assert wire.yaw_rad == pytest.approx([yaw_rad], abs=1e-6, nan_ok=True)


@pytest.mark.parametrize("from_north_deg", [0.0, 30.0, 90.0, 179.0, -91.0])
def test_the_heading_of_odometry_is_in_the_worlds_axes(from_north_deg: float) -> None:
    half = math.radians(from_north_deg) / 2.0
    quat = [math.cos(half), 0.0, 0.0, math.sin(half)]
    pose = mavlink.MAVLink_odometry_message(0, 20, 12, 1.0, 2.0, -3.0, quat, *[0.0] * 6, [0.0] * 21, [0.0] * 21)
    wire = decode([(3.0, bytes(pose.pack(VOICE)))])
    expected = math.remainder(math.radians(90.0 - from_north_deg), math.tau)
    assert wire.odometry_yaw_rad == pytest.approx([expected], abs=1e-6)
    np.testing.assert_allclose(wire.odometry_m[0], [2.0, 1.0, 3.0])


def test_the_far_proxy_keeps_what_arrives_and_spoils_what_leaves() -> None:
    injector, clock = Jitter(0.3, seed=1), [0.0]
    end = UdpPeer(remote=None)
    product = UdpPeer(remote=("127.0.0.1", end.local_port))
    proxy = MavlinkProxy(
        end, Side.AUTOPILOT, lambda: clock[0],
        lambda f: injector.to_autopilot(0.0, f), lambda f: injector.to_product(0.0, f),
    )  # fmt: skip
    try:
        product.write(setpoint(1.0) + heartbeat(3))
        end.wait(5.0)
        assert proxy.read() == b"", "late"
        assert len(decode(proxy.sent).setpoint_s) == 1
        assert proxy.arrival_s is not None
        clock[0] = 0.31
        assert len(frames(proxy.read())) == 2
        proxy.write(heartbeat(5))
        assert not proxy.heard
        clock[0] = 0.62
        proxy.forward()
        assert [mode for _, mode, _ in heartbeats_in(proxy.heard)] == [5]
        product.wait(5.0)
        assert product.read() == heartbeat(5)
        proxy.inject_to_product(b"garbage")
        product.wait(5.0)
        assert product.read() == b"garbage"
    finally:
        end.close()
        product.close()


def test_a_link_that_was_late_for_a_while_is_in_time_again() -> None:
    injector = Jitter(0.3, for_s=60.0, seed=1)
    late = [late_s for k in range(50) for late_s, _ in injector.to_autopilot(59.0 + 0.01 * k, heartbeat(1))]
    assert 0.2 < max(late) <= 0.3
    assert [late_s for k in range(50) for late_s, _ in injector.to_product(60.0 + k, heartbeat(1))] == [0.0] * 50


def test_setpoints_are_counted_where_they_arrive_and_sound() -> None:
    proxy, clock, _ = proxied(Jitter(0.3, seed=1))
    proxy.write(heartbeat(1) + setpoint(1.0))
    assert len(decode(proxy.sent).setpoint_s) == 1
    assert setpoints_in(proxy.arrived).tolist() == []
    clock[0] = 0.31
    proxy.forward()
    assert setpoints_in(proxy.arrived).tolist() == [0.31]
    spoilt = bytearray(setpoint(2.0))
    spoilt[20] ^= 1
    assert setpoints_in([(1.0, bytes(spoilt)), (2.0, setpoint(3.0))]).tolist() == [2.0]


def test_what_others_send_reaches_the_autopilot_and_is_not_the_products() -> None:
    proxy, _, theirs = proxied(Injector())
    proxy.inject_to_autopilot(heartbeat(1))
    assert message_id(theirs.read()) == 0
    assert (proxy.sent, proxy.arrived) == ([], [])
    ours, product = pipe()
    there = MavlinkProxy(ours, Side.AUTOPILOT, lambda: 0.0, lambda frame: [(0.0, frame)], lambda frame: [(0.0, frame)])
    there.inject_to_autopilot(heartbeat(1))
    assert message_id(there.read()) == 0
    assert (there.read(), there.sent, there.arrived, product.read()) == (b"", [], [], b"")


def test_a_routers_heartbeats_are_not_those_of_the_vehicle() -> None:
    router = bytes(mavlink.MAVLink_heartbeat_message(6, 8, 0, 7, 4, 3).pack(mavlink.MAVLink(None, 1, 1)))
    assert [mode for _, mode, _ in heartbeats_in([(0.0, heartbeat(1) + router)])] == [1]
