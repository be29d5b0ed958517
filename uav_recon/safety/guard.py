"""Guard: the last check before the wire; denies by default, only maker of ClearedSetpoint.

Every cleared setpoint keeps one invariant: it lies inside the envelope and in known-free space, and so does the point where
braking from it would end. So the guard can answer any next proposal with a brake that stays there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.safety.depth_age_limit import depth_limit_s
from uav_recon.safety.envelope import Envelope, Vec3
from uav_recon.safety.free_space_check import FreeSpaceCheck
from uav_recon.safety.obstacle_speed_limit import ForwardDepth, Margins, fastest_mps
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.safety.refusals import RefusalCounter
from uav_recon.safety.setpoint_continuity import ClearedMotion, ContinuityCheck
from uav_recon.safety.sight_speed_limit import SightSpeedLimit, entered_points
from uav_recon.safety.takeoff_view import takeoff_view_fault
from uav_recon.types.frames import FloatArray
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Refusal, Setpoint

_MAKER = object()
_STILL_MPS = 0.02  #: refuse: a faster motion without fresh depth and a free path in it; a slower one is a hold
_FUTURE_S = 0.1  #: refuse: pose, intent or depth stamped later than the clock by this: its stamp is of another boot


class ClearedSetpoint:
    """A setpoint that passed the guard.

    Only the guard can make one, and the link sends nothing else.
    """

    __slots__ = ("_setpoint",)

    def __init__(self, setpoint: Setpoint, maker: object) -> None:
        if maker is not _MAKER:
            raise TypeError("a ClearedSetpoint is made by Guard.clear() alone")
        self._setpoint = setpoint

    @property
    def setpoint(self) -> Setpoint:
        """The setpoint that may be sent."""
        return self._setpoint


@dataclass(frozen=True, slots=True, eq=False)
class SetpointProposal:
    """A sample of a motion that was planned on the map of ``map_epoch``.

    retreating: the pilot's own slow path back along breadcrumbs, which needs neither a mission nor depth. evading: out of the
    path of an approaching obstacle, with the speed limit for passing near obstacles.
    """

    setpoint: Setpoint
    trajectory_id: int
    map_epoch: int
    retreating: bool = False
    evading: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class GuardInputs:
    """Inputs of the guard.

    The clock, the newest good pose and its frame, ages (s; infinity for never), the known-free space and the newest depth
    frame, None before the first.
    """

    now_s: float
    position_m: Vec3
    yaw_rad: float
    body_from_odom: FloatArray
    pose_age_s: float
    intent_age_s: float
    map_epoch: int
    free: FreeSpaceCheck | None
    ahead: ForwardDepth | None
    slow: bool = False  # the pose is degraded, or the link is slow
    one_missing_s: float = 0.0  # age of depth that one missing frame causes, 0 while unknown


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardBounds:
    """Limits on the age of inputs, and on the speed without sight (SI).

    silence_way_m: longest path since the mission's last message, including the braking from here. depth_timeout_s: oldest
    depth in motion, unless one missing frame of a slow camera is older. blind_speed_mps: fastest motion where the camera does
    not look, and then only through what it saw lately; if it equals the envelope's speed, neither is required. blind_fresh_s,
    blind_stale_s: ages of the last free sight between which the limit there falls from the envelope's speed to
    blind_speed_mps. retreat_speed_mps: fastest motion on the retreat and with a degraded pose.
    """

    pose_timeout_s: float
    intent_timeout_s: float
    silence_way_m: float
    depth_timeout_s: float
    blind_speed_mps: float
    blind_fresh_s: float
    blind_stale_s: float
    retreat_speed_mps: float
    margins: Margins


class Guard:
    """Clears a proposal, or answers with a brake from the last cleared setpoint to rest."""

    def __init__(self, envelope: Envelope, bounds: GuardBounds, seen_space: RecentlySeenSpace) -> None:
        self.envelope = envelope
        self.bounds = bounds
        self.seen_space = seen_space
        self._sight_limit = SightSpeedLimit(
            full_speed_mps=envelope.max_speed_mps,
            blind_speed_mps=bounds.blind_speed_mps,
            blind_fresh_s=bounds.blind_fresh_s,
            blind_stale_s=bounds.blind_stale_s,
            blind_memory_s=seen_space.memory_s,
        )
        self._last: ClearedMotion | None = None
        self._steps = ContinuityCheck()
        self._rest_until_s = -math.inf
        self._refused: int | None = None
        self.refusals = RefusalCounter()  # episodes: a trajectory rejected at thirty samples in a row counts once

    def clear(self, proposal: SetpointProposal | None, inputs: GuardInputs) -> tuple[ClearedSetpoint, Refusal | None]:
        """Check one sample. Without a proposal the vehicle brakes and holds.

        A Refusal holds the reason why a proposal is not flown. Never raises on numbers. The very first setpoint holds the
        present position (moved inside the envelope).
        """
        fault = None if proposal is None else self._fault(proposal, inputs)
        setpoint = self._brake(inputs) if proposal is None or fault else proposal.setpoint
        refusal = self._count(proposal, fault, setpoint)
        before = self._last
        self._last = _motion_of(setpoint, inputs.now_s)
        self._steps = ContinuityCheck() if before is None else self._steps.after(before, self._last, self.envelope)[0]
        return ClearedSetpoint(setpoint, _MAKER), refusal

    def rebase(self, inputs: GuardInputs, rest_s: float = 1.0) -> None:
        """Forget the last setpoint and what was seen after a jump of odom, and hold for ``rest_s``."""
        self._last = None
        self._rest_until_s = inputs.now_s + rest_s
        self.seen_space.forget()

    def takeoff_fault(self, inputs: GuardInputs, height_m: float) -> Reason | None:
        """Return why the vehicle may not climb, None if column and view are free."""
        here, top = inputs.position_m, (inputs.position_m[0], inputs.position_m[1], height_m)
        if inputs.free is None or inputs.ahead is None:
            return Reason(ReasonCode.TAKEOFF_COLUMN_NOT_SEEN)
        if not (self.envelope.in_column(here) and self.envelope.in_column(top)):
            return Reason(ReasonCode.TAKEOFF_COLUMN_OUTSIDE_FENCE)
        if not inputs.free.admits(here, top):
            return Reason(ReasonCode.TAKEOFF_COLUMN_NOT_FREE)
        return takeoff_view_fault(inputs.ahead.nearby)

    def _fault(self, proposal: SetpointProposal, inputs: GuardInputs) -> Reason | None:
        """Return why a proposal is not flown: the first check that fails, None if all pass."""
        last = self._last
        if not _is_finite(proposal.setpoint):
            return Reason(ReasonCode.SETPOINT_NOT_FINITE)
        if last is None:
            return Reason(ReasonCode.NO_SETPOINT_YET)
        motion = _motion_of(proposal.setpoint, inputs.now_s)
        speed_mps = math.hypot(*motion.velocity_mps)
        stopping_point_m = self.envelope.stopping_point(motion.position_m, motion.velocity_mps)
        return (
            self._pose_fault(proposal, inputs)
            or self._limit_fault(proposal, speed_mps, inputs)
            or self._fence_fault(motion, stopping_point_m)
            or self._steps.after(last, motion, self.envelope)[1]
            or self._space_fault(last, motion, stopping_point_m, inputs)
            or self._depth_fault(motion, speed_mps, proposal.retreating, inputs)
        )

    def _pose_fault(self, proposal: SetpointProposal, inputs: GuardInputs) -> Reason | None:
        """Check that there is a fresh pose, on the map for which the motion was planned."""
        if inputs.now_s < self._rest_until_s:
            return Reason(ReasonCode.POSE_RESET)
        if not -_FUTURE_S <= inputs.pose_age_s <= self.bounds.pose_timeout_s:
            return Reason(ReasonCode.POSE_STALE)
        if proposal.map_epoch != inputs.map_epoch:
            return Reason(ReasonCode.TRAJECTORY_MAP_EPOCH, (proposal.map_epoch, inputs.map_epoch))
        return None

    def _limit_fault(self, proposal: SetpointProposal, speed_mps: float, inputs: GuardInputs) -> Reason | None:
        """Check speed, silence of the mission at this speed, acceleration and yaw rate."""
        wanted, envelope, bounds = proposal.setpoint, self.envelope, self.bounds
        max_speed_mps = bounds.retreat_speed_mps if proposal.retreating or inputs.slow else envelope.max_speed_mps
        if not speed_mps <= (bounds.margins.slow_mps if proposal.evading else max_speed_mps) + 1e-6:
            return Reason(ReasonCode.SPEED_LIMIT, (speed_mps,))
        if not proposal.retreating and self._silent(speed_mps, inputs.intent_age_s):
            return Reason(ReasonCode.MISSION_STALE)
        push_mps2 = math.hypot(*_floats(wanted.acceleration_mps2))
        if not push_mps2 <= envelope.max_acceleration_mps2 + 1e-6:
            return Reason(ReasonCode.ACCELERATION_LIMIT, (push_mps2,))
        if not abs(wanted.yaw_rate_radps) <= envelope.max_yaw_rate_radps + 1e-6:
            return Reason(ReasonCode.YAW_RATE_LIMIT, (wanted.yaw_rate_radps,))
        return None

    def _silent(self, speed_mps: float, intent_age_s: float) -> bool:
        """Return True if the mission is silent for too long at this speed.

        The path flown since the last message, and the braking, must stay within silence_way_m: the faster, the sooner.
        """
        braking_m = speed_mps**2 / (2.0 * self.envelope.max_acceleration_mps2)
        heard = -_FUTURE_S <= intent_age_s <= self.bounds.intent_timeout_s
        return not (heard and speed_mps * intent_age_s + braking_m <= max(self.bounds.silence_way_m, braking_m))

    def _fence_fault(self, motion: ClearedMotion, stopping_point_m: Vec3) -> Reason | None:
        inside = self.envelope.admits(motion.position_m, stopping_point_m)
        return None if inside else Reason(ReasonCode.OUTSIDE_FENCE, motion.position_m)

    def _space_fault(
        self, last: ClearedMotion, motion: ClearedMotion, stopping_point_m: Vec3, inputs: GuardInputs
    ) -> Reason | None:
        """Check the path here and the path to rest, for the whole hull. Unknown space is rejected."""
        if motion.position_m == last.position_m == stopping_point_m:
            return None  # a hold: there is no path to check
        if inputs.free is None:
            return Reason(ReasonCode.NO_FREE_SPACE)
        if inputs.free.map_epoch != inputs.map_epoch:
            return Reason(ReasonCode.FREE_SPACE_MAP_EPOCH, (inputs.free.map_epoch, inputs.map_epoch))
        if not inputs.free.admits(last.position_m, motion.position_m, stopping_point_m):
            return Reason(ReasonCode.NOT_KNOWN_FREE, motion.position_m)
        return None

    def _depth_fault(self, motion: ClearedMotion, speed_mps: float, retreating: bool, inputs: GuardInputs) -> Reason | None:
        """Check the speed by raw depth: towards near obstacles, and outside the camera's view."""
        ahead, bounds = inputs.ahead, self.bounds
        limit_s = depth_limit_s(bounds.depth_timeout_s, inputs.one_missing_s)
        if speed_mps <= _STILL_MPS or (retreating and ahead is None):
            return None
        if ahead is None or not (retreating or -_FUTURE_S <= inputs.now_s - ahead.stamp_s <= limit_s):
            return Reason(ReasonCode.DEPTH_STALE)
        direction = np.array(motion.velocity_mps) / speed_mps
        direction_body = inputs.body_from_odom @ direction
        since_s = min(max(0.0, inputs.now_s - ahead.stamp_s), limit_s)  # a retreat uses an older one too
        room_m = ahead.room_m(direction_body) - speed_mps * since_s
        if not speed_mps <= fastest_mps(room_m, self.envelope.max_acceleration_mps2, bounds.margins, speed_mps):
            return Reason(ReasonCode.OBSTACLE_NEAR, (room_m, speed_mps))
        asked = not retreating and bounds.blind_speed_mps < self.envelope.max_speed_mps
        if not asked or ahead.sees(direction_body) or self.envelope.in_column(motion.position_m):
            return None
        return self._sight_fault(motion, direction, speed_mps, inputs.now_s)

    def _sight_fault(self, motion: ClearedMotion, direction: FloatArray, speed_mps: float, now_s: float) -> Reason | None:
        """Check the speed outside the view by the age of the last free sight.

        It is that of the space that the hull enters until it stands.
        """
        place_m, reach_m = np.array(motion.position_m), self.seen_space.reach_m
        if speed_mps > self.bounds.blind_speed_mps + 1e-6:
            stopping_m = np.array([speed_mps**2 / (2.0 * self.envelope.max_acceleration_mps2)])
            hull = entered_points(place_m[None], direction[None], stopping_m, self.seen_space.radius_m, reach_m)
            limit_mps = self._sight_limit.at(self.seen_space.ages_s(hull[0], now_s)).min()
            return None if speed_mps <= limit_mps + 1e-6 else Reason(ReasonCode.SPEED_OUT_OF_VIEW, (speed_mps,))
        x, y, z = (place_m + direction * reach_m).tolist()
        seen = self.seen_space.saw_free((x, y, z), now_s, direction)
        return None if seen else Reason(ReasonCode.NOT_SEEN_RECENTLY, (x, y, z))

    def _brake(self, inputs: GuardInputs) -> Setpoint:
        """Slow down along the last cleared velocity within the acceleration limit, then hold."""
        last, limit_mps2 = self._last, self.envelope.max_acceleration_mps2
        if last is None:
            known = all(math.isfinite(value) for value in (*inputs.position_m, inputs.yaw_rad))
            place = self.envelope.nearest_inside(inputs.position_m if known else self.envelope.pad_m)
            return Setpoint.hold(np.array(place), inputs.yaw_rad if known else 0.0)
        speed_mps = math.hypot(*last.velocity_mps)
        left_mps = max(speed_mps - limit_mps2 * max(inputs.now_s - last.at_s, 0.0), 0.0)
        along = np.array(last.velocity_mps) / speed_mps if speed_mps > 0.0 else np.zeros(3)
        position = np.array(last.position_m) + along * (speed_mps**2 - left_mps**2) / (2.0 * limit_mps2)
        push = along * -limit_mps2 if left_mps > 0.0 else np.zeros(3)
        return Setpoint(position, along * left_mps, push, last.yaw_rad, 0.0, last.pitch_down_rad)

    def _count(self, proposal: SetpointProposal | None, fault: Reason | None, instead: Setpoint) -> Refusal | None:
        if proposal is None or fault is None:
            self._refused = None
            return None
        if self._refused != proposal.trajectory_id:
            self.refusals.add()
        self._refused = proposal.trajectory_id
        return Refusal(fault, instead)


def _is_finite(wanted: Setpoint) -> bool:
    vectors = (wanted.position_m, wanted.velocity_mps, wanted.acceleration_mps2)
    angles = (wanted.yaw_rad, wanted.yaw_rate_radps, wanted.camera_pitch_down_rad)
    return all(v.shape == (3,) and bool(np.isfinite(v).all()) for v in vectors) and all(map(math.isfinite, angles))


def _motion_of(setpoint: Setpoint, now_s: float) -> ClearedMotion:
    place, velocity = _floats(setpoint.position_m), _floats(setpoint.velocity_mps)
    return ClearedMotion(now_s, place, velocity, setpoint.yaw_rad, setpoint.camera_pitch_down_rad)


def _floats(vector: FloatArray) -> Vec3:
    x, y, z = vector.tolist()
    return x, y, z
