"""Estimate of the autopilot's clock from TIMESYNC exchanges.

The exchange with the shortest round trip gives the offset.
"""

from __future__ import annotations

import math
import statistics
from collections import deque

_NS = 1_000_000_000  #: internal: a second
_SAMPLES = 10  #: refuse: arming before this many prompt exchanges: the autopilot's clock is not known
_PROMPT_S = 0.025  #: reject: an exchange with a longer round trip, which is too uncertain
#: reject: an exchange that is farther off the estimated clock; until it is settled no poses are sent
_CONTRADICTS_NS = _NS // 10
_END_NS = 1 << 62  #: reject: an autopilot's clock beyond 146 years: one that continues from there soon exceeds 63 bits
_WRAP_S = 2.0**32 / 1000.0  #: internal: a boot clock of 32 bits restarts after this
_LATEST = 20  #: brake: exchanges whose median round trip tells whether the link is slow
_LONGEST_NS = 2 * _NS  #: reject: a longer round trip is not counted in that median
_ENOUGH = 5  #: reject: an estimate of the clock that this many exchanges in a row, which agree with each other, contradict


class TimeSyncFilter:
    """Offset of the autopilot's boot clock against ours.

    Converged after ``samples_needed`` exchanges faster than ``round_trip_s``. A longer exchange than that is ignored.
    One that contradicts the estimate by more than 0.1 s makes it doubtful: it may not be used until an exchange agrees with it
    again, or until five consecutive ones agree with one another and replace it. A clock that went back belongs to an autopilot
    that rebooted: the filter restarts with these five. If the clock was only set, or stood still for a while, the earlier
    samples are shifted with it.
    ``usual_trip_s``: median of the last twenty exchanges of any duration; 0 before there are twenty.
    """

    def __init__(self, samples_needed: int = _SAMPLES, round_trip_s: float = _PROMPT_S, window: int = 64) -> None:
        self._needed = samples_needed
        self._round_trip_ns = int(round_trip_s * _NS)
        self._samples: deque[tuple[int, int]] = deque(maxlen=window)  # (round trip, offset), ns
        self._trips: deque[tuple[int, int]] = deque(maxlen=_LATEST)  # (sent, round trip), ns, of any duration
        self._against: list[tuple[int, int]] = []  # consecutive exchanges that contradict them
        self._newest_ns = self._offset_ns = 0
        self.usual_trip_s = 0.0
        self.restarts = 0

    @property
    def converged(self) -> bool:
        """True if the offset may be used."""
        return len(self._samples) >= self._needed and not self._against

    @property
    def lost(self) -> bool:
        """True if the offset could be used before and cannot now: every exchange counts."""
        return bool(self._against) or (self.restarts > 0 and not self.converged)

    def observe(self, sent_ns: int, autopilot_ns: int, now_ns: int) -> None:
        """Process one answer: when it was sent, the autopilot's clock in it, and when it came back."""
        round_trip = now_ns - sent_ns
        self._time(sent_ns, round_trip)
        if not (0 <= round_trip <= self._round_trip_ns and autopilot_ns < _END_NS):
            return
        offset = autopilot_ns - (sent_ns + now_ns) // 2
        if self._samples and abs(offset - self._offset_ns) > _CONTRADICTS_NS:
            self._contradict(round_trip, offset, autopilot_ns)
            return
        self._against = []
        self._newest_ns = autopilot_ns
        self._samples.append((round_trip, offset))
        self._offset_ns = min(self._samples)[1]

    def _time(self, sent_ns: int, round_trip: int) -> None:
        """Record a round trip. Of copies of an answer only the first one counts."""
        if 0 <= round_trip <= _LONGEST_NS and all(sent_ns != before for before, _ in self._trips):
            self._trips.append((sent_ns, round_trip))
            if len(self._trips) == _LATEST:
                self.usual_trip_s = statistics.median(trip for _, trip in self._trips) / _NS

    def _contradict(self, round_trip: int, offset: int, autopilot_ns: int) -> None:
        if self._against and abs(offset - self._against[-1][1]) > _CONTRADICTS_NS:
            self._against.clear()
        self._against.append((round_trip, offset))
        if len(self._against) < _ENOUGH:
            return
        if autopilot_ns < self._newest_ns:
            self._samples = deque(self._against, self._samples.maxlen)
            self.restarts += 1
        else:
            step_ns = offset - self._offset_ns
            moved = ((trip, before + step_ns) for trip, before in self._samples)
            self._samples = deque((*moved, (round_trip, offset)), self._samples.maxlen)
        self._against = []
        self._newest_ns = autopilot_ns
        self._offset_ns = min(self._samples)[1]

    def autopilot_ns(self, ours_s: float) -> int:
        """Return our instant on the autopilot's clock, never negative.

        It has no meaning before convergence.
        """
        return max(int(ours_s * _NS) + self._offset_ns, 0)

    def ours_from_us(self, boot_us: int, now_s: float) -> float:
        """Return our instant of the autopilot's microseconds since boot.

        It has no meaning before convergence.
        """
        return now_s + (boot_us * 1000 - self.autopilot_ns(now_s)) / _NS

    def ours_s(self, boot_ms: int, now_s: float) -> float:
        """Return our instant of the autopilot's milliseconds since boot, near now.

        It has no meaning before convergence.
        """
        return now_s + math.remainder(boot_ms / 1000.0 - self.autopilot_ns(now_s) / _NS, _WRAP_S)
