"""Frames of the simulated autopilot, against pymavlink's encoder and decoder."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.mavlink_codec import MessageDecoder, MessageEncoder, packet

NAN21 = [math.nan] * 21
SAID: tuple[tuple[Any, tuple[Any, ...]], ...] = (
    (mavlink.MAVLink_heartbeat_message, (2, 12, 128, 5, 4, 3)),
    (mavlink.MAVLink_attitude_message, (1, 0.1, 0.2, -0.3, 0.4, 0.5, 0.0)),
    (mavlink.MAVLink_battery_status_message, (0, 0, 0, 32767, [4000] * 10, 900, 50, -1, 80)),
    (mavlink.MAVLink_odometry_message, (9, 1, 12, 1, 2, 3, (1, 0, 0, 0), 4, 5, 6, 7, 8, 9, NAN21, NAN21, 3, 4, 100)),
    (mavlink.MAVLink_statustext_message, (3, b"low battery", 0, 0)),
    (mavlink.MAVLink_timesync_message, (0, 0)),
)


@pytest.mark.parametrize(("kind", "fields"), SAID, ids=[kind.msgname for kind, _ in SAID])
def test_a_frame_is_byte_identical_to_pymavlinks(kind: Any, fields: tuple[Any, ...]) -> None:
    assert MessageEncoder(1, 1).frame(packet(kind, *fields)) == bytes(kind(*fields).pack(mavlink.MAVLink(None, 1, 1)))


def test_frames_have_consecutive_sequence_numbers() -> None:
    speaker, beat = MessageEncoder(1, 1), packet(mavlink.MAVLink_heartbeat_message, 2, 12, 128, 5, 4, 3)
    assert [speaker.frame(beat)[4] for _ in range(258)][-4:] == [254, 255, 0, 1]


def test_pymavlinks_frames_are_decoded_in_any_pieces_and_through_noise() -> None:
    source = mavlink.MAVLink(None, 233, 191)
    frames = [bytes(kind(*fields).pack(source)) for kind, fields in SAID]
    spoilt = bytearray(frames[0])
    spoilt[12] ^= 1
    stream = b"\xfd\x01noise" + b"".join(frames) + bytes(spoilt) + b"".join(frames)
    for size in (1, 7, 50, 1000):
        listener = MessageDecoder()
        heard = [m for at in range(0, len(stream), size) for m in listener.feed(stream[at : at + size])]
        assert [m.kind for m in heard] == [kind.id for kind, _ in SAID] * 2
        assert {m.sender for m in heard} == {(233, 191)}
        assert (heard[0].custom_mode, heard[0].autopilot) == (5, 12)
        assert (heard[3].q, heard[3].time_usec, heard[3].quality) == ((1, 0, 0, 0), 9, 100)
        assert heard[4].text == "low battery"
