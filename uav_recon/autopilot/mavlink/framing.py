"""MAVLink framing: frames and their checksums, and named fields read directly from payloads.

The dialect (field order, sizes, checksum seeds) is pymavlink's; its message objects cost ten times as much as the fields
that are read.
"""

from __future__ import annotations

import os
import struct
from typing import Any

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import ardupilotmega as wire  # the common messages, and EKF_STATUS_REPORT

__all__ = [
    "MAGIC_1", "MAGIC_2", "MessageLayout", "frame_length", "framed", "is_intact", "is_signed", "kind_of", "marked_signed",
    "payload_of", "sender_of", "wire",
]  # fmt: skip

MAGIC_1 = 0xFE
MAGIC_2 = 0xFD
_HEADER_1 = 6
_HEADER_2 = 10
_CHECKSUM = 2
_SIGNATURE = 13
_HEAD = struct.Struct("<BBBBBBBHB")  # magic, length, two flags, sequence, system, component, kind (24 bits)
_CHECK = struct.Struct("<H")


def frame_length(buffer: bytes, at: int) -> int:
    """Return the length of the frame that starts here, 0 if none can, -1 if its end is missing.

    It does not wait for what no known message can become: after garbage, the next valid frame must not wait for a false one.
    """
    magic, left = buffer[at], len(buffer) - at
    if magic not in (MAGIC_1, MAGIC_2):
        return 0
    if left < 3:
        return -1
    if magic == MAGIC_1:
        length = _HEADER_1 + buffer[at + 1] + _CHECKSUM
    elif buffer[at + 2] > 1:  # undefined incompatibility flags
        return 0
    else:
        length = _HEADER_2 + buffer[at + 1] + _CHECKSUM + (_SIGNATURE if buffer[at + 2] else 0)
    if left >= length:
        return length
    whole_header = left >= (_HEADER_1 if magic == MAGIC_1 else _HEADER_2)
    kind = wire.mavlink_map.get(kind_of(buffer[at : at + _HEADER_2])) if whole_header else None
    return 0 if whole_header and (kind is None or buffer[at + 1] > kind.unpacker.size) else -1


def kind_of(frame: bytes) -> int:
    """Return the message id of a whole frame."""
    return frame[5] if frame[0] == MAGIC_1 else frame[7] | frame[8] << 8 | frame[9] << 16


def payload_of(frame: bytes) -> bytes:
    """Return the payload of a whole MAVLink 2 frame."""
    return frame[_HEADER_2 : _HEADER_2 + frame[1]]


def sender_of(frame: bytes) -> tuple[int, int]:
    """Return system and component of a whole MAVLink 2 frame."""
    return frame[5], frame[6]


def is_signed(frame: bytes) -> bool:
    """Return True if a whole MAVLink 2 frame ends with a signature."""
    return bool(frame[2])


def marked_signed(frame: bytes) -> bytes:
    """Return an unsigned frame of a known kind prepared for its signature.

    The signed flag is set, and the checksum covers it.
    """
    body = frame[1:2] + b"\1" + frame[3:-_CHECKSUM]
    seed: int = wire.mavlink_map[kind_of(frame)].crc_extra
    return frame[:1] + body + _CHECK.pack(wire.x25crc(body + bytes((seed,))).crc)


def is_intact(frame: bytes, kind: Any) -> bool:
    """Return True if the checksum of a whole frame of this pymavlink message class is correct."""
    end = len(frame) - _CHECKSUM - (_SIGNATURE if frame[0] == MAGIC_2 and frame[2] else 0)
    return bool(wire.x25crc(frame[1:end] + bytes((kind.crc_extra,))).crc == _CHECK.unpack_from(frame, end)[0])


class MessageLayout:
    """Positions of some named fields of a pymavlink message class."""

    def __init__(self, kind: Any, *names: str) -> None:
        self._unpacker = kind.unpacker
        places, at = {}, 0
        for name, length in zip(kind.ordered_fieldnames, kind.lengths, strict=True):
            places[name] = at if length == 1 else slice(at, at + length)
            at += length
        self._places = [places[name] for name in names]

    def read(self, frame: bytes) -> list[Any]:
        """Return the fields of a whole MAVLink 2 frame, arrays as tuples, text as bytes."""
        payload = frame[_HEADER_2 : _HEADER_2 + min(frame[1], self._unpacker.size)]
        values = self._unpacker.unpack(payload.ljust(self._unpacker.size, b"\0"))  # zeros at the end are not sent
        return [values[place] for place in self._places]


def framed(kind: Any, payload: bytes, sequence: int, system: int, component: int) -> bytes:
    """Return an unsigned MAVLink 2 frame.

    Zeros at the payload's end are omitted, except for its first byte.
    """
    payload = payload[:1] + payload[1:].rstrip(b"\0")
    low, high = kind.id & 0xFFFF, kind.id >> 16
    body = _HEAD.pack(MAGIC_2, len(payload), 0, 0, sequence, system, component, low, high) + payload
    return body + _CHECK.pack(wire.x25crc(body[1:] + bytes((kind.crc_extra,))).crc)
