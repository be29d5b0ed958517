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
from collections import Counter
from dataclasses import replace

import numpy as np

from uav_recon.localization.eskf import SEEN, WHITE_SHARE, Estimate, PoseNoise
from uav_recon.localization.fusion_history import Arrival, FusedPose, FusionHistory, pose_innovation
from uav_recon.localization.imu_integration import Quaternion, Vector, conjugate, multiply, normalised, rotate
from uav_recon.localization.odometry_health import OdometryHealthMonitor
from uav_recon.localization.pose_gates import CONTRADICTIONS, PoseGates, PoseRejection, Sighting, pose_fault
from uav_recon.localization.relocalization_check import RETURN, STEP, RelocalizationCheck
from uav_recon.types.camera import ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose, WorldFromOdom

_CREDIBLE_M = 0.1  # standard deviation of a track that may stand against a pose source
_TURN_OF_MAP_RAD = math.radians(12.0)  # more is no correction of a map, but a tracker that has lost its heading
_STEADY_RAD = math.radians(3.0)  # standard deviation of a heading that a gyro still knows, long after the place is lost
_LARGEST_DRIFT = np.repeat((10.0**2, math.pi**2), 3)  # m², rad²: of what a source claims, no more is passed on
_OVERTURNED_RAD = math.radians(30.0)  # no gyro loses so much


class FusionFilter:
    """Fuses; costs 0.02 ms an inertial sample, 0.3 ms a pose, 0.1 ms an answer on one core.

    pose_lost_s: an answer farther than this after the newest pose has quality 0. ``rejected`` counts what was turned down,
    poses and inertial samples, by what for.
    """

    def __init__(self, pose_lost_s: float = 0.5, gates: PoseGates | None = None) -> None:
        self.rejected: Counter[PoseRejection] = Counter()
        self.correction = WorldFromOdom.start()
        self._lost_s, self._gates = pose_lost_s, gates or PoseGates()
        self._trial, self._watch = RelocalizationCheck(), OdometryHealthMonitor(pose_lost_s)
        self._chain = FusionHistory(self.rejected, self._watch.fused)
        self._reset_counter, self._source_resets = 0, 0
        self._disputed = False  # poses came since the newest that entered, and contradicted the track

    @property
    def newest_pose_s(self) -> float:
        """Stamp of the newest fused pose; -inf before the first."""
        return -math.inf if self._chain.newest is None else self._chain.newest.stamp_s

    @property
    def newest(self) -> tuple[Estimate, float] | None:
        """The estimate after the newest fused pose and its normalised innovation squared; None before the first."""
        return None if self._chain.newest is None else (self._chain.newest.estimate, self._chain.newest.nis)

    def add_imu(self, samples: list[ImuSample], now_s: float = math.inf) -> None:
        """Take inertial samples, oldest first; what no sensor can say, and what is not newer than the one before or later than
        now_s, is counted and left out.
        """
        self._chain.update(samples, now_s)

    def add_pose(self, pose: StampedPose, now_s: float) -> bool:
        """Fuse a pose of the source at its own stamp; now_s bounds what stamps are believed. False if it was turned down."""
        reason = pose_fault(pose, now_s) or self._chain.untimely(pose.stamp_s)
        if reason is not None:
            self.rejected[reason] += 1
            return False
        said, noise = self._seen_in_odom(pose), PoseNoise.claimed(pose.covariance)
        if self._chain.newest is None:
            return self._begin(said, noise)
        met = self._chain.meet(said, noise)
        if met is None:
            return self._found_again(said, noise)
        reason = self._doubtful(met, self._chain.before(said.stamp_s))
        if reason is not None and not self._proven(met):
            self.rejected[reason] += 1
            self._disputed |= reason in CONTRADICTIONS
            return False
        if reason is None:
            self._settle(met)
        return True

    def odom_at(self, stamp_s: float) -> StampedPose | None:
        """Where the body was (or is) at an instant; smooth between poses. None before the first pose, too long ago, and where
        the gyro says that it turned as no vehicle turns, until a pose has told: about a tenth of a second.
        """
        newest, found = self._chain.newest, self._chain.at(stamp_s)
        if newest is None or found is None:
            return None
        node, state, here = found
        age_s, source = stamp_s - newest.stamp_s, node.sighting.source
        health, why = self._watch.health(age_s, newest.estimate.inertial, len(self._trial) > 0)
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

    def _doubtful(self, met: Arrival, before: FusedPose) -> PoseRejection | None:
        """Why a pose does not simply go on from the one before it."""
        said = met.said
        if said.source.reset_counter != self._source_resets:
            return PoseRejection.RESET
        if said.stamp_s - before.stamp_s > self._lost_s:
            return PoseRejection.UNPROVEN
        return self._gates.leap(met.residual, met.covariance) or self._gates.haste(before.sighting, said)

    def _proven(self, met: Arrival) -> bool:
        """Whether a doubtful pose ends a run of them that is believed; then the filter has taken it in."""
        said, carried, here, residual = met.said, met.carried, met.here, met.residual
        lost = said.stamp_s - self.newest_pose_s > self._lost_s
        if said.stamp_s < self.newest_pose_s:
            return False
        track = Sighting(said.stamp_s, carried.position_m, carried.odom_from_body(here), said.source)
        credible = max(np.diagonal(carried.covariance)[:3]) <= _CREDIBLE_M**2
        tilt_rad = math.hypot(residual[3], residual[4])
        tilted = self._gates.tilt_rad < tilt_rad < _OVERTURNED_RAD  # the track takes gravity for a push; no map corrects that
        contradicted = lost and self._disputed  # not by a step: they never agreed on how the body moves
        self._trial.update(said, track, carried.inertial and credible and not (tilted or contradicted))
        if not self._trial.stands(RETURN if lost else STEP):
            return False
        declared = said.source.reset_counter != self._source_resets
        steady = credible or (carried.inertial and carried.covariance[8, 8] <= _STEADY_RAD**2)
        if steady and not declared and abs(residual[5]) > _TURN_OF_MAP_RAD:
            return False
        if not credible or contradicted or tilted:
            return self._begin(said, met.noise, self._trial.velocity_mps())
        if declared or self._gates.leap(residual, met.covariance):
            self._move_world(said.source, track)
            moved = replace(said, position_m=track.position_m, odom_from_body=track.odom_from_body)
            met = pose_innovation(moved, met.noise, carried, here)
        if lost:
            self._watch.begin(said.stamp_s)
        self._settle(met)
        return True

    def _found_again(self, said: Sighting, noise: PoseNoise) -> bool:
        """After a silence longer than the track is kept: nothing stands against a source that agrees with itself."""
        if said.stamp_s >= self.newest_pose_s:
            self._trial.update(said, said, inertial=False)
            if self._trial.stands(RETURN):
                return self._begin(said, noise, self._trial.velocity_mps())
        self.rejected[PoseRejection.UNPROVEN] += 1
        return False

    def _settle(self, met: Arrival) -> None:
        """It goes on from where the track leads."""
        self._trial.clear()
        self._disputed = False
        self._chain.enter(met)

    def _begin(self, said: Sighting, noise: PoseNoise, velocity_mps: Vector = (0.0, 0.0, 0.0)) -> bool:
        """Forget the past and go on from this pose; after the first time odom jumps there."""
        if not self._chain.reaches(said.stamp_s):
            self.rejected[PoseRejection.STAMP] += 1
            return False
        if self._chain.newest is not None:
            self._reset_counter = (self._reset_counter + 1) % 256
            again = said.source.reset_counter != self._source_resets
            self.correction = replace(self.correction, epoch=self.correction.epoch + again)
        self._trial.clear()
        self._disputed = False
        self._source_resets = said.source.reset_counter
        self._watch.begin(said.stamp_s)
        self._chain.begin(said, noise, velocity_mps)
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


def _quaternion(pose: Pose) -> Quaternion:
    w, x, y, z = pose.quat_wxyz.tolist()
    return (w, x, y, z)


def _with_drift(covariance: FloatArray, claimed: FloatArray) -> FloatArray:
    """Covariance (6, 6) of position and rotation vector: the filter's own, and what the source may well have drifted."""
    out: FloatArray = covariance[SEEN]
    out.flat[:: len(out) + 1] += (1.0 - WHITE_SHARE) * np.minimum(np.diagonal(claimed), _LARGEST_DRIFT)
    return out
