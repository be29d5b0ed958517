"""Log of the reasons for a reduced speed.

The report takes from it for how long and why a flight was slow.
"""

from __future__ import annotations

import math

from uav_recon.interfaces import Journal
from uav_recon.types.reason import codes_of
from uav_recon.types.vehicle import VehicleState

_APART_S = 1.0  #: internal: at most one line in this time: reasons may alternate


class SpeedLimitLog:
    """Logs the reason for a reduced speed when its code changes, at most once a second."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._codes: tuple[str, ...] = ()
        self._logged_s = -math.inf

    def update(self, vehicle: VehicleState) -> None:
        """Log the newest reason if it is another one than before."""
        codes = codes_of(vehicle.slow_reason)
        if codes == self._codes or abs(vehicle.stamp_s - self._logged_s) < _APART_S:
            return
        self._codes, self._logged_s = codes, vehicle.stamp_s
        self._journal.speed_limit(vehicle.stamp_s, vehicle.max_speed_mps, vehicle.slow_reason)
