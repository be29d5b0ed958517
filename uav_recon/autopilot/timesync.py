"""The autopilot's clock, estimated from TIMESYNC exchanges: the one with the shortest round trip is believed."""

from __future__ import annotations

from collections import deque

_NS = 1_000_000_000


class TimeSyncFilter:
    """Offset of the autopilot's boot clock against ours.

    Converged after ``samples_needed`` exchanges faster than ``round_trip_s``. A longer exchange than that is ignored.
    Five exchanges running that contradict the estimate by more than 0.1 s are believed. A clock that went back belongs to an
    autopilot that rebooted: start again. One that was only set, or stood still for a while, takes what was learned with it.
    """

    def __init__(self, samples_needed: int = 10, round_trip_s: float = 0.025, window: int = 64) -> None:
        self._needed, self._round_trip_ns = samples_needed, int(round_trip_s * _NS)
        self._samples: deque[tuple[int, int]] = deque(maxlen=window)  # (round trip, offset), ns
        self._contradictions, self._newest_ns = 0, 0
        self.restarts = 0

    @property
    def converged(self) -> bool:
        """Whether the offset may be used."""
        return len(self._samples) >= self._needed

    def observe(self, sent_ns: int, autopilot_ns: int, now_ns: int) -> None:
        """One answer: what we sent, what the autopilot's clock said, and when it came back."""
        round_trip = now_ns - sent_ns
        if not 0 <= round_trip <= self._round_trip_ns:
            return
        offset = autopilot_ns - (sent_ns + now_ns) // 2
        if self._samples and abs(offset - self._offset_ns()) > _NS // 10:
            self._contradictions += 1
            if self._contradictions < 5:
                return
            if autopilot_ns < self._newest_ns:
                self._samples.clear()
                self._contradictions, self._newest_ns = 0, 0
                self.restarts += 1
                return
            step_ns = offset - self._offset_ns()
            self._samples = deque(((trip, before + step_ns) for trip, before in self._samples), self._samples.maxlen)
        self._contradictions, self._newest_ns = 0, autopilot_ns
        self._samples.append((round_trip, offset))

    def autopilot_ns(self, ours_s: float) -> int:
        """Our instant on the autopilot's clock, never negative. Meaningless before convergence."""
        return max(int(ours_s * _NS) + self._offset_ns(), 0)

    def _offset_ns(self) -> int:
        return min(self._samples)[1] if self._samples else 0
