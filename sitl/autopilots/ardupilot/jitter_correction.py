"""Conversion of stamps to ArduPilot's clock by the minimum lag (AP_RTC JitterCorrection)."""

from __future__ import annotations

_LONGEST_LAG_US = 500_000
_WINDOW = 100


class JitterCorrection:
    """Filter of the clock offset, local - remote, µs; TIMESYNC is not used.

    A lag common to all messages remains in the result; VISO_DELAY_MS compensates it.
    """

    def __init__(self) -> None:
        self._offset_us: int | None = None
        self._min_us = 0
        self._count = 0

    def local_us(self, remote_us: int, now_us: int) -> int:
        """Return the sender's stamp on the autopilot's clock, µs."""
        lag_us = now_us - remote_us
        if self._offset_us is None or lag_us < self._offset_us:
            self._offset_us = lag_us
        estimate_us = remote_us + self._offset_us
        if now_us - estimate_us > _LONGEST_LAG_US:  # longer than any real lag: the sender's clock was set
            estimate_us = now_us - _LONGEST_LAG_US
            self._offset_us = estimate_us - remote_us
        self._min_us = lag_us if self._count == 0 else min(self._min_us, lag_us)
        self._count += 1
        if self._count == _WINDOW:
            self._offset_us = self._min_us
            self._count = 0
        return estimate_us
