"""MAVLink 2 signing: only holders of the key can make frames; each is accepted once.

A signed frame is followed by a link id, 48 bits of time and six bytes of SHA-256 over the key and all before (mavlink.io,
Message Signing). pymavlink's own check stores a sender's time before it has verified the signature, so one forged frame
silences the true vehicle permanently; here nothing is stored of a frame with an invalid signature.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from uav_recon.autopilot.mavlink.framing import is_signed, marked_signed, sender_of
from uav_recon.autopilot.mavlink.signing_timestamps import SigningTimestamps
from uav_recon.clock import ThreadExecutor
from uav_recon.interfaces import Clock

KEY_BYTES = 32
_MAX_BYTES = 1024
_SHORTEST_PHRASE = 8
_TAIL = 13  # link id, time, signature
_HASH = 6


class KeyFileError(Exception):
    """A key that cannot be used; its text is one line that names the file, never its content."""


class Signer(Protocol):
    """Signs our frames and checks the signatures of received ones."""

    def put(self, frame: bytes, now_s: float) -> bytes:
        """Return one of our frames as it is sent."""
        ...

    def verify(self, frame: bytes) -> bool:
        """Return True if a received frame would be accepted. Changes nothing."""
        ...

    def accept(self, frame: bytes) -> bool:
        """Return True if a received frame is authentic and new; a copy of it is rejected later."""
        ...

    def close(self) -> None:
        """Save what a restart needs."""
        ...


class NullSigner:
    """Signing is off: all frames are accepted."""

    def put(self, frame: bytes, now_s: float) -> bytes:
        """Return the frame unsigned."""
        return frame

    def verify(self, frame: bytes) -> bool:
        """Return True."""
        return True

    def accept(self, frame: bytes) -> bool:
        """Return True."""
        return True

    def close(self) -> None:
        """Do nothing."""


class Signature:
    """Signing is on: our frames are signed, and only frames with a valid signature are accepted.

    RADIO_STATUS, which the specification accepts unsigned, has no data that is used here.
    """

    def __init__(self, key: bytes, link_id: int, stamps: SigningTimestamps) -> None:
        self._key = key
        self._link_id = bytes((link_id,))
        self._stamps = stamps
        self._link_ids: dict[tuple[int, int], int] = {}  # the first link id of each system and component

    def put(self, frame: bytes, now_s: float) -> bytes:
        """Return the frame marked as signed, and signed at this instant."""
        stamped = marked_signed(frame) + self._link_id + self._stamps.next(now_s).to_bytes(6, "little")
        return stamped + self._hash(stamped)

    def verify(self, frame: bytes) -> bool:
        """Return True if the signature is valid, the stamp new, and the link id that of the sender."""
        if not is_signed(frame) or not hmac.compare_digest(frame[-_HASH:], self._hash(frame[:-_HASH])):
            return False
        if self._link_ids.get(sender_of(frame), frame[-_TAIL]) != frame[-_TAIL]:
            return False
        return self._stamps.is_new(self._stream(frame), self._stamp(frame))

    def accept(self, frame: bytes) -> bool:
        """Return the result of verify(), and record the stamp of an accepted frame."""
        if not self.verify(frame):
            return False
        self._link_ids[sender_of(frame)] = frame[-_TAIL]
        self._stamps.note(self._stream(frame), self._stamp(frame))
        return True

    def close(self) -> None:
        """Write the stamps."""
        self._stamps.close()

    def _hash(self, stamped: bytes) -> bytes:
        return hashlib.sha256(self._key + stamped).digest()[:_HASH]

    @staticmethod
    def _stream(frame: bytes) -> tuple[int, int, int]:
        return (frame[-_TAIL], *sender_of(frame))

    @staticmethod
    def _stamp(frame: bytes) -> int:
        return int.from_bytes(frame[1 - _TAIL : -_HASH], "little")


def open_signature(key: Path, link_id: int, stamps: Path, clock: Clock, wall_s: Callable[[], float] = time.time) -> Signature:
    """Return the signer for a vehicle's key file and its file of stamps.

    wall_s: seconds since 1970, called once. Raises KeyFileError or SigningTimestampsError.
    """
    secret = read_key(key)
    return Signature(secret, link_id, SigningTimestamps(stamps, wall_s(), clock.now_s(), ThreadExecutor("signing")))


def read_key(path: Path) -> bytes:
    """Return the key from a file that only its owner may read.

    A line of text is a passphrase, as ground stations use it (its SHA-256 is the key); anything else must be 32 bytes. Raises
    KeyFileError.
    """
    try:
        file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError as error:
        raise KeyFileError(f"signing_key {path}: cannot be read ({error.strerror})") from None
    try:
        mode = os.fstat(file).st_mode
        content = os.read(file, _MAX_BYTES + 1) if stat.S_ISREG(mode) else b""
    finally:
        os.close(file)
    if not stat.S_ISREG(mode):
        raise KeyFileError(f"signing_key {path}: not a file")
    if mode & 0o077:
        raise KeyFileError(f"signing_key {path}: permissions {mode & 0o777:04o}, want 0600: others may read or change the key")
    phrase = _phrase(content)
    if phrase is not None and len(phrase) <= _MAX_BYTES:
        if len(phrase) < _SHORTEST_PHRASE:
            raise KeyFileError(f"signing_key {path}: a passphrase of {len(phrase)} bytes, want {_SHORTEST_PHRASE} at least")
        return hashlib.sha256(phrase).digest()
    if len(content) != KEY_BYTES:
        raise KeyFileError(f"signing_key {path}: {len(content)} bytes, want {KEY_BYTES}, or one line of text as a passphrase")
    return content


def _phrase(content: bytes) -> bytes | None:
    try:
        line = content.decode().removesuffix("\n")
    except UnicodeDecodeError:
        return None
    return line.encode() if line.isprintable() else None
