"""Times of the stages of each frame, and their statistics."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass

import numpy as np

from uav_recon.types.frames import FloatArray


@dataclass(frozen=True, slots=True)
class TimingSummary:
    """Median, 95th percentile and maximum of a set of times."""

    median_ms: float
    p95_ms: float
    max_ms: float

    @staticmethod
    def of(took_ms: FloatArray | list[float]) -> TimingSummary:
        """Summarize times; NaN if there are none."""
        if not len(took_ms):
            return TimingSummary(np.nan, np.nan, np.nan)
        return TimingSummary(float(np.median(took_ms)), float(np.percentile(took_ms, 95)), float(np.max(took_ms)))

    def divided_by(self, factor: float) -> TimingSummary:
        """Return the expected times of the reference machine."""
        return TimingSummary(*(value / factor for value in asdict(self).values()))


class Stopwatch:
    """Lap times of one frame by stage; laps of the same stage are added.

    ms: wall-clock time.
    cpu_ms: processor time of this thread, which is not lengthened by other load.
    """

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}
        self.cpu_ms: dict[str, float] = {}
        self.restart()

    def restart(self) -> None:
        """Start the next lap now."""
        self._last_s = time.perf_counter()
        self._last_cpu_s = time.thread_time()

    def lap(self, stage: str) -> None:
        """Add the time since the last lap or restart to ``stage``."""
        now_s, now_cpu_s = time.perf_counter(), time.thread_time()
        self.ms[stage] = self.ms.get(stage, 0.0) + (now_s - self._last_s) * 1e3
        self.cpu_ms[stage] = self.cpu_ms.get(stage, 0.0) + (now_cpu_s - self._last_cpu_s) * 1e3
        self._last_s = now_s
        self._last_cpu_s = now_cpu_s


class StageTimings:
    """Lap times of many frames, by one of the clocks."""

    def __init__(self) -> None:
        self._frames: list[dict[str, float]] = []

    def add(self, laps_ms: dict[str, float]) -> None:
        """Add the laps of a frame."""
        self._frames.append(dict(laps_ms))

    def __len__(self) -> int:
        return len(self._frames)

    def per_frame_ms(self, stages: tuple[str, ...]) -> FloatArray:
        """Return the sum of some stages (N,) for each frame that has any of them."""
        rows = [[laps.get(stage, 0.0) for stage in stages] for laps in self._frames if any(s in laps for s in stages)]
        summed: FloatArray = np.array(rows, dtype=np.float64).reshape(-1, len(stages)).sum(axis=1)
        return summed

    def spread(self, *stages: str) -> TimingSummary:
        """Return the summary of the sum of these stages."""
        return TimingSummary.of(self.per_frame_ms(stages))
