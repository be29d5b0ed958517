"""Clock of the link: the autopilot's clock against ours, and the delay of messages."""

from __future__ import annotations

import math

from uav_recon.autopilot.link.timesync import TimeSyncFilter
from uav_recon.autopilot.mavlink.messages import TimesyncMessage
from uav_recon.clock import RateKeeper
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_SLOW_TRIP_S = 0.2  #: brake: retreat_speed_mps at a longer round trip: with 0.1 s each way, at 0.8 m/s, it lags by 0.08 m more
_SLOW_FOR_S = 10.0  #: brake: a link counts as slow this long after it was: each change of the speed limit costs a stop
_NS = 1_000_000_000
#: refuse: a later answer does not count towards CLOCK_ANSWERS, without which PX4 is not armed: it learns nothing from it
_PROMPT_NS = 25_000_000
_REQUESTS_HZ, _REQUESTS_LOST_HZ = 10.0, 50.0  # the latter while its clock is lost
_OLD_S = 1.0  #: reject: the stamp of a turn rate, a gimbal angle or a range that is older


class LinkClock:
    """Learns the autopilot's clock from TIMESYNC, and puts stamps on ours.

    ``known``: True if it could be used after the newest reading. ``slow``: why our messages are too late, None if they are not.
    ``answers``: number of prompt answers to its requests for our clock.
    """

    def __init__(self, start_s: float) -> None:
        self._timesync = TimeSyncFilter()
        self._requests = RateKeeper(_REQUESTS_HZ, start_s)
        self._requests_lost = RateKeeper(_REQUESTS_LOST_HZ, start_s)
        self._slow_s = -math.inf
        self._slow: Reason | None = None
        self.known = False
        self.slow: Reason | None = None
        self.answers = 0

    @property
    def restarts(self) -> int:
        """Number of restarts of the autopilot's clock."""
        return self._timesync.restarts

    @property
    def lost(self) -> bool:
        """True if the clock could be used before and cannot now."""
        return self._timesync.lost

    def update(self, now_s: float) -> Reason | None:
        """Update whether the clock is known and the link slow; return the alert of a slow link.

        A link counts as slow until it has been quick for a while: each change of the speed limit costs a stop.
        """
        trip_s = self._timesync.usual_trip_s
        late = trip_s > _SLOW_TRIP_S
        if late:
            self._slow_s = now_s
            self._slow = Reason(ReasonCode.LINK_SLOW, (trip_s,))
        self.slow = self._slow if now_s - self._slow_s < _SLOW_FOR_S else None
        self.known = self._timesync.converged
        return self._slow if late else None

    def request_due(self, now_s: float) -> bool:
        """Return True if the clock has to be requested now; more often while it is lost."""
        return (self._requests_lost if self._timesync.lost else self._requests).due(now_s)

    def observe(self, answer: TimesyncMessage, now_s: float) -> bool:
        """Learn from an answer. Return True if it shows that the autopilot restarted."""
        before = self._timesync.restarts
        self._timesync.observe(answer.ts1_ns, answer.tc1_ns, int(now_s * _NS))
        return self._timesync.restarts > before

    def answer_ns(self, request: TimesyncMessage, now_s: float) -> int | None:
        """Return the answer to a request, in the autopilot's OWN clock; None if not known.

        Pose stamps are on that clock too, so an autopilot that corrects stamps by what it learns from our answers finds
        an offset of zero, and one that uses stamps unchanged is right as well. It learns nothing from a late copy.
        """
        if not self._timesync.converged:
            return None
        clock_ns = self._timesync.autopilot_ns(now_s)
        self.answers += abs(clock_ns - request.ts1_ns) <= _PROMPT_NS
        return clock_ns

    def autopilot_ns(self, ours_s: float) -> int:
        """Return our instant on the autopilot's clock, never negative.

        It has no meaning while that clock is not known.
        """
        return self._timesync.autopilot_ns(ours_s)

    def stamp_s(self, boot_ms: int, now_s: float) -> float | None:
        """Return our instant of the autopilot's milliseconds since boot, None if it is not known."""
        return self._timesync.ours_s(boot_ms, now_s) if boot_ms >= 0 and self.known else None

    def stamp_of_us_s(self, boot_us: int, now_s: float) -> float | None:
        """Return our instant of the autopilot's microseconds since boot, None if it is not known."""
        return self._timesync.ours_from_us(boot_us, now_s) if self.known else None

    def measured_s(self, boot_ms: int, now_s: float) -> float | None:
        """Return the instant of a measurement of the autopilot on our clock.

        None if that is not known or long past.
        """
        stamp_s = self.stamp_s(boot_ms, now_s)
        return min(stamp_s, now_s) if stamp_s is not None and now_s - stamp_s <= _OLD_S else None
