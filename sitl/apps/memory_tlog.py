"""MAVLink log (flight.tlog) in memory, written at the end of a lockstep flight."""

from __future__ import annotations

import struct
from pathlib import Path

_STAMP = struct.Struct(">Q")


class MemoryTlog:
    """MAVLink log with the same file format as the product's Tlog, but without a thread.

    A record is the flight's clock in µs, 8 bytes big-endian, followed by the raw frame.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._bytes = bytearray()

    def record(self, now_s: float, frame: bytes) -> None:
        """Append one frame."""
        self._bytes += _STAMP.pack(int(now_s * 1e6)) + frame

    def close(self) -> None:
        """Write the file. Raises OSError."""
        self._path.write_bytes(self._bytes)
