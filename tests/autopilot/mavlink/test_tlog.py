"""The flight log never blocks, drops the oldest, and outlives a full disk."""

from __future__ import annotations

import threading
from pathlib import Path

from uav_recon.autopilot.mavlink.tlog import NoLog, Tlog


class StuckFile:
    """A disk that hangs until it is let go, then may fail."""

    def __init__(self, error: OSError | None = None) -> None:
        self.go = threading.Event()
        self.error = error
        self.parts = list[bytes]()

    def write(self, data: bytes) -> None:
        self.go.wait(10.0)
        if self.error:
            raise self.error
        self.parts.append(data)

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass


def test_frames_stand_behind_their_microseconds(tmp_path: Path) -> None:
    log = Tlog(tmp_path / "flight.tlog", epoch_s=1_700_000_000.0)
    log.record(1.5, b"one")
    log.record(2.25, b"two")
    log.close()
    data = (tmp_path / "flight.tlog").read_bytes()
    assert data == (1_700_000_001_500_000).to_bytes(8, "big") + b"one" + (1_700_000_002_250_000).to_bytes(8, "big") + b"two"
    assert (log.dropped, log.gaps) == (0, "")
    NoLog().record(0.0, b"")


def test_a_hanging_disk_costs_the_oldest_frames_and_no_time(tmp_path: Path) -> None:
    log = Tlog(tmp_path / "flight.tlog", epoch_s=0.0, capacity_frames=100)
    stuck = StuckFile()
    log._file.close()
    log._file = stuck  # type: ignore[assignment]
    for i in range(500):
        log.record(float(i), i.to_bytes(2, "big"))
    stuck.go.set()
    log.close()
    kept = [int.from_bytes(part[8:], "big") for part in stuck.parts]
    assert kept[-100:] == list(range(400, 500))
    assert log.dropped == 500 - len(kept)
    assert log.dropped > 300
    assert log.gaps == f"{log.dropped} frames are missing from the flight's log"


def test_a_full_disk_ends_the_log_and_says_so(tmp_path: Path) -> None:
    log = Tlog(tmp_path / "flight.tlog", epoch_s=0.0)
    log._file.close()
    full = StuckFile(OSError(28, "No space left on device"))
    full.go.set()
    log._file = full  # type: ignore[assignment]
    log.record(0.0, b"x")
    log.close()
    assert log.gaps == "flight log ended: No space left on device: 1 frames are missing from the flight's log"
