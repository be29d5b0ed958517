"""Framing against pymavlink's own encoder and decoder."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uav_recon.autopilot.mavlink.framing import MessageLayout, frame_length, framed, is_intact, kind_of, sender_of, wire

KINDS = (
    wire.MAVLink_heartbeat_message,
    wire.MAVLink_sys_status_message,
    wire.MAVLink_odometry_message,
    wire.MAVLink_gimbal_device_attitude_status_message,
    wire.MAVLink_autopilot_version_message,
    wire.MAVLink_battery_status_message,
)


def payload_of(kind: Any, seed: int) -> bytes:
    """Random bytes; some end in zeros, which are not sent."""
    rng = np.random.default_rng(seed)
    raw = rng.integers(0, 120, kind.unpacker.size, dtype=np.uint8)  # 120: no float of these bytes is NaN
    raw[raw.size - seed % 4 :] = 0
    return bytes(raw)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.msgname)
@pytest.mark.parametrize("seed", range(6))
def test_a_frame_reads_as_pymavlink_reads_it(kind: Any, seed: int) -> None:
    frame = framed(kind, payload_of(kind, seed), 200 + seed, 7, 191)
    assert frame_length(frame, 0) == len(frame)
    assert (kind_of(frame), sender_of(frame)) == (kind.id, (7, 191))
    assert is_intact(frame, kind)
    message = wire.MAVLink(None).decode(bytearray(frame))
    assert (message.get_seq(), message.get_srcSystem(), message.get_srcComponent()) == (200 + seed, 7, 191)
    values = MessageLayout(kind, *kind.fieldnames).read(frame)
    for name, value in zip(kind.fieldnames, values, strict=True):
        expected = getattr(message, name)
        assert list(value) == list(expected) if isinstance(value, tuple) else value == expected, name


@pytest.mark.parametrize("seed", range(4))
def test_a_frame_is_pymavlinks_to_the_byte(seed: int) -> None:
    numbers = np.random.default_rng(seed).uniform(-3, 3, 3).tolist() + [0.0] * (seed % 3 * 4)
    numbers += [0.0] * (11 - len(numbers))
    kind = wire.MAVLink_set_position_target_local_ned_message
    source = wire.MAVLink(None, srcSystem=233, srcComponent=191)
    message = kind(5, 1, 1, 1, 0, *numbers)
    expected = bytes(message.pack(source))
    assert framed(kind, kind.unpacker.pack(5, *numbers, 0, 1, 1, 1), 0, 233, 191) == expected


def test_a_payload_of_zeros_keeps_one_byte() -> None:
    kind = wire.MAVLink_timesync_message
    expected = bytes(kind(0, 0).pack(wire.MAVLink(None, srcSystem=1, srcComponent=1)))
    assert framed(kind, bytes(16), 0, 1, 1) == expected
    assert MessageLayout(kind, "tc1", "ts1").read(expected) == [0, 0]


@pytest.mark.parametrize("place", [1, 4, 9, 12, -1])
def test_a_changed_byte_is_noticed(place: int) -> None:
    kind = wire.MAVLink_heartbeat_message
    frame = bytearray(framed(kind, kind.unpacker.pack(7, 2, 12, 128, 4, 3), 0, 1, 1))
    frame[place] ^= 0x10
    assert not is_intact(bytes(frame), kind)
