"""Reporter of a reduced speed: messages for the ground station.

One when the speed limit falls, one when its cause is another one, one when the speed is full again.
"""

from __future__ import annotations

import math

from uav_recon.types.reason import Reason, codes_of
from uav_recon.types.reason_code import ReasonCode

_SETTLED_S = 0.3  #: warn: a cause that reduces the speed for longer: a single late pose causes no message
_OVER_S = 2.0  #: warn: the speed counts as full again after this time without a cause
_APART_S = 1.0  #: warn: at most one message of a reduced speed in this time
_AGAIN_S = 10.0  #: warn: the same message is sent again after this time at the earliest: causes may alternate


class ReducedSpeedReporter:
    """Reports each cause of a reduced speed once, and its end."""

    def __init__(self) -> None:
        self._begun_s = math.inf  # of the time of reduced speed
        self._caused_s = -math.inf  # the newest cause was present then
        self._told: tuple[str, ...] = ()
        self._told_s: dict[tuple[str, ...], float] = {}

    def update(self, cause: Reason | None, now_s: float) -> Reason | None:
        """Return the message for now, None for none.

        cause: why the speed is reduced now, None if it is not.
        """
        if cause is not None:
            self._begun_s, self._caused_s = min(self._begun_s, now_s), now_s
        elif now_s - self._caused_s >= _OVER_S:
            self._begun_s = math.inf
        waiting = cause is None and self._begun_s < math.inf  # a gap between causes
        codes = codes_of(cause)
        unsettled = cause is not None and now_s - self._begun_s < _SETTLED_S
        if waiting or unsettled or codes == self._told or self._too_soon(codes, now_s):
            return None
        self._told, self._told_s[codes] = codes, now_s
        return Reason(ReasonCode.FULL_SPEED) if cause is None else Reason(ReasonCode.REDUCED_SPEED, details=(cause,))

    def _too_soon(self, codes: tuple[str, ...], now_s: float) -> bool:
        newest_s = max(self._told_s.values(), default=-math.inf)
        return now_s - newest_s < _APART_S or now_s - self._told_s.get(codes, -math.inf) < _AGAIN_S
