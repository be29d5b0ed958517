"""Late absolute poses and fast inertial samples into jump-free odometry at any recent instant, and odom's place in the world.

The filter lives at the stamps of the poses, never at "now": each pose becomes a node at its own stamp, reached from the node
before it by the inertial track, and the present is the newest node carried on by the samples since. A pose that comes out of
order is put in its place and the nodes after it are computed again.

A pose that does not go on from where the track leads is not believed. Where several go on together, the source has moved its
map: odom stays where it is, world_from_odom takes up the step and its epoch counts (REP-105). Only where the track itself is
lost does odom begin anew, and says so by its reset counter.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, replace

import numpy as np

from uav_recon.localization.attitude import (
    GRAVITY_MPS2,
    InertialState,
    InertialTrack,
    Quaternion,
    Vector,
    conjugate,
    exponential,
    logarithm,
    multiply,
    normalised,
    rotate,
)
from uav_recon.localization.errorstate import (
    SEEN,
    WHITE_SHARE,
    Estimate,
    PoseNoise,
    carry,
    carry_mean,
    correct,
    innovation,
    spread,
)
from uav_recon.localization.gates import CONTRADICTIONS, Gates, Sighting, doubt, same_stamp, surprise, tether, unfit
from uav_recon.localization.trial import RETURN, STEP, Trial
from uav_recon.localization.watch import Watch
from uav_recon.types.camera import ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose, WorldFromOdom

_HISTORY_S = 2.0  # nodes kept for late poses and frames
_IMU_GAP_S = 0.05
_CREDIBLE_M = 0.1  # standard deviation of a track that may stand against a pose source
_TURN_OF_MAP_RAD = math.radians(12.0)  # more is no correction of a map, but a tracker that has lost its heading
_OVERTURNED_RAD = math.radians(30.0)  # no gyro loses so much
_FASTEST_RADPS = 35.0  # any gyro is saturated there


@dataclass(frozen=True, slots=True)
class _Node:
    """A pose that entered, and the estimate after it. nis: of its innovation."""

    sighting: Sighting
    noise: PoseNoise
    estimate: Estimate
    nis: float

    @property
    def stamp_s(self) -> float:
        return self.sighting.stamp_s


class FusionFilter:
    """Fuses; costs 0.02 ms an inertial sample, 0.3 ms a pose, 0.1 ms an answer on one core.

    pose_lost_s: an answer farther than this after the newest pose has quality 0. ``rejected`` counts what was turned down,
    by reason: not finite, stamp, duplicate, quality, jump, turn, speed, reset, unproven (the first after a loss), and "imu ..."
    for inertial samples.
    """

    def __init__(self, pose_lost_s: float = 0.5, gates: Gates | None = None) -> None:
        self.rejected: Counter[str] = Counter()
        self.correction = WorldFromOdom.start()
        self._lost_s, self._gates = pose_lost_s, gates or Gates()
        self._track, self._trial, self._watch = InertialTrack(), Trial(), Watch(pose_lost_s)
        self._nodes: deque[_Node] = deque()
        self._imu_since_s, self._imu_s = math.inf, -math.inf  # the newest unbroken run of inertial samples
        self._reset_counter, self._source_resets = 0, 0
        self._disputed = False  # poses came since the newest that entered, and contradicted the track

    @property
    def newest_pose_s(self) -> float:
        """Stamp of the newest fused pose; -inf before the first."""
        return self._nodes[-1].stamp_s if self._nodes else -math.inf

    @property
    def newest(self) -> tuple[Estimate, float] | None:
        """The estimate after the newest fused pose and its normalised innovation squared; None before the first."""
        return (self._nodes[-1].estimate, self._nodes[-1].nis) if self._nodes else None

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Take inertial samples, oldest first; what is not finite or not newer than the one before is counted and left out."""
        estimate = self._nodes[-1].estimate if self._nodes else None
        bias = estimate.gyro_bias_radps if estimate is not None and estimate.inertial else (0.0, 0.0, 0.0)
        for sample in samples:
            stamp_s = sample.stamp_s
            gx, gy, gz = sample.gyro_radps.tolist()
            fx, fy, fz = sample.specific_force_mps2.tolist()
            if not math.isfinite(stamp_s + gx + gy + gz + fx + fy + fz) or max(abs(gx), abs(gy), abs(gz)) > _FASTEST_RADPS:
                self.rejected["imu not finite"] += 1
                continue
            if stamp_s <= self._track.newest_s:
                self.rejected["imu stamp"] += 1
                continue
            if stamp_s - self._imu_s > _IMU_GAP_S:
                self._imu_since_s = stamp_s
            self._imu_s = stamp_s
            self._track.push(stamp_s, (gx, gy, gz), (fx, fy, fz), bias)

    def add_pose(self, pose: StampedPose, now_s: float) -> bool:
        """Fuse a pose of the source at its own stamp; now_s bounds what stamps are believed. False if it was turned down."""
        reason = unfit(pose, now_s) or self._untimely(pose.stamp_s)
        if reason:
            self.rejected[reason] += 1
            return False
        said, noise = self._seen_in_odom(pose), PoseNoise.claimed(pose.covariance)
        if not self._nodes:
            return self._begin(said, noise)
        k = self._before(said.stamp_s)
        carried, here = self._reach(self._nodes[k], said.stamp_s)
        residual, covariance = _against(said, carried, here, noise)
        reason = self._doubtful(said, self._nodes[k], residual, covariance)
        if reason and not self._proven(said, carried, here, noise):
            self.rejected[reason] += 1
            self._disputed |= reason in CONTRADICTIONS
            return False
        if not reason:
            self._trial.clear()
            self._disputed = False
            later = [self._nodes.pop() for _ in range(len(self._nodes) - 1 - k)]
            self._append(said, noise, carried, residual, covariance)
            for node in reversed(later):
                carried, here = self._reach(self._nodes[-1], node.stamp_s)
                self._append(node.sighting, node.noise, carried, *_against(node.sighting, carried, here, node.noise))
        while self._nodes[-1].stamp_s - self._nodes[0].stamp_s > _HISTORY_S:
            self._nodes.popleft()
        return True

    def odom_at(self, stamp_s: float) -> StampedPose | None:
        """Where the body was (or is) at an instant; smooth between poses. None before the first pose or too long ago."""
        if not self._nodes or stamp_s < self._nodes[0].stamp_s:
            return None
        k = self._before(stamp_s)
        node = self._nodes[k]
        base, here = self._track.at(node.stamp_s), self._track.at(stamp_s)
        if base is None or here is None:
            return None
        if k + 1 == len(self._nodes):
            state = carry(node.estimate, base, here, node.noise)
        else:
            state = self._bent(node, self._nodes[k + 1], base, here)
        age_s, source = stamp_s - self.newest_pose_s, node.sighting.source
        health, why = self._watch.health(age_s, self._nodes[-1].estimate.inertial, len(self._trial) > 0)
        return StampedPose(
            stamp_s,
            Pose(np.array(state.odom_from_body(here)), np.array(state.position_m)),
            np.array(state.velocity_mps),
            _with_drift(state.covariance, source.covariance),
            self._watch.quality(health, age_s, source.quality),
            self._reset_counter,
            source.map_epoch,
            health,
            why,
            self.correction,
        )

    # -- which poses --------------------------------------------------------------------------------------------------

    def _untimely(self, stamp_s: float) -> str:
        """Whether a stamp has no place in what is kept."""
        if not self._nodes:
            return "stamp" if len(self._track) and stamp_s < self._track.oldest_s else ""
        early = stamp_s < self._nodes[0].stamp_s
        k = 0 if early else self._before(stamp_s)
        beside = (self._nodes[n] for n in (k, k + 1) if n < len(self._nodes))
        if any(same_stamp(node.stamp_s, stamp_s) for node in beside):
            return "duplicate"
        return "stamp" if early else ""

    def _doubtful(self, said: Sighting, before: _Node, residual: FloatArray, covariance: FloatArray) -> str:
        """Why a pose does not simply go on from the one before it."""
        if said.source.reset_counter != self._source_resets:
            return "reset"
        if said.stamp_s - before.stamp_s > self._lost_s:
            return "unproven"
        return self._gates.leap(residual, covariance) or self._gates.haste(before.sighting, said)

    def _proven(self, said: Sighting, carried: Estimate, here: InertialState, noise: PoseNoise) -> bool:
        """Whether a doubtful pose ends a run of them that is believed; then the filter has taken it in."""
        lost = said.stamp_s - self.newest_pose_s > self._lost_s
        if said.stamp_s < self.newest_pose_s:
            return False
        track = Sighting(said.stamp_s, carried.position_m, carried.odom_from_body(here), said.source)
        credible = max(np.diagonal(carried.covariance)[:3]) <= _CREDIBLE_M**2
        residual, covariance = _against(said, carried, here, noise)
        tilt_rad = math.hypot(residual[3], residual[4])
        tilted = self._gates.tilt_rad < tilt_rad < _OVERTURNED_RAD  # the track takes gravity for a push; no map corrects that
        contradicted = lost and self._disputed  # not by a step: they never agreed on how the body moves
        self._trial.hear(said, track, carried.inertial and credible and not (tilted or contradicted))
        if not self._trial.stands(RETURN if lost else STEP):
            return False
        declared = said.source.reset_counter != self._source_resets
        if credible and not declared and abs(residual[5]) > _TURN_OF_MAP_RAD:
            return False
        if not credible or contradicted or tilted:
            return self._begin(said, noise, self._trial.velocity_mps())
        if declared or self._gates.leap(residual, covariance):
            self._move_world(said.source, track)
            said = replace(said, position_m=track.position_m, odom_from_body=track.odom_from_body)
        self._trial.clear()
        self._disputed = False
        if lost:
            self._watch.begin(said.stamp_s)
        self._append(said, noise, carried, *_against(said, carried, here, noise))
        return True

    def _move_world(self, pose: StampedPose, track: Sighting) -> None:
        """Odom stays, the world goes where the source now says that it is."""
        odom_from_body = Pose(np.array(track.odom_from_body), np.array(track.position_m))
        self.correction = WorldFromOdom(pose.odom_from_body @ odom_from_body.inverse(), self.correction.epoch + 1)
        self._source_resets = pose.reset_counter

    def _seen_in_odom(self, pose: StampedPose) -> Sighting:
        """The source's word carried from its world into odom. A quaternion and its negative are the same."""
        world = self.correction.world_from_odom
        odom_from_world = conjugate(_quaternion(world))
        (px, py, pz), (wx, wy, wz) = pose.odom_from_body.translation_m.tolist(), world.translation_m.tolist()
        position_m = rotate(odom_from_world, (px - wx, py - wy, pz - wz))
        attitude = normalised(multiply(odom_from_world, _quaternion(pose.odom_from_body)))
        return Sighting(pose.stamp_s, position_m, attitude, pose)

    # -- the estimate -------------------------------------------------------------------------------------------------

    def _begin(self, said: Sighting, noise: PoseNoise, velocity_mps: Vector = (0.0, 0.0, 0.0)) -> bool:
        """Forget the past and go on from this pose; after the first time odom jumps there."""
        inertial = self._inertial(said.stamp_s, said.stamp_s)
        if not inertial:
            self._coast_to(said.stamp_s)
        base = self._track.at(said.stamp_s)
        if base is None:
            self.rejected["stamp"] += 1
            return False
        if self._nodes:
            self._reset_counter = (self._reset_counter + 1) % 256
            anew = said.source.reset_counter != self._source_resets
            self.correction = replace(self.correction, epoch=self.correction.epoch + anew)
        self._nodes.clear()
        self._trial.clear()
        self._disputed = False
        self._watch.begin(said.stamp_s)
        self._source_resets = said.source.reset_counter
        estimate = Estimate.at_rest(base, said.position_m, said.odom_from_body, noise, inertial)
        self._keep(_Node(said, noise, estimate._replace(velocity_mps=velocity_mps), 0.0))
        return True

    def _reach(self, node: _Node, stamp_s: float) -> tuple[Estimate, InertialState]:
        """A node's estimate carried to a later stamp, and the track there."""
        inertial = self._inertial(node.stamp_s, stamp_s)
        if not inertial:
            self._coast_to(stamp_s)
        base, here = self._track.at(node.stamp_s), self._track.at(stamp_s)
        assert base is not None  # nodes are younger than the track
        assert here is not None
        return carry(node.estimate.carried_on(inertial), base, here, node.noise), here

    def _append(
        self, said: Sighting, noise: PoseNoise, carried: Estimate, residual: FloatArray, covariance: FloatArray
    ) -> None:
        """Correct what was carried to a pose by the pose: what it says beyond (6,), and how surely (6, 6)."""
        nis = surprise(residual, covariance)
        variance_m2 = sum(carried.covariance.diagonal()[:3].tolist()) / 3.0
        doubts = max(doubt(nis), tether(residual, variance_m2, noise.position_m2))
        self._keep(_Node(said, noise, correct(carried, residual, noise, doubts), nis))

    def _keep(self, node: _Node) -> None:
        self._nodes.append(node)
        self._watch.fused(node.stamp_s, node.nis)
        self._track.hover_force_gyro = rotate(conjugate(node.estimate.odom_from_gyro), (0.0, 0.0, GRAVITY_MPS2))

    def _bent(self, node: _Node, after: _Node, base: InertialState, here: InertialState) -> Estimate:
        """The way from a node, bent so that it ends at the next."""
        there = self._track.at(after.stamp_s)
        state = carry_mean(node.estimate, base, here)
        if there is None:
            return state
        share = (here.stamp_s - node.stamp_s) / (after.stamp_s - node.stamp_s)
        end, goal = carry_mean(node.estimate, base, there), after.estimate
        turn = logarithm(multiply(goal.odom_from_gyro, conjugate(end.odom_from_gyro)))
        return state._replace(
            position_m=_towards(state.position_m, end.position_m, goal.position_m, share),
            velocity_mps=_towards(state.velocity_mps, end.velocity_mps, goal.velocity_mps, share),
            odom_from_gyro=multiply(exponential((share * turn[0], share * turn[1], share * turn[2])), state.odom_from_gyro),
        )

    def _before(self, stamp_s: float) -> int:
        """Index of the newest node that is not younger than a stamp."""
        k = len(self._nodes) - 1
        while self._nodes[k].stamp_s > stamp_s:
            k -= 1
        return k

    def _inertial(self, start_s: float, end_s: float) -> bool:
        """Whether inertial samples cover the interval."""
        return self._imu_since_s <= start_s + _IMU_GAP_S and self._imu_s >= end_s - _IMU_GAP_S

    def _coast_to(self, stamp_s: float) -> None:
        if stamp_s > self._track.newest_s:
            estimate = self._nodes[-1].estimate if self._nodes else None
            known = estimate is not None and not estimate.inertial
            bx, by, bz = estimate.gyro_bias_radps if estimate is not None and known else (0.0, 0.0, 0.0)
            self._track.coast(stamp_s, (-bx, -by, -bz))


def _quaternion(pose: Pose) -> Quaternion:
    w, x, y, z = pose.quat_wxyz.tolist()
    return (w, x, y, z)


def _against(said: Sighting, carried: Estimate, here: InertialState, noise: PoseNoise) -> tuple[FloatArray, FloatArray]:
    """What a pose says beyond the estimate carried to it (6,), and its covariance (6, 6)."""
    return innovation(carried, here, said.position_m, said.odom_from_body), spread(carried, noise)


def _towards(here: Vector, end: Vector, goal: Vector, share: float) -> Vector:
    return (
        here[0] + share * (goal[0] - end[0]),
        here[1] + share * (goal[1] - end[1]),
        here[2] + share * (goal[2] - end[2]),
    )


def _with_drift(covariance: FloatArray, claimed: FloatArray) -> FloatArray:
    """Covariance (6, 6) of position and rotation vector: the filter's own, and what the source may have drifted."""
    out: FloatArray = covariance[SEEN]
    out.flat[:: len(out) + 1] += (1.0 - WHITE_SHARE) * np.diagonal(claimed)
    return out
