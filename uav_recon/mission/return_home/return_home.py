"""Return home: the shortest known-free path, or back along the breadcrumbs.

It lands elsewhere if something stands on the pad.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from uav_recon.interfaces import Pending
from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.return_home.landing_site import LandingSite
from uav_recon.mission.trajectory.async_planning import AsyncPlanner, PlanResult
from uav_recon.mission.trajectory.trajectory_execution import TrajectoryExecutor
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import PlanRequest, Viewpoint
from uav_recon.types.trajectory import Setpoint, Trajectory
from uav_recon.types.vehicle import VehicleState

_PLACES = 3  #: land: landing positions that are tried; then home is the least bad
_JUDGED_M = 2.0  #: plan: from farther away, level, no obstacle is recognised: noise of a floor at a flat angle looks like one
_REFUSED = 3  #: land: elsewhere than at home, after the guard or the map stopped more paths than this without progress
_PROGRESS_M = 1.0  #: plan: stops do not count once the vehicle is nearer to home by this than at their first
_QUICK_S = 2.0  #: plan: the way home is planned again if a higher speed is allowed for this time and _WORTH_S remain
_TURN_RAD = math.radians(30.0)  #: plan: a way home that begins with a larger turn is flown after that turn, on the spot
_LEFT_M = 0.1  #: plan: it begins within this distance
_WORTH_S = 8.0  #: plan: with less time left a higher speed saves nothing


class ReturnHome:
    """Brings the vehicle once over the pad, or over another position if the pad is occupied.

    no_path: no path home is known. If the breadcrumbs give none either, or the vehicle was stopped too often, it goes to the
    nearest floor that is good to land on. lost: why it lands where it is, over such a floor or because there is none.
    """

    def __init__(self, executor: TrajectoryExecutor, planner: AsyncPlanner, log: MissionLog, site: LandingSite) -> None:
        self._executor = executor
        self._planner = planner
        self._log = log
        self._site = site
        self._place = site.home
        self._bad = tuple[FloatArray, ...]()
        self._pending_plan: Pending[PlanResult] | None = None
        self._refused = 0
        self._nearest_m = math.inf  # distance from home when stops were first counted
        self._looks = self._turned = False
        # speed limit when planned, and when no higher one was last set
        self._planned_mps = math.inf
        self._slow_s = -math.inf
        self.en_route = self.no_path = False
        self._aside: Reason | None = None
        self.lost: Reason | None = None

    def interrupt(self) -> None:
        """Drop the pending request, because the phase has changed."""
        self._pending_plan = None

    def begin_again(self) -> None:
        """Plan the path home again, because the map is new."""
        self._pending_plan = None
        self.en_route = False
        self.no_path = False

    def replan(self, here_m: FloatArray) -> None:
        """Plan again after the guard or the map stopped the vehicle at here_m (3,), a few times.

        Except after the first stop, it looks round before: the space ahead may not have been seen lately. On a long way home,
        stops with progress in between are not counted together.
        """
        if self.en_route:
            self.en_route = False
            left_m = float(np.linalg.norm((here_m - self._site.home)[:2]))
            if self._aside is None and left_m < self._nearest_m - _PROGRESS_M:
                self._refused, self._nearest_m = 0, left_m
            self._refused = self._refused + 1
            self._looks = 1 < self._refused <= _REFUSED

    def has_arrived(self, now_s: float) -> bool:
        """Return True if it is over the landing position."""
        return self.en_route and self._executor.track.has_arrived(now_s)

    def step(self, now_s: float, vehicle: VehicleState, voxels: VoxelMap, along_breadcrumbs: bool) -> None:
        """Plan at rest, then fly; plan again if the landing position turns out to be occupied."""
        track = self._executor.track
        if self.en_route:
            self._watch(now_s, vehicle, voxels)
            return
        if not track.at_rest(now_s):
            return
        if self._refused > _REFUSED:
            self._give_up(Reason(ReasonCode.RETURN_STOPPED, (self._refused,)))
        if self._looks:
            self._looks = False
            self._executor.look_round(now_s, vehicle, views=0)
            return
        if self._pending_plan is None:
            self._planned_mps = vehicle.max_speed_mps
            self._pending_plan = self._request_plan(track.end_setpoint(vehicle), voxels, along_breadcrumbs)
        if self._pending_plan is None or not self._pending_plan.done():
            return
        plan = self._pending_plan.result()
        self._pending_plan = None
        if isinstance(plan.motion, Trajectory):
            turn_rad = _first_turn_rad(plan.motion)
            self._turned = not self._turned and abs(turn_rad) > _TURN_RAD
            if self._turned:
                self._executor.turn(now_s, vehicle, turn_rad, views=0)
                return
            self.en_route = True
            self._executor.fly(dataclasses.replace(plan.motion, views_s=np.zeros(0)), now_s)  # no view is taken at home
            return
        self._log.refusal(now_s, plan.motion)
        if along_breadcrumbs or self._aside:
            self._give_up(Reason(ReasonCode.NO_WAY_BACK, details=(plan.motion,)))
        else:
            self.no_path = True

    def _request_plan(self, rest: Setpoint, voxels: VoxelMap, along_breadcrumbs: bool) -> Pending[PlanResult] | None:
        """Start planning; None if nothing is left to try."""
        track, here_m = self._executor.track, rest.position_m
        if self._aside:
            place = None if self._site.is_below(voxels, here_m) else self._site.near(voxels, here_m, self._bad)
        else:
            home = along_breadcrumbs or not (self._bad or self._is_near(self._site.home))
            place = self._site.home if home else self._site.choose(voxels, self._bad)
        if place is None:
            self.lost = self._aside
            return None
        self._place = place
        goal = Viewpoint(place, rest.yaw_rad, rest.camera_pitch_down_rad)
        request, identifier = PlanRequest(voxels, None, here_m, rest.yaw_rad, 0), track.next_identifier()
        if along_breadcrumbs and not self._aside:
            return self._planner.way_back(request, rest, track.way_back(goal.position_world), goal, identifier)
        level = np.array([*place[:2], min(place[2], here_m[2])])  # a climb would lead to where the camera did not look lately
        return self._planner.way_home(request, rest, dataclasses.replace(goal, position_world=level), identifier)

    def _give_up(self, reason: Reason) -> None:
        """Give up home: go to another landing site, and after that nowhere else."""
        if self._aside:
            self.lost = self._aside
        else:
            self._aside = reason
            self._refused = _REFUSED
            self._log.aborted = self._log.aborted or reason

    def _watch(self, now_s: float, vehicle: VehicleState, voxels: VoxelMap) -> None:
        """Brake and plan again if the path is blocked, or the landing position is occupied.

        The latter only while other positions are left to try.
        """
        resting = self._executor.track.at_rest(now_s)
        if not resting and self._executor.brake_if_blocked(now_s, voxels):
            self.replan(vehicle.world_from_body.translation_m)
        elif resting and not self.has_arrived(now_s):
            self._log.refusal(now_s, Reason(ReasonCode.HELD_ON_WAY_HOME))
            self._executor.hold(now_s, vehicle)
            self.replan(vehicle.world_from_body.translation_m)
        elif len(self._bad) < _PLACES and self._is_near(self._place) and self._site.is_occupied(voxels, self._place):
            self._bad = (*self._bad, self._place)
            x, y, _ = self._place.tolist()
            self._log.refusal(now_s, Reason(ReasonCode.LANDING_SITE_OCCUPIED, (x, y)))
            self.en_route = False
            self._executor.brake(now_s)
        elif self._goes_faster(now_s, vehicle):
            self.en_route = False
            self._executor.brake(now_s)

    def _goes_faster(self, now_s: float, vehicle: VehicleState) -> bool:
        """Return True if a higher speed is allowed than at planning time, and much time is left."""
        self._slow_s = now_s if vehicle.max_speed_mps <= self._planned_mps else self._slow_s
        return now_s - self._slow_s >= _QUICK_S and self._executor.track.remaining_s(now_s) >= _WORTH_S

    def _is_near(self, place: FloatArray) -> bool:
        """Return True if obstacles at a position can be recognised from here."""
        return math.hypot(*(place - self._executor.track.position_world)[:2].tolist()) <= _JUDGED_M


def _first_turn_rad(trajectory: Trajectory) -> float:
    """Return by how much a trajectory turns before it leaves its start.

    While it turns there, it may move by centimetres in any direction, and the camera has not seen all of them lately.
    """
    moved_m = np.linalg.norm(trajectory.position_m - trajectory.position_m[0], axis=1)
    left = np.flatnonzero(moved_m > _LEFT_M)
    return float(trajectory.yaw_rad[left[0] if len(left) else -1] - trajectory.yaw_rad[0])
