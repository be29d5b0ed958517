"""PX4's side of TIMESYNC: clock offset to the companion, and conversion of its stamps.

Constants and filter: PX4 src/lib/timesync (v1.17), double exponential smoothing with a gain schedule.
"""

from __future__ import annotations

import math

_WINDOW = 500  # accepted exchanges until converged: 50 s at 10 Hz
_ALPHA = (0.05, 0.003)  # first, final
_BETA = (0.05, 0.003)
_MAX_RTT_US = 10_000
_MAX_DEVIATION_US = 100_000
_MAX_DEVIATIONS = 5


class Px4Timesync:
    """Filter of the clock offset, local - remote, µs."""

    def __init__(self) -> None:
        self._sequence = 0
        self._offset_us = 0.0
        self._skew_us = 0.0
        self._deviations = 0

    @property
    def converged(self) -> bool:
        """True if stamps of the companion are used."""
        return self._sequence >= _WINDOW

    @property
    def offset_us(self) -> float:
        """Autopilot's clock minus companion's clock, µs."""
        return self._offset_us

    def answered(self, now_us: int, remote_ns: int, sent_ns: int) -> None:
        """Update with an answer (remote_ns: companion clock; sent_ns: stamp of the request)."""
        round_trip = now_us - sent_ns // 1000
        if not 0 <= round_trip < _MAX_RTT_US:
            return
        observed = (sent_ns // 1000 + now_us - 2 * (remote_ns // 1000)) / 2.0
        if self.converged and abs(self._offset_us - observed) > _MAX_DEVIATION_US:
            self._deviations += 1
            if self._deviations > _MAX_DEVIATIONS:  # the companion's clock jumped: restart the filter
                self._sequence = 0
                self._offset_us = 0.0
                self._skew_us = 0.0
                self._deviations = 0
            return
        self._deviations = 0
        if self._sequence == 0:
            self._offset_us = observed
        else:
            alpha, beta = self._gains()
            before = self._offset_us
            self._offset_us = alpha * observed + (1.0 - alpha) * (self._offset_us + self._skew_us)
            self._skew_us = beta * (self._offset_us - before) + (1.0 - beta) * self._skew_us
        self._sequence += 1

    def _gains(self) -> tuple[float, float]:
        if self.converged:
            return _ALPHA[1], _BETA[1]
        p = 1.0 - math.exp(0.5 * (1.0 - 1.0 / (1.0 - self._sequence / _WINDOW)))
        return p * _ALPHA[1] + (1.0 - p) * _ALPHA[0], p * _BETA[1] + (1.0 - p) * _BETA[0]

    def local_us(self, remote_us: int, now_us: int) -> int:
        """Return the companion's stamp on the autopilot's clock; the arrival time until converged."""
        return remote_us + round(self._offset_us) if self.converged else now_us
