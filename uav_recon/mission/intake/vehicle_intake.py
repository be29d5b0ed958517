"""Vehicle intake: records the vehicle's position, speed limit and charge."""

from __future__ import annotations

from uav_recon.interfaces import Journal
from uav_recon.mission.battery.battery_policy import BatteryPolicy
from uav_recon.mission.log.speed_limit_log import SpeedLimitLog
from uav_recon.mission.setup.mission_stages import MissionStages
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.types.maps import VoxelMap
from uav_recon.types.vehicle import VehicleState


class VehicleIntake:
    """Passes each state on to track, motion, log of the speed limit and battery policy."""

    def __init__(self, stages: MissionStages, track: FlightTrack, battery: BatteryPolicy, journal: Journal) -> None:
        self._stages = stages
        self._track = track
        self._battery = battery
        self._speed_limit_log = SpeedLimitLog(journal)

    def update(self, now_s: float, vehicle: VehicleState, voxels: VoxelMap | None) -> None:
        """Record a state; the battery policy needs the new position and the map."""
        self._track.follow(vehicle)
        self._stages.motion.set_max_speed(vehicle.max_speed_mps)
        self._stages.retreat.set_max_speed(vehicle.max_speed_mps)
        self._speed_limit_log.update(vehicle)
        self._battery.update(now_s, vehicle, voxels)
