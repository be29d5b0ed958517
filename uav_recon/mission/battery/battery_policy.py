"""Battery policy: certain charge, charge needed for the way home, and end of the flight."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.mission.battery.battery_gauge import BatteryGaugeFilter
from uav_recon.mission.battery.battery_reserve import (
    LAND_AT_SHARE,
    LOW_SHARE,
    TAKE_OFF_SHARE,
    ConsumptionEstimator,
    flight_s,
    min_charge_for,
)
from uav_recon.mission.battery.return_distance import return_distance_m
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import VehicleState

_LOOK_S = 1.0  #: internal: interval at which the path home is measured
_SLOWER_SHARE = 0.8  #: return: expected speed on the way home, of a lower limit of the guard: planned speeds keep below it
#: return: a lower speed limit that lasts longer is expected to stay; brief ones occur when poses and IMU disagree
_SLOW_S = 3.0


class BatteryPolicy:
    """The policy of one mission; call update() in each step.

    home_m: position (3,) over the pad. clearance_m: clearance of planned paths.
    """

    def __init__(self, track: FlightTrack, home_m: FloatArray, clearance_m: float) -> None:
        self._track = track
        self._home_m = home_m
        self._clearance_m = clearance_m
        self._gauge = BatteryGaugeFilter()
        self._consumption = ConsumptionEstimator()
        self._measured_s = -math.inf
        self._return_distance_m = 0.0
        self._expected_speed_mps = math.inf
        self._now_s = 0.0
        self._unlimited_s = -math.inf  # when the guard last had no lower limit

    def update(self, now_s: float, vehicle: VehicleState, voxels: VoxelMap | None) -> None:
        """Read the gauge and the vehicle's position. Call it after FlightTrack.follow."""
        self._now_s = now_s
        self._unlimited_s = now_s if vehicle.max_speed_mps == math.inf else self._unlimited_s
        self._expected_speed_mps = _SLOWER_SHARE * vehicle.max_speed_mps if now_s - self._unlimited_s >= _SLOW_S else math.inf
        self._gauge.update(now_s, vehicle.battery_fraction, flying=vehicle.armed)
        self._consumption.update(now_s, self._gauge.left, flying=vehicle.armed)
        if vehicle.armed and now_s - self._measured_s >= _LOOK_S:
            self._measured_s = now_s
            track = self._track
            way = np.array([track.position_world, *track.way_back(self._home_m), self._home_m])
            self._return_distance_m = return_distance_m(way, voxels, self._clearance_m)

    @property
    def left(self) -> float:
        """Certain remaining share; NaN before the first value."""
        return self._gauge.left

    @property
    def lost(self) -> bool:
        """True if no plausible value was received for too long."""
        return self._gauge.lost(self._now_s)

    @property
    def required_charge(self) -> float:
        """Share at which the vehicle has to turn back.

        It covers the way home, and is at least LOW_SHARE while consumption cannot be estimated.
        """
        need = min_charge_for(flight_s(self._return_distance_m, self._expected_speed_mps), self._consumption.per_s(self._now_s))
        return need if self._consumption.is_reliable(self._now_s) else max(need, LOW_SHARE)

    @property
    def must_return(self) -> bool:
        """True if the charge is needed for the way home.

        False for a gauge that never reported a value: the autopilot decides.
        """
        return self.left < self.required_charge  # NaN compares false

    def takeoff_refusal(self) -> Reason | None:
        """Return why no flight begins, None for nothing.

        For a gauge that never reported a value the autopilot decides.
        """
        if self.left < TAKE_OFF_SHARE:
            return Reason(ReasonCode.BATTERY_TAKEOFF, (100.0 * self.left, 100.0 * TAKE_OFF_SHARE))
        return None

    def landing_reason(self) -> Reason | None:
        """Return why a flight ends where it is, None for nothing."""
        return Reason(ReasonCode.BATTERY_LAND, (100.0 * self.left,)) if self.left <= LAND_AT_SHARE else None

    def return_reason(self) -> Reason:
        """Return why the vehicle returns, as a reason with figures."""
        if self.lost:
            return Reason(ReasonCode.BATTERY_UNKNOWN)
        per_s, home_s = self._consumption.per_s(self._now_s), flight_s(self._return_distance_m, self._expected_speed_mps)
        if self.left >= min_charge_for(home_s, per_s):
            return Reason(ReasonCode.BATTERY_RATE_UNKNOWN, (100.0 * self.left,))
        return Reason(ReasonCode.BATTERY_RETURN, (100.0 * self.left, self._return_distance_m, 100.0 * home_s * per_s))
