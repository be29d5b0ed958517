"""Measurements of the autopilot on our clock: turn rates, and poses of its navigation."""

from __future__ import annotations

from collections import deque

import numpy as np

from uav_recon.autopilot.link.link_clock import LinkClock
from uav_recon.autopilot.link.navigation import Navigation
from uav_recon.autopilot.mavlink.messages import Attitude, LocalPosition, OdometryMessage
from uav_recon.types.frames import FloatArray
from uav_recon.types.vehicle import ReportedPoses, TurnRates

_RATES = 32  #: internal: turn rates that are published together: a second
_OLD_POSE_S = 1.0  #: reject: a pose of the autopilot whose stamp is farther from now, past or future


class AutopilotMeasurements:
    """Keeps the newest measurements. A message without a stamp on our clock is not used."""

    def __init__(self, clock: LinkClock, navigation: Navigation) -> None:
        self._clock = clock
        self._navigation = navigation
        self._rates: deque[tuple[float, FloatArray]] = deque(maxlen=_RATES)
        self._returned_s: float | None = None  # stamp of the newest turn rate that was returned

    def update(self, message: Attitude | LocalPosition | OdometryMessage, now_s: float, duplicate: bool) -> None:
        """Process a message.

        duplicate: its pose is not used, as it may be of either of two autopilots.
        """
        if isinstance(message, Attitude):
            self._keep_rate(message, now_s)
        if isinstance(message, OdometryMessage):
            stamp_s = self._clock.stamp_of_us_s(message.boot_us, now_s)
        else:
            stamp_s = self._clock.stamp_s(message.boot_ms, now_s)
        if stamp_s is not None and abs(now_s - stamp_s) <= _OLD_POSE_S and not duplicate:
            self._navigation.add_message(message, min(stamp_s, now_s))

    def turn_rates(self) -> TurnRates | None:
        """Return the newest turn rates of the autopilot on our clock, None if nothing is new.

        Each value also holds those before it, because its reader may miss one.
        """
        if not self._rates or self._rates[-1][0] == self._returned_s:
            return None
        self._returned_s = self._rates[-1][0]
        return TurnRates(np.array([stamp_s for stamp_s, _ in self._rates]), np.array([rate for _, rate in self._rates]))

    def reported_poses(self) -> ReportedPoses | None:
        """Return the newest poses of an autopilot that navigates by itself, None if nothing is new."""
        return self._navigation.reported()

    def _keep_rate(self, message: Attitude, now_s: float) -> None:
        """Keep a turn rate with its stamp on our clock, if that is known."""
        stamp_s = None if message.rate_radps is None else self._clock.measured_s(message.boot_ms, now_s)
        if message.rate_radps is not None and stamp_s is not None and (not self._rates or stamp_s > self._rates[-1][0]):
            self._rates.append((stamp_s, message.rate_radps))
