"""MAVLink 2 encoder and decoder of the simulator, using pymavlink's tables of the dialect.

Not shared with the product's framing on purpose. pymavlink's message objects are not used because they took more time than
the rest of the simulated autopilot.
"""

from __future__ import annotations

import functools
import itertools
import struct
from types import SimpleNamespace
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

_START = 0xFD
_HEADER_BYTES = 10
_CHECK_BYTES = 2
_SIGNATURE_BYTES = 13
_HEADER = struct.Struct("<BBBBBBB3s")
_CHECK = struct.Struct("<H")


class Packet(NamedTuple):
    """A message to send: pymavlink's class and its fields in the order of that class.

    Trailing extension fields may be missing.
    """

    kind: Any
    fields: tuple[Any, ...]


Built = Packet | list[Packet] | None  # what a builder returns: a message, several of one id, or none yet


class ReceivedMessage(SimpleNamespace):
    """A received message: fields by name; kind: message id; sender: system and component id."""

    kind: int
    sender: tuple[int, int]


def packet(kind: Any, *fields: Any) -> Packet:
    """Return a packet of these fields."""
    return Packet(kind, fields)


class MessageEncoder:
    """Encoder of packets with the sender's ids and a sequence number."""

    def __init__(self, system: int, component: int) -> None:
        self._system = system
        self._component = component
        self._number = 0

    def frame(self, message: Packet) -> bytes:
        """Return the bytes of one packet. Raises struct.error for a field of wrong type or range."""
        kind, fields = message
        form = _form(kind)
        if len(fields) < len(form.order):  # missing extension fields are 0
            fields = (*fields, *([0] * (len(form.order) - len(fields))))
        values = [fields[place] for place in form.order]
        for place, count in form.arrays:  # last one first, so that the indices of those before it remain valid
            values[place : place + 1] = values[place] or (0,) * count
        payload = kind.unpacker.pack(*values).rstrip(b"\0") or b"\0"
        head = _HEADER.pack(_START, len(payload), 0, 0, self._number, self._system, self._component, form.number)
        self._number = (self._number + 1) % 256
        return head + payload + _CHECK.pack(_checksum(head[1:] + payload, form))


class MessageDecoder:
    """Decoder of intact frames in a byte stream; all other bytes are skipped."""

    def __init__(self) -> None:
        self._waiting = b""

    def feed(self, data: bytes) -> list[ReceivedMessage]:
        """Add bytes; return the messages of all frames that are now complete, oldest first."""
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
            if kind is None or _checksum(body, _form(kind)) != _CHECK.unpack_from(self._waiting, check)[0]:
                at += 1
                continue
            heard.append(ReceivedMessage(kind=kind.id, sender=(system, component), **_fields(kind, body[_HEADER_BYTES - 1 :])))
            at = following
        self._waiting = self._waiting[at:] if at >= 0 else b""
        return heard


class _Form(NamedTuple):
    """Wire layout of a message.

    number: message id in 3 bytes. seed: CRC_EXTRA. order: for each field on the wire its index in the order of the class.
    arrays: index and length of array fields, last first. values: field name and its index or slice in the unpacked values.
    """

    number: bytes
    seed: bytes
    order: tuple[int, ...]
    arrays: tuple[tuple[int, int], ...]
    values: tuple[tuple[str, int | slice], ...]


@functools.cache
def _form(kind: Any) -> _Form:
    order = tuple(kind.fieldnames.index(name) for name in kind.ordered_fieldnames)
    arrays = tuple((place, count) for place, count in enumerate(kind.lengths) if count > 1)
    starts = itertools.accumulate(kind.lengths, initial=0)
    places = (at if count == 1 else slice(at, at + count) for at, count in zip(starts, kind.lengths, strict=False))
    values = tuple(zip(kind.ordered_fieldnames, places, strict=True))
    return _Form(kind.id.to_bytes(3, "little"), bytes((kind.crc_extra,)), order, arrays[::-1], values)


def _checksum(body: bytes, form: _Form) -> int:
    return int(mavlink.x25crc(body + form.seed).crc)


def _fields(kind: Any, payload: bytes) -> dict[str, Any]:
    size = kind.unpacker.size
    values = kind.unpacker.unpack(payload[:size].ljust(size, b"\0"))
    return {name: _plain(values[place]) for name, place in _form(kind).values}


def _plain(value: Any) -> Any:
    return value.split(b"\0")[0].decode("ascii", "replace") if isinstance(value, bytes) else value
