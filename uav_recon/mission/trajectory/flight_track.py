"""Track of the flight: where the vehicle has been, and its present trajectory."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.pose import Pose
from uav_recon.types.trajectory import Setpoint, Trajectory
from uav_recon.types.vehicle import VehicleState

BREADCRUMB_M = 0.2  #: internal: distance between breadcrumbs
ARRIVED_M = 0.15  #: plan: farther from the trajectory's end the vehicle is not at rest there
ASTRAY_M = 0.5  #: plan: farther off the trajectory no view is taken; larger than the lag, smaller where the pilot holds
ASTRAY_RAD = 0.6  #: plan: the same for the heading
LATE_S = 5.0  #: plan: a vehicle that is still away after this counts as at rest: waiting brings it no nearer
THERE_M = 0.3  #: land: no landing at a position that is farther away


@dataclass(frozen=True, slots=True)
class Departure:
    """Start of the next motion.

    At rest (flying is None), or on a trajectory that is left in motion at ``leave_s``.
    """

    setpoint: Setpoint
    flying: Trajectory | None = None
    leave_s: float = -np.inf


class FlightTrack:
    """The current trajectory, the path flown until now, and the breadcrumbs back to the pad."""

    def __init__(self, camera_pitch_down_rad: float) -> None:
        self.trajectory: Trajectory | None = None
        self.path_length_m = 0.0
        self.breadcrumbs: list[FloatArray] = []
        self._pitch_down_rad = camera_pitch_down_rad
        self.position_world: FloatArray = np.zeros(3)
        self._yaw_rad = 0.0
        self._placed = False
        self._identifier = 0

    def next_identifier(self) -> int:
        """Return a new trajectory number."""
        self._identifier += 1
        return self._identifier

    @property
    def world_from_body(self) -> Pose:
        """Position and heading of the vehicle."""
        return Pose.from_yaw(self._yaw_rad, self.position_world)

    def follow(self, vehicle: VehicleState) -> None:
        """Record the vehicle's position."""
        position = vehicle.world_from_body.translation_m
        if self._placed and vehicle.armed:
            self.path_length_m += float(np.linalg.norm(position - self.position_world))
        self.position_world = position
        self._yaw_rad = vehicle.world_from_body.yaw_rad()
        self._placed = True
        if vehicle.armed and (not self.breadcrumbs or np.linalg.norm(position - self.breadcrumbs[-1]) > BREADCRUMB_M):
            self.breadcrumbs.append(position.copy())  # a copy, because the received record may not live as long

    def at_rest(self, now_s: float) -> bool:
        """Return True if the trajectory has ended and the vehicle is at its end.

        Also True if the vehicle had LATE_S to get there.
        """
        if self.trajectory is None:
            return False
        over_s = now_s - self.trajectory.start_s - self.trajectory.duration_s
        return over_s >= LATE_S or (over_s >= 0.0 and self._away_m(self.trajectory) <= ARRIVED_M)

    def has_arrived(self, now_s: float) -> bool:
        """Return True if it is at rest at the trajectory's end.

        A vehicle that its pilot holds on the way comes to rest elsewhere.
        """
        return self.trajectory is not None and self.at_rest(now_s) and self._away_m(self.trajectory) <= THERE_M

    def is_on_track(self, now_s: float) -> bool:
        """Return True if the vehicle's position and heading are those of the trajectory now.

        Then what a view has to show is in front of it.
        """
        if self.trajectory is None:
            return False
        there = self.trajectory.setpoint_at(now_s)
        turned_rad = math.remainder(there.yaw_rad - self._yaw_rad, math.tau)
        return float(np.linalg.norm(there.position_m - self.position_world)) <= ASTRAY_M and abs(turned_rad) <= ASTRAY_RAD

    def _away_m(self, trajectory: Trajectory) -> float:
        return float(np.linalg.norm(trajectory.position_m[-1] - self.position_world))

    def remaining_s(self, now_s: float) -> float:
        """Return the seconds until the trajectory comes to rest; 0 without one."""
        if self.trajectory is None:
            return 0.0
        return max(self.trajectory.start_s + self.trajectory.duration_s - now_s, 0.0)

    def departure(self, leave_s: float, vehicle: VehicleState) -> Departure:
        """Return the trajectory's state at that instant, or rest if it will have ended by then."""
        if self.trajectory is None or self.remaining_s(leave_s) <= 0.0:
            return Departure(self.end_setpoint(vehicle))
        return Departure(self.trajectory.setpoint_at(leave_s), self.trajectory, leave_s)

    def end_setpoint(self, vehicle: VehicleState) -> Setpoint:
        """Return the setpoint held now: the end of the trajectory.

        Without a trajectory it is the position where the vehicle comes to rest.
        """
        if self.trajectory is None:
            return self.hold_here(vehicle)
        end = self.trajectory.setpoint_at(self.trajectory.start_s + self.trajectory.duration_s)
        return Setpoint.hold(end.position_m, end.yaw_rad, end.camera_pitch_down_rad)

    def hold_here(self, vehicle: VehicleState) -> Setpoint:
        """Return a hold where the pilot brings the vehicle to rest.

        A motion that begins there begins without a gap.
        """
        pose = vehicle.world_from_rest or vehicle.world_from_body
        return Setpoint.hold(pose.translation_m, pose.yaw_rad(), self._pitch_down_rad)

    def way_back(self, home_world: FloatArray) -> tuple[FloatArray, ...]:
        """Return the breadcrumbs from here to a position (3,) over the pad, newest first.

        Loops and the climb to that position are cut out.
        """
        crumbs = np.array(self.breadcrumbs).reshape(-1, 3)
        there = _near(crumbs, home_world)
        left = crumbs[there[0] if len(there) else 0 :]
        way: list[FloatArray] = []
        while len(left):
            way.append(left[-1])
            near = _near(left[:-1], left[-1])
            left = left[: near[0] + 1 if len(near) else -1]
        return tuple(way)


def _near(crumbs: FloatArray, place_m: FloatArray) -> IntArray:
    """Return the crumbs (N, 3) at about a position (3,), as indices, oldest first."""
    off_m = crumbs - place_m
    return np.flatnonzero(np.einsum("ij,ij->i", off_m, off_m) <= (1.5 * BREADCRUMB_M) ** 2)
