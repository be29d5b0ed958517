"""The last hop before the wire: denies by default, and the only maker of a ClearedSetpoint.

Every cleared setpoint keeps one invariant: it lies inside the envelope, and so does the point where braking from it
would end. So whatever is proposed next, the guard can always answer with a brake that stays inside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.safety.envelope import Envelope, Vec3
from uav_recon.types.frames import FloatArray
from uav_recon.types.trajectory import Refusal, Setpoint, Trajectory

_MAKER = object()
_STEP_SLACK_M = 0.02
_SPEED_SLACK_MPS = 0.05
_YAW_SLACK_RAD = 0.03
_LONGEST_STEP_S = 0.5  # the autopilot gives up on a stream that paused for longer
_REST_MPS = 0.05
_FUTURE_S = 0.1  # a stamp this far ahead of the clock is another boot's


class ClearedSetpoint:
    """A setpoint that passed the guard. Nobody else can make one: the link sends nothing else."""

    __slots__ = ("_setpoint",)

    def __init__(self, setpoint: Setpoint, maker: object) -> None:
        if maker is not _MAKER:
            raise TypeError("a ClearedSetpoint is made by Guard.clear() alone")
        self._setpoint = setpoint

    @property
    def setpoint(self) -> Setpoint:
        """What may go on the wire."""
        return self._setpoint


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A sample of the trajectory numbered ``trajectory_id``, made on the map of ``map_epoch``."""

    setpoint: Setpoint
    trajectory_id: int
    map_epoch: int


@dataclass(frozen=True, slots=True)
class Situation:
    """What the guard judges by: the clock, the newest good pose, and the ages (s) of pose and mission pulse."""

    now_s: float
    position_m: Vec3
    yaw_rad: float
    pose_age_s: float
    intent_age_s: float
    map_epoch: int


@dataclass(frozen=True, slots=True)
class Patience:
    """How long (s) silence is borne: pose and mission first hold, then land."""

    pose_hold_s: float
    pose_land_s: float
    intent_hold_s: float
    intent_land_s: float


@dataclass(frozen=True, slots=True)
class _Motion:
    """The last cleared setpoint in plain floats."""

    at_s: float
    position_m: Vec3
    velocity_mps: Vec3
    yaw_rad: float
    pitch_down_rad: float


class Guard:
    """Lets a proposal through, or answers with a hold that brakes from the last cleared setpoint."""

    def __init__(self, envelope: Envelope, patience: Patience) -> None:
        self._envelope, self.patience = envelope, patience
        self._last: _Motion | None = None
        self._trajectory_id = -1
        self._rest_until_s = -math.inf
        self._refused: tuple[int, str] | None = None
        self.refusals = 0  # episodes: a trajectory turned down at thirty samples running for one reason counts once

    def clear(self, proposal: Proposal | None, situation: Situation) -> tuple[ClearedSetpoint, Refusal | None]:
        """Judge one sample. No proposal means hold; a Refusal tells why a proposal was not flown. Never raises on numbers.

        The very first setpoint holds the present place (drawn inside the envelope). A proposal from a silent mission
        passes only if its trajectory was already being flown: it ends at rest, so silence becomes a hover.
        """
        motion = self._motion_of(proposal, situation)
        fault = "" if proposal is None else self._fault(proposal, motion, situation)
        if proposal is None or fault or motion is None:
            motion, setpoint = self._brake(situation)
        else:
            setpoint = proposal.setpoint
            self._trajectory_id = proposal.trajectory_id
        refusal = self._count(proposal, fault, setpoint)
        self._last = motion
        return ClearedSetpoint(setpoint, _MAKER), refusal

    def rebase(self, situation: Situation, rest_s: float = 1.0) -> None:
        """Odom itself jumped: forget the last setpoint, and hold the present place for a while."""
        self._last, self._rest_until_s = None, situation.now_s + rest_s

    def must_land(self, situation: Situation) -> str:
        """Why the flight has to end now, '' if it may go on. The ladder only goes down: the caller latches it."""
        if not situation.pose_age_s <= self.patience.pose_land_s:
            return f"no pose for {situation.pose_age_s:.1f} s"
        if not situation.intent_age_s <= self.patience.intent_land_s:
            return f"mission silent for {situation.intent_age_s:.1f} s"
        return ""

    def _motion_of(self, proposal: Proposal | None, situation: Situation) -> _Motion | None:
        if proposal is None:
            return None
        wanted = proposal.setpoint
        position, velocity = _vector(wanted.position_m), _vector(wanted.velocity_mps)
        if position is None or velocity is None:
            return None
        return _Motion(situation.now_s, position, velocity, wanted.yaw_rad, wanted.camera_pitch_down_rad)

    def _fault(self, proposal: Proposal, motion: _Motion | None, situation: Situation) -> str:
        wanted, envelope = proposal.setpoint, self._envelope
        acceleration = _vector(wanted.acceleration_mps2)
        angles = (wanted.yaw_rad, wanted.yaw_rate_radps, wanted.camera_pitch_down_rad)
        if motion is None or acceleration is None or not all(math.isfinite(angle) for angle in angles):
            return "setpoint is not finite"
        if self._last is None:
            return "nothing cleared yet"
        if situation.now_s < self._rest_until_s:
            return "pose was reset"
        if not -_FUTURE_S <= situation.pose_age_s <= self.patience.pose_hold_s:
            return "pose is stale"
        if proposal.map_epoch != situation.map_epoch:
            return f"trajectory is of map epoch {proposal.map_epoch}, pose of {situation.map_epoch}"
        fresh = -_FUTURE_S <= situation.intent_age_s <= self.patience.intent_hold_s
        if not fresh and proposal.trajectory_id != self._trajectory_id:
            return "mission is silent"
        if not math.hypot(*motion.velocity_mps) <= envelope.max_speed_mps + 1e-6:
            return f"speed {math.hypot(*motion.velocity_mps):.2f} m/s"
        if not math.hypot(*acceleration) <= envelope.max_acceleration_mps2 + 1e-6:
            return f"acceleration {math.hypot(*acceleration):.2f} m/s²"
        if not abs(wanted.yaw_rate_radps) <= envelope.max_yaw_rate_radps + 1e-6:
            return f"yaw rate {wanted.yaw_rate_radps:.2f} rad/s"
        if not envelope.admits(motion.position_m, envelope.stopping_point(motion.position_m, motion.velocity_mps)):
            x, y, z = motion.position_m
            return f"outside the fence at {x:.2f} {y:.2f} {z:.2f} m"
        return self._step_fault(self._last, motion)

    def _step_fault(self, last: _Motion, motion: _Motion) -> str:
        """Limits against the last cleared setpoint: place, velocity and heading may not jump."""
        dt_s = min(max(motion.at_s - last.at_s, 0.0), _LONGEST_STEP_S)
        step_m = math.dist(motion.position_m, last.position_m)
        if not step_m <= self._envelope.max_speed_mps * dt_s + _STEP_SLACK_M:
            return f"jump of {step_m:.2f} m"
        change_mps = math.dist(motion.velocity_mps, last.velocity_mps)
        if not change_mps <= self._envelope.max_acceleration_mps2 * dt_s + _SPEED_SLACK_MPS:
            return f"velocity jump of {change_mps:.2f} m/s"
        turn_rad = abs(math.remainder(motion.yaw_rad - last.yaw_rad, math.tau))
        if not turn_rad <= self._envelope.max_yaw_rate_radps * dt_s + _YAW_SLACK_RAD:
            return f"heading jump of {math.degrees(turn_rad):.0f} degrees"
        return ""

    def _brake(self, situation: Situation) -> tuple[_Motion, Setpoint]:
        """Slow down along the last cleared velocity within the acceleration limit, then stay."""
        last = self._last
        if last is None:
            known = all(math.isfinite(value) for value in (*situation.position_m, situation.yaw_rad))
            place = self._envelope.nearest_inside(situation.position_m if known else self._envelope.pad_m)
            yaw_rad = situation.yaw_rad if known else 0.0
            motion = _Motion(situation.now_s, place, (0.0, 0.0, 0.0), yaw_rad, 0.0)
            return motion, Setpoint.hold(np.array(place), yaw_rad)
        limit = self._envelope.max_acceleration_mps2
        speed = math.hypot(*last.velocity_mps)
        dt_s = max(situation.now_s - last.at_s, 0.0)
        braking_s = min(dt_s, speed / limit)
        left = 0.0 if speed <= limit * dt_s else 1.0 - limit * dt_s / speed
        mean = braking_s * (1.0 - 0.5 * limit * braking_s / speed) if speed > 0.0 else 0.0
        x, y, z = last.position_m
        vx, vy, vz = last.velocity_mps
        position = (x + vx * mean, y + vy * mean, z + vz * mean)
        velocity = (vx * left, vy * left, vz * left)
        slope = -limit / speed if left > 0.0 else 0.0
        setpoint = Setpoint(
            np.array(position), np.array(velocity), np.array([vx, vy, vz]) * slope, last.yaw_rad, 0.0, last.pitch_down_rad
        )
        return _Motion(situation.now_s, position, velocity, last.yaw_rad, last.pitch_down_rad), setpoint

    def _count(self, proposal: Proposal | None, fault: str, instead: Setpoint) -> Refusal | None:
        if proposal is None or not fault:
            self._refused = None
            return None
        if self._refused is None or self._refused[0] != proposal.trajectory_id:
            self.refusals += 1
        self._refused = (proposal.trajectory_id, fault)
        return Refusal(fault, instead)


def _vector(array: FloatArray) -> Vec3 | None:
    """Three finite floats, or None for any other shape or number."""
    if array.shape != (3,):
        return None
    x, y, z = (float(value) for value in array.tolist())
    return (x, y, z) if math.isfinite(x) and math.isfinite(y) and math.isfinite(z) else None


def fault_of(trajectory: Trajectory) -> str:
    """What makes a trajectory unfit to be sampled, '' if it is sound: shapes, finite numbers, rest at its end."""
    count = len(trajectory.yaw_rad) if trajectory.yaw_rad.ndim == 1 else 0
    vectors = (trajectory.position_m, trajectory.velocity_mps, trajectory.acceleration_mps2)
    scalars = (trajectory.yaw_rad, trajectory.yaw_rate_radps, trajectory.camera_pitch_down_rad)
    if count < 1 or any(v.shape != (count, 3) for v in vectors) or any(s.shape != (count,) for s in scalars):
        return "trajectory is malformed"
    if not (math.isfinite(trajectory.start_s) and math.isfinite(trajectory.step_s) and trajectory.step_s > 0.0):
        return "trajectory has no time axis"
    if not all(bool(np.isfinite(array).all()) for array in vectors + scalars):
        return "trajectory is not finite"
    if not float(np.linalg.norm(trajectory.velocity_mps[-1])) <= _REST_MPS:
        return "trajectory does not end at rest"
    return ""
