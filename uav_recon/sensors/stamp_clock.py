"""A device's time stamps on the companion's monotonic clock, by their arrivals.

A stamp reaches the companion after a delay that varies and is never negative. The lower convex hull of the points (arrival,
arrival - stamp) therefore bounds the offset of the two clocks, and its edge at the mean arrival is the line below all points
that lies closest to them (Moon, Skelly, Towsley, Estimation and removal of clock skew from network delay measurements,
INFOCOM 1999; by the hull: Zhang, Liu, Xia, Clock synchronization algorithms for network measurements, INFOCOM 2002). The
shortest delay itself cannot be observed: a stamp on the companion's clock is later than the truth by it.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

_BIN_S = 0.1  # of all arrivals in this time only the one with the shortest delay is kept
_KNOWN_BINS = 5  # before them the shortest delay may not have been met
_WINDOW_S = 15.0  # arrivals that the line is fitted to
_SLOPE_AFTER_S = 2.0  # before it the drift is taken as zero
_MAX_DRIFT = 300e-6  # a quartz is off by 100 ppm at most; beyond, the slope is that of the delays
#: reject: a stream whose stamps gain or lose more than this share against the companion's clock: they count no seconds
_NO_CLOCK_SHARE = 0.03
_NO_CLOCK_AFTER_S = 5.0  #: reject: after this time
_RESETS = 5  #: reject: a stream whose clock was set so often, each time within _WINDOW_S of the one before
#: reject: frames for a moment, if one stamp is newer than expected by this, or all are older: the device's clock was set
_STEP_S = 0.1
_STEP_FOR_S = 0.5  #: reject: ... older for this time
#: reject: frames for a moment, if a stamp is older than the one before it, and all after it are late by this for _STEP_FOR_S
_BACK_STEP_S = 0.02
_RESET_S = 1.0  #: reject: frames for a moment, if one stamp is older than expected by this: the device's clock was set
#: internal: no transport takes longer; a system or global time of which all stamps are older is wrong
_MAX_TRANSPORT_S = 0.15
_SAME_CLOCK_S = 0.08  #: reject: delays of two streams differ by this at most; beyond, they have clocks of their own
HOLD_S = 0.5  #: reject: frames for this time after their clock changed or was set (hazard C7)


class StampDomain(Enum):
    """The clock of a device's stamps."""

    HARDWARE = "hardware clock"  # of the device: any origin, drifts
    SYSTEM = "system time"  # of the companion, when the data arrived there
    GLOBAL = "global time"  # of the companion, when the data was captured, as the driver estimates it


class ClockOffset:
    """Offset of one stamp clock against the clock of the arrivals, with drift.

    ``resets``: how often the device's clock was set. ``last_reset_s``: when; -inf for never. ``set_back``: True if it was set
    to an earlier time, the last time.
    """

    def __init__(self) -> None:
        self.resets = 0
        self.last_reset_s = -math.inf
        self.set_back = False
        self._forget()

    def _forget(self) -> None:
        self._bins: deque[tuple[float, float]] = deque()  # arrival, smallest difference; of the past
        self._bin: tuple[float, float] | None = None  # of this moment
        self._bin_since_s = -math.inf
        self._line = (0.0, math.inf, 0.0)  # an arrival, the difference there, and its slope
        self._slow_since_s = math.inf
        self._stamp_s = -math.inf  # of the device, the newest one
        self._stepped_back = False  # a stamp was older than the one before it, and those since are late

    def update(self, difference_s: float, arrival_s: float) -> None:
        """Add the difference between the arrival of a stamp and the stamp."""
        late_s, stamp_s = difference_s - self.at(arrival_s), arrival_s - difference_s
        self._stepped_back |= stamp_s < self._stamp_s
        self._stamp_s = stamp_s
        if self._is_step(late_s, arrival_s):
            self._restart(arrival_s, set_back=late_s > 0.0)
        if arrival_s - self._bin_since_s >= _BIN_S:
            self._close_bin(arrival_s)
        if self._bin is None or difference_s < self._bin[1]:
            self._bin = (arrival_s, difference_s)
        base_s, offset_s, slope = self._line
        if difference_s < offset_s + slope * (arrival_s - base_s):
            self._line = (arrival_s, difference_s, slope)

    def at(self, arrival_s: float) -> float:
        """Return the offset at an instant.

        The companion's clock less the device's, with the shortest delay.
        """
        base_s, offset_s, slope = self._line
        return offset_s + slope * (arrival_s - base_s)

    @property
    def known(self) -> bool:
        """True after the first stamp."""
        return math.isfinite(self._line[1])

    def drift_fault(self) -> float | None:
        """Return the drift if it is that of no clock.

        A share, inf if the clock is set again and again; None for a clock.
        """
        if self.resets >= _RESETS:
            return math.inf
        if not self._bins or self._bins[-1][0] - self._bins[0][0] < _NO_CLOCK_AFTER_S:
            return None
        drift = hull_slope(list(self._bins))
        return drift if abs(drift) > _NO_CLOCK_SHARE else None

    def _is_step(self, late_s: float, arrival_s: float) -> bool:
        """Return True if the device's clock was set: one stamp far off, or all of a while late."""
        if not math.isfinite(late_s):
            return False
        if late_s > _RESET_S or (late_s < -_STEP_S and len(self._bins) >= _KNOWN_BINS):
            return True
        if late_s <= (_BACK_STEP_S if self._stepped_back else _STEP_S):
            self._slow_since_s, self._stepped_back = math.inf, False
            return False
        self._slow_since_s = min(self._slow_since_s, arrival_s)
        return arrival_s - self._slow_since_s >= _STEP_FOR_S

    @property
    def surely_known(self) -> bool:
        """True once the shortest delay has probably been met."""
        return len(self._bins) >= _KNOWN_BINS

    def _restart(self, arrival_s: float, set_back: bool) -> None:
        resets = self.resets + 1 if arrival_s - self.last_reset_s < _WINDOW_S else 1
        self._forget()
        self.resets, self.last_reset_s, self.set_back = resets, arrival_s, set_back

    def _close_bin(self, arrival_s: float) -> None:
        if self._bin is not None:
            self._bins.append(self._bin)
        self._bin, self._bin_since_s = None, arrival_s
        while self._bins and arrival_s - self._bins[0][0] > _WINDOW_S:
            self._bins.popleft()
        if self._bins:
            self._line = fit_below(list(self._bins))


def fit_below(points: list[tuple[float, float]]) -> tuple[float, float, float]:
    """Return the line below all points that lies closest to them.

    An abscissa, the ordinate there, and the slope.

    points: (x, y) by increasing x. The slope is that of the lower hull's edge at the mean x, at most _MAX_DRIFT in size; 0 if
    the points span less than _SLOPE_AFTER_S.
    """
    slope = 0.0
    if points[-1][0] - points[0][0] >= _SLOPE_AFTER_S:
        slope = min(max(hull_slope(points), -_MAX_DRIFT), _MAX_DRIFT)
    end_x = points[-1][0]
    return end_x, min(y + slope * (end_x - x) for x, y in points), slope


def hull_slope(points: list[tuple[float, float]]) -> float:
    """Return the slope of the lower hull's edge at the mean abscissa.

    points: (x, y) by increasing x, at least two.
    """
    mean_x = sum(x for x, _ in points) / len(points)
    hull = _lower_hull(points)
    (x0, y0), (x1, y1) = next(edge for edge in itertools.pairwise(hull) if edge[1][0] >= mean_x)
    return (y1 - y0) / (x1 - x0)


def _lower_hull(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the lower convex hull of points by increasing x (monotone chain)."""
    hull: list[tuple[float, float]] = []
    for point in points:
        while len(hull) >= 2 and _turn(hull[-2], hull[-1], point) <= 0.0:
            hull.pop()
        hull.append(point)
    return hull


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@dataclass(frozen=True, slots=True)
class ClockFault:
    """A stream whose stamps cannot be related to the companion's clock.

    drift: a share; inf if they jump again and again.
    """

    stream: str
    drift: float


class DeviceClocks:
    """The stamp clocks of one device.

    Each stream by itself, and those that share a clock together.

    Streams of one domain whose delays are alike share the clock of the device: the stream with the shortest delay (that of the
    inertial samples) then gives the offset of all, and the delay of the others shows in their age. Streams whose offsets differ
    by more than any delay have clocks of their own. So has a stream that was set back, and whose offset differs from that of
    another by 20 ms more than before: it is anchored on its arrivals with the delay that it had.

    System and global time are the companion's own, and count as told. If such a clock was set back, or all its stamps are older
    than any transport takes, it is wrong: the stream's stamps are then anchored on their arrivals, with the shortest delay that
    it had before.
    """

    def __init__(self) -> None:
        self._offsets: dict[str, ClockOffset] = {}
        self._domains: dict[str, StampDomain] = {}
        self._settled_s: dict[str, float] = {}
        self._delay_s: dict[str, float] = {}  # the shortest, of system or global time that was right
        self._before_s: dict[tuple[str, str], float] = {}  # offset of a stream less that of another, before one was set back

    def monotonic_s(self, stream: str, domain: StampDomain, stamp_s: float, arrival_s: float, wall_s: float) -> float:
        """Return a stamp on the companion's clock; never later than its arrival.

        arrival_s: when it arrived, on the companion's clock; wall_s: the same instant as system time.
        """
        if self._domains.get(stream) is not domain:
            self._settled_s[stream] = arrival_s + (HOLD_S if stream in self._domains else -math.inf)
            self._domains[stream], self._offsets[stream] = domain, ClockOffset()
            self._delay_s.pop(stream, None)
            self._before_s = {pair: apart_s for pair, apart_s in self._before_s.items() if stream not in pair}
        based_s = stamp_s if domain is StampDomain.HARDWARE else stamp_s + arrival_s - wall_s
        offset = self._offsets[stream]
        offset.update(arrival_s - based_s, arrival_s)
        if offset.last_reset_s == arrival_s:
            self._settled_s[stream] = arrival_s + HOLD_S
        if self.behind_s(stream, arrival_s) is not None:
            return based_s + offset.at(arrival_s) - self._delay_s.get(stream, 0.0)
        if offset.at(arrival_s) <= _MAX_TRANSPORT_S:
            self._delay_s[stream] = max(offset.at(arrival_s), 0.0)
        self._note_before(stream, arrival_s)
        if domain is StampDomain.HARDWARE and any(self._split_s(stream, other, arrival_s) for other in self._offsets):
            delays_s = (apart_s for (first, _), apart_s in self._before_s.items() if first == stream)
            return based_s + offset.at(arrival_s) - max(0.0, *delays_s)
        shared_s = min(other.at(arrival_s) for other in self._sharing(stream, arrival_s))
        if domain is not StampDomain.HARDWARE:  # it tells the capture, or the arrival, by the companion's own clock
            shared_s = min(shared_s, 0.0)
        return based_s + shared_s

    def behind_s(self, stream: str, now_s: float) -> float | None:
        """Return how far a stream's system or global time is behind the companion's.

        None if it is right or not known, and for a hardware clock, which has any origin.
        """
        offset = self._offsets.get(stream)
        if offset is None or self._domains[stream] is StampDomain.HARDWARE:
            return None
        delay_s = offset.at(now_s)
        behind_s = delay_s - self._delay_s.get(stream, 0.0)
        wrong = behind_s > _BACK_STEP_S if offset.set_back else offset.surely_known and delay_s > _MAX_TRANSPORT_S
        return behind_s if wrong else None

    def settled(self, stream: str, now_s: float) -> bool:
        """Return True if the stream's clock has neither changed nor been set for HOLD_S.

        The first one counts as settled.
        """
        return now_s >= self._settled_s.get(stream, -math.inf)

    def domains(self) -> dict[str, StampDomain]:
        """Return the domain of each stream that has sent a stamp."""
        return dict(self._domains)

    def faults(self) -> list[ClockFault]:
        """Return the streams whose stamps are those of no clock."""
        found = ((stream, offset.drift_fault()) for stream, offset in sorted(self._offsets.items()))
        return [ClockFault(stream, drift) for stream, drift in found if drift is not None]

    def apart_s(self, first: str, second: str, now_s: float) -> float | None:
        """Return by how much the clocks of two streams differ.

        None if they share one, or are not known.
        """
        if first not in self._offsets or second not in self._offsets or self._domains[first] is not self._domains[second]:
            return None
        if any(self.behind_s(stream, now_s) is not None for stream in (first, second)):
            return None
        apart_s = self._offsets[first].at(now_s) - self._offsets[second].at(now_s)
        return apart_s if abs(apart_s) > _SAME_CLOCK_S else self._split_s(first, second, now_s) or None

    def _note_before(self, stream: str, now_s: float) -> None:
        """Note by how much the offset of a stream differs from others, while none was set back."""
        own = self._offsets[stream]
        for name, other in self._offsets.items():
            steady = own.surely_known and other.surely_known and not own.set_back and not other.set_back
            if name != stream and steady and self._domains[name] is self._domains[stream]:
                apart_s = own.at(now_s) - other.at(now_s)
                if abs(apart_s) <= _SAME_CLOCK_S:
                    self._before_s[stream, name] = apart_s

    def _split_s(self, stream: str, other: str, now_s: float) -> float:
        """Return by how much a stream was set back against another whose clock it had shared.

        0 if it was not.
        """
        before_s = self._before_s.get((stream, other))
        if before_s is None or not self._offsets[stream].set_back:
            return 0.0
        step_s = self._offsets[stream].at(now_s) - self._offsets[other].at(now_s) - before_s
        return step_s if step_s > _BACK_STEP_S else 0.0

    def _sharing(self, stream: str, arrival_s: float) -> list[ClockOffset]:
        """Return the offsets that bound that of a stream.

        Its own, and those of the streams on the same clock.
        """
        own = self._offsets[stream]
        others = (
            offset
            for name, offset in self._offsets.items()
            if name != stream and offset.known and self._domains[name] is self._domains[stream]
        )
        return [own, *(other for other in others if own.at(arrival_s) - other.at(arrival_s) <= _SAME_CLOCK_S)]
