"""Keeps account of the battery: what is left of it for sure, what the way home needs, and why it is the end of a flight."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.mission.battery_gauge import BatteryGaugeFilter
from uav_recon.mission.battery_reserve import LAND_AT, LOW, TAKE_OFF, ConsumptionEstimator, flight_s, min_charge_for
from uav_recon.mission.flight_track import FlightTrack
from uav_recon.mission.return_distance import return_distance_m
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import VehicleState

_LOOK_S = 1.0  # the way home is measured so often
_SLOWER = 0.8  # of what the guard lets pass, that much is planned with
_SLOW_S = 3.0  # nothing fast let pass for so long will stay so; for a moment it is each time that poses and IMU disagree


class BatteryPolicy:
    """One mission's. home_m: place (3,) over the pad; clearance_m: what planned ways keep of anything. hear() in each step."""

    def __init__(self, course: FlightTrack, home_m: FloatArray, clearance_m: float) -> None:
        self._course, self._home_m, self._clearance_m = course, home_m, clearance_m
        self._charge, self._burn = BatteryGaugeFilter(), ConsumptionEstimator()
        self._looked_s, self._way_m, self._pace_mps, self._now_s = -math.inf, 0.0, math.inf, 0.0
        self._quick_s = -math.inf  # when anything was let pass

    def update(self, now_s: float, vehicle: VehicleState, voxels: VoxelMap | None) -> None:
        """The gauge's word, and where the vehicle is: to be called when the course has followed it."""
        self._now_s, self._quick_s = now_s, now_s if vehicle.max_speed_mps == math.inf else self._quick_s
        self._pace_mps = _SLOWER * vehicle.max_speed_mps if now_s - self._quick_s >= _SLOW_S else math.inf
        self._charge.update(now_s, vehicle.battery_fraction, flying=vehicle.armed)
        self._burn.update(now_s, self._charge.left, flying=vehicle.armed)
        if vehicle.armed and now_s - self._looked_s >= _LOOK_S:
            self._looked_s, course = now_s, self._course
            way = np.array([course.position_world, *course.way_back(self._home_m), self._home_m])
            self._way_m = return_distance_m(way, voxels, self._clearance_m)

    @property
    def left(self) -> float:
        """Share that is left for sure; NaN before any was heard."""
        return self._charge.left

    @property
    def lost(self) -> bool:
        """Whether nothing credible was heard for too long."""
        return self._charge.lost(self._now_s)

    @property
    def needed(self) -> float:
        """Share at which it has to turn back: for the way home, and no less than LOW while nothing can be reckoned."""
        need = min_charge_for(flight_s(self._way_m, self._pace_mps), self._burn.per_s(self._now_s))
        return need if self._burn.reckoned(self._now_s) else max(need, LOW)

    def ends(self, starting: bool, flying: bool) -> Reason | None:
        """Why there is no flight, or none any more; None where there is. Of a gauge that never spoke the autopilot is judge."""
        if starting and self.left < TAKE_OFF:
            return Reason(ReasonCode.BATTERY_TAKEOFF, (100.0 * self.left, 100.0 * TAKE_OFF))
        return Reason(ReasonCode.BATTERY_LAND, (100.0 * self.left,)) if flying and self.left <= LAND_AT else None

    def why(self) -> Reason:
        """Why it returns."""
        if self.lost:
            return Reason(ReasonCode.BATTERY_UNKNOWN)
        per_s, home_s = self._burn.per_s(self._now_s), flight_s(self._way_m, self._pace_mps)
        if self.left >= min_charge_for(home_s, per_s):
            return Reason(ReasonCode.BATTERY_RATE_UNKNOWN, (100.0 * self.left,))
        return Reason(ReasonCode.BATTERY_RETURN, (100.0 * self.left, self._way_m, 100.0 * home_s * per_s))
