"""flight.tlog of a flight in lockstep: kept in memory and written at its end, so that no thread stands beside the flight."""

from __future__ import annotations

import struct
from pathlib import Path

_STAMP = struct.Struct(">Q")


class MemoryTlog:
    """The same file as the product's own Tlog: 8 bytes big-endian microseconds of the flight's clock, then the raw frame."""

    def __init__(self, path: Path) -> None:
        self._path, self._bytes = path, bytearray()

    def record(self, now_s: float, frame: bytes) -> None:
        """Note one frame."""
        self._bytes += _STAMP.pack(int(now_s * 1e6)) + frame

    def close(self) -> None:
        """Write them. Raises OSError."""
        self._path.write_bytes(self._bytes)
