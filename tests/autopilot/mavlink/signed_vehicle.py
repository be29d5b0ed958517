"""A vehicle's end of a signed link, by pymavlink alone: what is not signed does not reach it, and all it says is signed."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as wire

from sitl.autopilots.byte_links import ByteEnd


def signer(key: bytes, stamp: int, link_id: int = 0, sender: tuple[int, int] = (1, 1)) -> Any:
    """A pymavlink end that signs, and lets only signed frames in."""
    voice: Any = wire.MAVLink(None, *sender)
    voice.robust_parsing = True
    voice.signing.secret_key, voice.signing.timestamp, voice.signing.link_id = key, stamp, link_id
    voice.signing.sign_outgoing = True
    return voice


class SignedEnd:
    """As ArduPilot: its stamps follow the newest that it has believed. behind: how far (units) its clock is at first."""

    def __init__(self, inner: ByteEnd, key: bytes, stamp: int) -> None:
        self._inner = inner
        self._plain = wire.MAVLink(None, 1, 1)
        self._plain.robust_parsing = True
        self.voice = signer(key, stamp)
        self.believed: list[str] = []
        self.refused = 0

    @property
    def arrival_s(self) -> float | None:
        return self._inner.arrival_s

    def read(self) -> bytes:
        while data := self._inner.read():
            believed = b""
            for message in self.voice.parse_buffer(data) or ():
                if message.get_type() == "BAD_DATA":
                    self.refused += 1
                else:
                    self.believed.append(message.get_type())
                    believed += bytes(message.get_msgbuf())
            if believed:
                return believed
        return b""

    def write(self, data: bytes) -> None:
        for message in self._plain.parse_buffer(data) or ():
            self._inner.write(bytes(message.pack(self.voice)))
            self.voice.seq = (self.voice.seq + 1) % 256
