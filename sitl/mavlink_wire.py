"""MAVLink 2 frames of the outside world, from fields to bytes and back; the dialect's tables are pymavlink's.

Written apart from the product's framing on purpose, and without pymavlink's message objects: they took longer than the
rest of the simulated autopilot.
"""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

_START, _HEADER_BYTES, _CHECK_BYTES, _SIGNATURE_BYTES = 0xFD, 10, 2, 13
_HEADER = struct.Struct("<BBBBBBB3s")
_CHECK = struct.Struct("<H")


class Packet(NamedTuple):
    """A message to be sent: pymavlink's class of its kind and its fields as that class names them; last ones may lack."""

    kind: Any
    fields: tuple[Any, ...]


class Heard(SimpleNamespace):
    """A message that came: its fields by name, kind its message id, sender the system and component it came from."""

    kind: int
    sender: tuple[int, int]


def packet(kind: Any, *fields: Any) -> Packet:
    """A packet of these fields."""
    return Packet(kind, fields)


class Speaker:
    """Gives packets a frame, the sender's ids and a number each."""

    def __init__(self, system: int, component: int) -> None:
        self._system, self._component, self._number = system, component, 0

    def frame(self, message: Packet) -> bytes:
        """The bytes of one packet. Raises struct.error for a field that does not fit its kind."""
        kind, fields = message
        if len(fields) < len(kind.fieldnames):  # extensions that nobody filled
            fields = (*fields, *([0] * (len(kind.fieldnames) - len(fields))))
        values: list[Any] = []
        for place, count in zip(_wire_order(kind), kind.lengths, strict=True):
            if count == 1:
                values.append(fields[place])
            else:
                values.extend(fields[place] or (0,) * count)
        payload = kind.unpacker.pack(*values).rstrip(b"\0") or b"\0"
        head = _HEADER.pack(
            _START, len(payload), 0, 0, self._number, self._system, self._component, kind.id.to_bytes(3, "little")
        )
        self._number = (self._number + 1) % 256
        return head + payload + _CHECK.pack(_checksum(head[1:] + payload, kind))


class Listener:
    """Finds intact frames in what comes; everything else is skipped."""

    def __init__(self) -> None:
        self._waiting = b""

    def feed(self, data: bytes) -> list[Heard]:
        """Messages of all frames that are complete now, oldest first."""
        self._waiting += data
        heard, at, end = [], 0, len(self._waiting)
        while (at := self._waiting.find(_START, at)) >= 0 and end - at >= _HEADER_BYTES:
            _, length, flags, _, _, system, component, number = _HEADER.unpack_from(self._waiting, at)
            check = at + _HEADER_BYTES + length
            following = check + _CHECK_BYTES + (_SIGNATURE_BYTES if flags & 1 else 0)
            if following > end:
                break
            kind = mavlink.mavlink_map.get(int.from_bytes(number, "little"))
            body = self._waiting[at + 1 : check]
            if kind is None or _checksum(body, kind) != _CHECK.unpack_from(self._waiting, check)[0]:
                at += 1
                continue
            heard.append(Heard(kind=kind.id, sender=(system, component), **_fields(kind, body[_HEADER_BYTES - 1 :])))
            at = following
        self._waiting = self._waiting[at:] if at >= 0 else b""
        return heard


def _checksum(body: bytes, kind: Any) -> int:
    return int(mavlink.x25crc(body + bytes((kind.crc_extra,))).crc)


def _fields(kind: Any, payload: bytes) -> dict[str, Any]:
    size = kind.unpacker.size
    values, at, fields = kind.unpacker.unpack(payload[:size].ljust(size, b"\0")), 0, {}
    for name, count in zip(kind.ordered_fieldnames, kind.lengths, strict=True):
        value = values[at] if count == 1 else values[at : at + count]
        fields[name] = value.split(b"\0")[0].decode("ascii", "replace") if isinstance(value, bytes) else value
        at += count
    return fields


_ORDERS: dict[int, list[int]] = {}


def _wire_order(kind: Any) -> list[int]:
    """For each field on the wire its place among the fields as they are named."""
    order = _ORDERS.get(kind.id)
    if order is None:
        order = _ORDERS[kind.id] = [kind.fieldnames.index(name) for name in kind.ordered_fieldnames]
    return order
