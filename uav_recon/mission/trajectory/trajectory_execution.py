"""Trajectory execution: every change of the flown trajectory goes through here."""

from __future__ import annotations

import dataclasses
import math

from uav_recon.interfaces import MotionPlannerInterface
from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.mission.trajectory.view_schedule import ViewSchedule
from uav_recon.types.maps import VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Trajectory
from uav_recon.types.vehicle import VehicleState


class TrajectoryExecutor:
    """Changes the trajectory and, with it, the views to capture."""

    def __init__(self, motion: MotionPlannerInterface, track: FlightTrack, schedule: ViewSchedule, log: MissionLog) -> None:
        self._motion = motion
        self._schedule = schedule
        self._log = log
        self.track = track
        self.map_epoch = 0  # map epoch of what is flown from now on
        self._braking: Trajectory | None = None
        self._checked_revision = -1

    def at_rest(self, now_s: float) -> bool:
        """Return True if the trajectory is flown and its views are taken."""
        return self.track.at_rest(now_s) and not self._schedule.waiting(now_s)

    def fly(self, trajectory: Trajectory, now_s: float) -> None:
        """Fly a trajectory from rest, from now on."""
        self.follow(dataclasses.replace(trajectory, start_s=now_s, map_epoch=self.map_epoch), now_s)

    def follow(self, trajectory: Trajectory, leave_s: float) -> None:
        """Fly a trajectory that follows the present motion until ``leave_s``."""
        self.track.trajectory = trajectory
        self._checked_revision = -1
        self._schedule.expect(trajectory, leave_s)

    def hold(self, now_s: float, vehicle: VehicleState) -> None:
        """Hold where the vehicle comes to rest: its pilot has stopped it there."""
        here, identifier = self.track.hold_here(vehicle), self.track.next_identifier()
        self.fly(self._motion.plan_line(here, here.position_m, here.yaw_rad, now_s, identifier), now_s)

    def look_round(self, now_s: float, vehicle: VehicleState, views: int) -> float:
        """Turn once on the spot with a number of views; return the duration (s)."""
        return self.turn(now_s, vehicle, math.tau, views)

    def turn(self, now_s: float, vehicle: VehicleState, total_yaw_rad: float, views: int) -> float:
        """Turn on the spot with a number of views; return the duration (s)."""
        start, identifier = self.track.end_setpoint(vehicle), self.track.next_identifier()
        turn = self._motion.plan_turn(start, now_s, total_yaw_rad, views, identifier)
        self.fly(turn, now_s)
        return turn.duration_s

    def brake(self, now_s: float) -> None:
        """Come to rest along the present path; views beyond it are given up."""
        trajectory = self.track.trajectory
        if trajectory is None or self.track.at_rest(now_s):
            return
        self._braking = self._motion.plan_stop(trajectory, now_s, self.track.next_identifier())
        self.track.trajectory = self._braking
        self._schedule.cancel_after(now_s)

    def brake_if_blocked(self, now_s: float, voxels: VoxelMap) -> bool:
        """Check the rest of the path against a newer map, and brake if it is blocked.

        It is checked once for each map. Return True if it brakes.
        """
        trajectory = self.track.trajectory
        if trajectory is None or trajectory is self._braking or voxels.revision == self._checked_revision:
            return False
        self._checked_revision = voxels.revision
        if self._motion.is_still_clear(trajectory, now_s, voxels):
            return False
        self._log.refusal(now_s, Reason(ReasonCode.MAP_BLOCKS_PATH))
        self.brake(now_s)
        return True
