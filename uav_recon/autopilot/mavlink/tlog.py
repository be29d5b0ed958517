"""flight.tlog: every frame of both directions with its time, written by its own thread."""

from __future__ import annotations

import struct
import threading
from collections import deque
from pathlib import Path
from typing import BinaryIO, Protocol

_STAMP = struct.Struct(">Q")


class FrameLog(Protocol):
    """Log of the frames that the link sent and received."""

    def record(self, now_s: float, frame: bytes) -> None:
        """Log one frame at an instant of the injected clock. Never blocks, never raises."""
        ...


class NoLog:
    """A log that stores nothing."""

    def record(self, now_s: float, frame: bytes) -> None:
        """Discard the frame."""


class Tlog:
    """The common telemetry log: 8 bytes big-endian microseconds since 1970, then the raw frame.

    epoch_s is added to the injected clock: time.time() - clock.now_s() in flight, a constant in lockstep.
    The queue is bounded and drops its oldest frame; ``dropped`` counts them. A full disk ends the log, not the flight:
    ``failure`` then holds the reason. Raises OSError if the file cannot be opened.
    """

    def __init__(self, path: Path, epoch_s: float, capacity_frames: int = 8192) -> None:
        self._file: BinaryIO = path.open("wb")
        self._epoch_s = epoch_s
        self._queue: deque[bytes] = deque(maxlen=capacity_frames)
        self._hurry = capacity_frames // 4
        self._recorded = 0
        self._written = 0
        self._wake = threading.Event()
        self._closing = False
        self.failure = ""
        self._thread = threading.Thread(target=self._write_all, name="tlog", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of lost frames: recorded, but neither queued nor written."""
        return self._recorded - self._written - len(self._queue)

    @property
    def gaps(self) -> str:
        """Description of the gaps in the log, '' for nothing."""
        lost = f"{self.dropped} frames are missing from the flight's log" if self.dropped else ""
        return f"{self.failure}: {lost}" if self.failure and lost else self.failure or lost

    def record(self, now_s: float, frame: bytes) -> None:
        """Log one frame."""
        self._queue.append(_STAMP.pack(int((now_s + self._epoch_s) * 1e6)) + frame)
        self._recorded += 1
        if len(self._queue) > self._hurry:  # otherwise the writer wakes by itself, a few times a second
            self._wake.set()

    def close(self) -> None:
        """Write what is queued, and end."""
        self._closing = True
        self._wake.set()
        self._thread.join(timeout=5.0)
        self._file.close()

    def _write_all(self) -> None:
        while not self._closing:
            self._wake.wait(0.25)
            self._wake.clear()
            self._drain()
        self._drain()

    def _drain(self) -> None:
        try:
            while self._queue:
                self._file.write(self._queue.popleft())
                self._written += 1
            self._file.flush()
        except OSError as error:
            self.failure = self.failure or f"flight log ended: {error.strerror}"
            self._queue.clear()
