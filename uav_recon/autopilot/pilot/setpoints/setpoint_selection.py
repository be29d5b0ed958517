"""Setpoint selection: the motion that is proposed to the guard.

It is the mission's, the pilot's own path back or aside, or none, which brakes and holds.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque

import numpy as np

from uav_recon.autopilot.pilot.hull_geometry import HullGeometry
from uav_recon.autopilot.pilot.setpoints.breadcrumb_retreat import Breadcrumbs
from uav_recon.autopilot.pilot.setpoints.flown_views import FlownViews, way_down
from uav_recon.autopilot.pilot.setpoints.obstacle_evasion import ObstacleEvasion
from uav_recon.autopilot.pilot.setpoints.setpoint_blending import SetpointBlender
from uav_recon.autopilot.pilot.situation.situation import Situation
from uav_recon.safety.failsafe_precedence import FailsafeAction
from uav_recon.safety.guard import ClearedSetpoint, Guard, GuardInputs, SetpointProposal
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Refusal, Setpoint, Trajectory

#: land: this many paths back were refused, each from rest; fewer may be due to a late pose or a late step of ours
_MAX_RETREAT_PATHS = 3
_SETTLES_S = 1.0  #: retreat: pause after a refused path, until the vehicle rests too: it follows its setpoints late
#: land: an obstacle this close in front of the hull where a path back is refused is permanent; no other is tried
_STANDS_M = 0.3
#: hold: deviation beyond or beside the newest setpoint, level, in _SOON_S: a push; undisturbed at most 0.17 m
_MAX_DEVIATION_M = 0.35
_SOON_S = 0.3  #: hold: the deviation is predicted for this time: a push grows until setpoints no longer lead on
_PACED_S = 0.2  #: hold: the deviation is predicted by its trend over this time
_LED_MPS = 0.2  #: hold: with slower setpoints the present deviation counts: at a hold the vehicle swings
_LONGEST_AGE_S = 0.1  # max. age of a setpoint that is extrapolated by its velocity
#: retreat: share of the hover height: the first breadcrumb this high ends the climb, and no way back leads below it
_HOVER_SHARE = 0.9
_LIFTED_M = 0.2  #: retreat: a climb that still knew its place at this height can go back down to it


class SetpointSelector:
    """Selects the setpoint and records the breadcrumbs.

    ``blocked``: why there is no path back or aside any more, None while there is one. ``moves``: the newest setpoint is of a
    motion, and not of a hold. A trajectory stopped by a sudden obstacle or a push, and each step aside, counts as a refusal.
    """

    def __init__(self, guard: Guard, situation: Situation, hull: HullGeometry) -> None:
        self._guard = guard
        self._situation = situation
        self._hover_height_m = hull.hover_height_m
        self._crumbs = Breadcrumbs()
        self._views = FlownViews()
        self._climbed = self._lifted = False
        self._flown: Setpoint | None = None  # the newest setpoint that was sent
        self._flown_s = -math.inf
        self._off: deque[tuple[float, float]] = deque()  # (instant, metres) off its path
        self._braking = False  # from a refusal to rest: nothing new is flown in between
        self._way_back: Trajectory | None = None
        self._refused_ways = 0
        self._refused_s = -math.inf
        self._refused_for: Reason | None = None
        self._blended: Trajectory | None = None  # the trajectory that the handover leads to
        self._handover: SetpointBlender | None = None
        self._aside: Trajectory | None = None
        self._giving = False  # evasion is active
        self._evasion = ObstacleEvasion(guard, vehicle_radius_m=hull.vehicle_radius_m)
        self.blocked: Reason | None = None
        self.moves = False

    @property
    def at_rest(self) -> bool:
        """True if the newest setpoint is at rest."""
        return self._flown is None or not np.any(self._flown.velocity_mps)

    @property
    def newest_setpoint(self) -> Setpoint | None:
        """The newest setpoint that was sent; None before the first."""
        return self._flown

    @property
    def odom_from_rest(self) -> Pose | None:
        """Pose where braking from the newest setpoint ends; None before the first."""
        if self._flown is None:
            return None
        (x, y, z), (vx, vy, vz) = self._flown.position_m.tolist(), self._flown.velocity_mps.tolist()
        stopping_point_m = self._guard.envelope.stopping_point((x, y, z), (vx, vy, vz))
        return Pose.from_yaw(self._flown.yaw_rad, np.array(stopping_point_m))

    @property
    def refusals(self) -> int:
        """Number of refusals since the start."""
        return self._guard.refusals.total

    @property
    def has_views(self) -> bool:
        """True once the vehicle has known its place in the air: there are views to go back to."""
        return self._climbed or self._lifted

    def was_at(self, odom_from_body: Pose) -> None:
        """Record a position in flight that is not on the path back."""
        self._crumbs.drop(odom_from_body)
        self._views.add(odom_from_body)
        height_m = float(odom_from_body.translation_m[2])
        self._lifted = self._lifted or (height_m >= _LIFTED_M and self._situation.poses.unsure is None)
        self._climbed = self._climbed or height_m >= _HOVER_SHARE * self._hover_height_m
        self._way_back = None
        self._refused_ways = 0

    def takeoff_fault(self, now_s: float) -> Reason | None:
        """Return why the way up to the hover height is not free, None if it is."""
        return self._guard.takeoff_fault(self._situation.guard_inputs(now_s), self._hover_height_m)

    def update_evasion(self) -> None:
        """Read the sudden obstacle in the newest depth frame. Call it every step in the air."""
        surroundings = self._situation.surroundings
        self._evasion.update(surroundings.sudden_obstacle, surroundings.ghost_s)

    def rebase(self, now_s: float, rest_s: float) -> None:
        """Reset after a jump of odom or at the start of a flight: all earlier motion is void."""
        self._guard.rebase(self._situation.guard_inputs(now_s), rest_s)
        self._flown = None
        self._crumbs.forget()
        self._views.forget()
        self._climbed = self._lifted = False
        self._situation.mission.reject_trajectory()
        self._way_back = None
        self._refused_ways = 0
        self._aside = None
        self.blocked = None

    def select(self, action: FailsafeAction, now_s: float) -> tuple[ClearedSetpoint, Refusal | None]:
        """Return the guard's answer for this instant. A rejected trajectory is not proposed again.

        While the place is uncertain, a retreat leads back through the views of the flight.
        """
        inputs = self._situation.guard_inputs(now_s)
        self.moves = False
        before, self._giving = self._giving, action <= FailsafeAction.HOLD and self._is_evading(inputs)
        if self._giving:
            cleared, refusal = self._give_way(inputs)
            if not before:
                self._turn_down()
                refusal = Refusal(self._evasion.why(), cleared.setpoint)
        elif action is FailsafeAction.FLY:
            cleared, refusal = self._fly(inputs)
        elif action is FailsafeAction.RETREAT:
            cleared, refusal = self._retreat(inputs)
        else:
            cleared, refusal = self._guard.clear(None, inputs)
        self._flown = cleared.setpoint
        self._flown_s = now_s
        self.moves = self.moves and refusal is None
        return cleared, refusal

    def _fly(self, inputs: GuardInputs) -> tuple[ClearedSetpoint, Refusal | None]:
        trajectory = self._situation.mission.trajectory
        self._braking = self._braking and not self.at_rest
        if trajectory is None or self._braking:
            return self._guard.clear(None, inputs)
        off_m = self._soon_off_its_way_m(inputs)
        astray = off_m > _MAX_DEVIATION_M
        cleared, refusal = self._guard.clear(None if astray else self._proposal(trajectory, inputs.now_s, False), inputs)
        if astray:  # pushed and led outwards, it would be over the fence before it stops
            refusal = Refusal(Reason(ReasonCode.OFF_PATH, (off_m,)), cleared.setpoint)
            self._guard.refusals.add()
        if refusal is not None:
            self._braking = True
            self._situation.mission.reject_trajectory()
        return cleared, refusal

    def _soon_off_its_way_m(self, inputs: GuardInputs) -> float:
        """Return the predicted deviation from the path (m).

        It is extrapolated, because setpoints would lead the vehicle on until a push has moved it. At a hold they do not lead
        it, and it swings, so the present deviation is returned.
        """
        now_s, off_m = inputs.now_s, self._path_deviation_m(inputs)
        self._off.append((now_s, off_m))
        while now_s - self._off[0][0] > _PACED_S:
            self._off.popleft()
        begun_s, begun_m = self._off[0]
        led = self._flown is not None and float(np.linalg.norm(self._flown.velocity_mps)) > _LED_MPS
        if not led or now_s - begun_s < 0.5 * _PACED_S:
            return off_m
        return off_m + _SOON_S * max((off_m - begun_m) / (now_s - begun_s), 0.0)

    def _path_deviation_m(self, inputs: GuardInputs) -> float:
        """Return the level deviation (m) beyond or beside the setpoint.

        A vehicle behind its setpoints is late, and not pushed.
        """
        if self._flown is None:
            return 0.0
        (x, y, _), (vx, vy, _) = self._flown.position_m.tolist(), self._flown.velocity_mps.tolist()
        off_x_m, off_y_m, speed_mps = inputs.position_m[0] - x, inputs.position_m[1] - y, math.hypot(vx, vy)
        if speed_mps > 0.0:
            ux, uy = vx / speed_mps, vy / speed_mps
            late_m = min(off_x_m * ux + off_y_m * uy, 0.0)
            off_x_m, off_y_m = off_x_m - late_m * ux, off_y_m - late_m * uy
        return math.hypot(off_x_m, off_y_m)

    def _is_evading(self, inputs: GuardInputs) -> bool:
        """Return True if evasion is active: for a sudden obstacle, or during a step aside."""
        if self._aside is not None and self._evasion.over(self._aside, inputs.now_s):
            self._aside = None
            self._turn_down()
        return self._aside is not None or self._evasion.must_stop(inputs.now_s)

    def _give_way(self, inputs: GuardInputs) -> tuple[ClearedSetpoint, Refusal | None]:
        """Stop, and from rest step aside if the obstacle approaches."""
        if self._aside is not None:
            aside = dataclasses.replace(self._proposal(self._aside, inputs.now_s, True), evading=True)
            cleared, refusal = self._guard.clear(aside, inputs)
            if refusal is not None:
                self.blocked = Reason(ReasonCode.EVASION_BLOCKED, details=(refusal.reason,))
            return cleared, refusal
        cleared, _ = self._guard.clear(None, inputs)
        if not np.any(cleared.setpoint.velocity_mps):
            way = self._evasion.step_aside(cleared.setpoint, inputs)
            self._aside = way if isinstance(way, Trajectory) else None
            self.blocked = way if isinstance(way, Reason) else self.blocked
        return cleared, None

    def _turn_down(self) -> None:
        """Reject the mission's trajectory, so that it plans again from where the vehicle is."""
        self._guard.refusals.add()
        self._situation.mission.reject_trajectory()

    def _retreat(self, inputs: GuardInputs) -> tuple[ClearedSetpoint, Refusal | None]:
        """Fly from rest back along the breadcrumbs, or through the views, and hold where they begin.

        The retreat ends, at rest, when several paths were refused, or the first time that an obstacle stands in one.
        """
        way, now_s = self._way_back, inputs.now_s
        if way is None or self.blocked:
            cleared, _ = self._guard.clear(None, inputs)
            rest = cleared.setpoint
            if np.any(rest.velocity_mps) or now_s - self._refused_s < _SETTLES_S:
                return cleared, None
            if self._refused_ways >= _MAX_RETREAT_PATHS:
                self.blocked = Reason(ReasonCode.RETREAT_BLOCKED, details=(self._refused_for,) if self._refused_for else ())
                return cleared, None
            self._way_back = self._path_back(rest, inputs)
            return cleared, None
        proposal = self._proposal(way, now_s, True)
        cleared, refusal = self._guard.clear(proposal, inputs)
        if refusal is not None:
            self._way_back = None
            self._refused_for = refusal.reason
            self._refused_s = now_s
            self._refused_ways += _MAX_RETREAT_PATHS if _stands_before(proposal.setpoint, inputs) else 1
        return cleared, refusal

    def _path_back(self, rest: Setpoint, inputs: GuardInputs) -> Trajectory:
        now_s, height_m = inputs.now_s, _HOVER_SHARE * self._hover_height_m
        speed_mps, yaw_rate_radps = self._guard.bounds.retreat_speed_mps, self._guard.envelope.max_yaw_rate_radps
        if self._situation.poses.unsure is not None:
            self._turn_down()
            if not self._climbed:
                return way_down(rest, now_s, speed_mps, inputs.map_epoch)
            seeing_yaw_rad = self._situation.mission.seeing_yaw_rad(now_s)
            return self._views.way_back(rest, height_m, now_s, speed_mps, yaw_rate_radps, inputs.map_epoch, seeing_yaw_rad)
        seeing = inputs.ahead is not None and now_s - inputs.ahead.stamp_s <= self._guard.bounds.depth_timeout_s
        return self._crumbs.way_back(rest, height_m, now_s, speed_mps, inputs.map_epoch, seeing)

    def _proposal(self, trajectory: Trajectory, now_s: float, retreating: bool) -> SetpointProposal:
        if self._blended is not trajectory:
            self._blended = trajectory
            age_s = min(now_s - self._flown_s, _LONGEST_AGE_S)
            self._handover = SetpointBlender(self._flown, age_s, trajectory, now_s) if self._flown else None
        sample = trajectory.setpoint_at(now_s)
        self.moves = bool(np.any(sample.velocity_mps)) or sample.yaw_rate_radps != 0.0
        wanted = self._handover.apply(sample, now_s) if self._handover else sample
        return SetpointProposal(wanted, trajectory.identifier, trajectory.map_epoch, retreating)


def _stands_before(setpoint: Setpoint, inputs: GuardInputs) -> bool:
    """Return True if depth, valid or not, shows something close in the hull's path."""
    speed_mps = float(np.linalg.norm(setpoint.velocity_mps))
    if inputs.ahead is None or speed_mps == 0.0:
        return False
    return inputs.ahead.room_m(inputs.body_from_odom @ setpoint.velocity_mps / speed_mps) < _STANDS_M
