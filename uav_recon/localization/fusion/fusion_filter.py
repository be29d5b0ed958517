"""Fusion of late absolute poses and fast inertial samples into jump-free odometry.

It answers for any recent instant, and gives odom's pose in the world. The filter has its nodes at the stamps of the poses,
never at "now": each pose becomes a node at its own stamp, reached from the node before it by the inertial track. The present
is the newest node propagated by the samples since. A pose that arrives out of order is inserted by its stamp, and the nodes
after it are computed again.

A pose that does not continue the track is rejected. If several such poses agree, the source has moved its map: odom stays,
world_from_odom takes the step and its epoch increases (REP-105). Only if the track itself is lost does odom restart, which
its reset counter shows.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import numpy as np

from uav_recon.localization.fusion.eskf import SEEN, WHITE_SHARE, Estimate, PoseNoise
from uav_recon.localization.fusion.filter_pose_gates import (
    CONTRADICTIONS,
    FrozenPoseGate,
    PoseGates,
    PoseMeasurement,
    PoseRejection,
    pose_fault,
)
from uav_recon.localization.fusion.fusion_history import Arrival, FusedPose, pose_innovation
from uav_recon.localization.fusion.imu_integration import Quaternion, Vector, conjugate, multiply, normalised, rotate
from uav_recon.localization.fusion.pose_stream_health import OdometryHealthMonitor
from uav_recon.localization.fusion.propagation_bank import PropagationBank
from uav_recon.localization.fusion.relocalization_check import AFTER_LOSS, MAP_STEP, RelocalizationCheck
from uav_recon.types.camera import ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, PoseHealth, StampedPose, WorldFromOdom

_CREDIBLE_M = 0.1  #: reject: max. standard deviation of a track that may contradict a pose source
#: reject: a larger turn is no correction of a map, but a tracker that has lost its heading
_TURN_OF_MAP_RAD = math.radians(12.0)
#: reject: max. standard deviation of a heading that a gyro still knows, long after the position is lost
_STEADY_RAD = math.radians(3.0)
_LARGEST_DRIFT = np.repeat((10.0**2, math.pi**2), 3)  # m², rad²: max. claimed variance of a source that is passed on
#: reject: a smaller tilt of track against source is gravity taken for acceleration; no gyro loses this much
_OVERTURNED_RAD = math.radians(30.0)


class FusionFilter:
    """Fuses poses and inertial samples.

    A pose that its source calls degraded makes odometry degraded.

    Costs 0.03 ms per inertial sample, 0.4 ms per pose and 0.1 ms per answer on one core.

    pose_lost_s: an answer later than this after the newest pose has quality 0. ``rejected`` counts rejected poses by reason:
    not finite, out of range, stamp, duplicate, quality, jump, turn, speed, reset, unproven (the first after a loss), and "imu
    ..." for inertial samples.
    """

    def __init__(self, pose_lost_s: float = 0.5, gates: PoseGates | None = None) -> None:
        self.rejected: Counter[PoseRejection] = Counter()
        self.correction = WorldFromOdom.start()
        self.source_excluded = False
        self.confirmed_s = -math.inf
        self._lost_s = pose_lost_s
        self._gates = gates or PoseGates()
        self._frozen = FrozenPoseGate()
        self._relocalization = RelocalizationCheck()
        self._health_monitor = OdometryHealthMonitor(pose_lost_s)
        self._bank = PropagationBank(self.rejected)
        self._reset_counter = 0
        self._source_resets = 0
        self._contradictions = 0  # poses in a row that contradicted the track
        self._contradicted = False  # poses since the newest fused one contradicted the track

    @property
    def newest_pose_s(self) -> float:
        """Stamp of the newest fused pose; -inf before the first."""
        return -math.inf if self._bank.newest is None else self._bank.newest.stamp_s

    @property
    def newest(self) -> tuple[Estimate, float] | None:
        """The estimate after the newest fused pose and its normalized innovation squared.

        None before the first pose.
        """
        return None if self._bank.newest is None else (self._bank.newest.estimate, self._bank.newest.nis)

    def add_imu(self, samples: list[ImuSample], now_s: float = math.inf) -> None:
        """Add inertial samples, oldest first.

        Samples that no sensor can measure, that are not newer than the one before, or that are later than now_s, are counted
        and dropped.
        """
        self._bank.update(samples, now_s)

    def add_pose(self, pose: StampedPose, now_s: float) -> bool:
        """Fuse a pose of the source at its own stamp. Return False if it was rejected.

        now_s: present instant, which limits the accepted stamps.
        """
        reason = pose_fault(pose, now_s) or self._bank.stamp_fault(pose.stamp_s)
        if reason is not None:
            self.rejected[reason] += 1
            return False
        measurement, noise = self._seen_in_odom(pose), PoseNoise.claimed(pose.covariance)
        if self._bank.newest is None:
            return self._begin(measurement, noise)
        arrival = self._bank.predict_arrival(measurement, noise)
        if arrival is None:
            return self._restart_after_gap(measurement, noise)
        if self._frozen.repeats(pose.odom_from_body, arrival.residual):
            self.rejected[PoseRejection.FROZEN] += 1
            return False
        before = self._bank.before(measurement.stamp_s)
        reason = self._continuity_fault(arrival, before)
        if reason in CONTRADICTIONS:
            self._contradictions += 1
            fitting = (
                other
                for other in self._bank.alternatives(self._contradictions)
                if self._continuity_fault(other, before) is None
            )
            if (other := next(fitting, None)) is not None:
                self._bank.switch_to(other)
                arrival, reason = other, None
        else:
            self._contradictions = 0
        if reason is not None and not self._accept_run(arrival):
            self.rejected[reason] += 1
            self._contradicted |= reason in CONTRADICTIONS
            return False
        if reason is None:
            self._settle(arrival)
        return True

    def exclude_accelerometer(self, excluded: bool) -> None:
        """Leave the accelerometer out, which another track contradicts, or let the poses decide."""
        self._bank.accelerometer_excluded = excluded

    def rejoin(self, pose: StampedPose, odom: StampedPose) -> bool:
        """Use the source again after another estimator has carried odom on.

        Return False if that is not possible yet. odom: at the stamp of the pose, which does not move it: world_from_odom takes
        what lies between.
        """
        if not self._bank.reaches(pose.stamp_s):
            return False
        position, attitude = odom.odom_from_body.translation_m.tolist(), _quaternion(odom.odom_from_body)
        measurement = PoseMeasurement(pose.stamp_s, (position[0], position[1], position[2]), attitude, pose)
        self._move_world(pose, measurement)
        self._reset_counter = odom.reset_counter
        vx, vy, vz = odom.velocity_odom_mps.tolist()
        self._restart(measurement, PoseNoise.claimed(pose.covariance), (vx, vy, vz))
        return True

    def add_view(self, now_s: float) -> None:
        """Do nothing: only the poses of the source count."""

    def odom_at(self, stamp_s: float) -> StampedPose | None:
        """Return the body's pose at an instant; smooth between poses.

        None before the first pose, too long ago, and while the attitude is unknown: if the gyro measures a turn that no vehicle
        can make, until the next pose, which takes about a tenth of a second.
        """
        newest, found = self._bank.newest, self._bank.at(stamp_s)
        if newest is None or found is None:
            return None
        node, state, here = found
        age_s, source = stamp_s - newest.stamp_s, node.measurement.source
        health, reason = self._health_monitor.health(age_s, self._bank.fault(), len(self._relocalization) > 0)
        if health is PoseHealth.GOOD:
            health, reason = source.health, source.health_reason
        return StampedPose(
            stamp_s,
            Pose(np.array(state.odom_from_body(here)), np.array(state.position_m)),
            np.array(state.velocity_mps),
            _with_drift(state.covariance, source.covariance, self._bank.switch_variance_m2(stamp_s)),
            self._health_monitor.quality(health, age_s, source.quality),
            self._reset_counter,
            source.map_epoch,
            health,
            reason,
            self.correction,
        )

    def _continuity_fault(self, arrival: Arrival, before: FusedPose) -> PoseRejection | None:
        """Return the reason why a pose does not simply continue the one before it, '' if it does."""
        measurement = arrival.measurement
        if measurement.source.reset_counter != self._source_resets:
            return PoseRejection.RESET
        if measurement.stamp_s - before.stamp_s > self._lost_s:
            return PoseRejection.UNPROVEN
        return self._gates.leap(arrival.residual, arrival.covariance) or self._gates.speed_fault(
            before.measurement, measurement
        )

    def _accept_run(self, arrival: Arrival) -> bool:
        """Return True if a doubtful pose completes an accepted run of such poses.

        The filter has then fused it.
        """
        measurement, carried, here, residual = arrival.measurement, arrival.carried, arrival.here, arrival.residual
        lost = measurement.stamp_s - self.newest_pose_s > self._lost_s
        if measurement.stamp_s < self.newest_pose_s:
            return False
        track = PoseMeasurement(measurement.stamp_s, carried.position_m, carried.odom_from_body(here), measurement.source)
        credible = max(np.diagonal(carried.covariance)[:3]) <= _CREDIBLE_M**2
        tilt_rad = math.hypot(residual[3], residual[4])
        tilted = self._gates.tilt_rad < tilt_rad < _OVERTURNED_RAD  # gravity is taken for acceleration; no map corrects that
        contradicted = (
            lost and self._contradicted
        )  # not by a step of the map: source and track never agreed on the body's motion
        self._relocalization.update(
            measurement, track, carried.model.accelerometer and credible and not (tilted or contradicted)
        )
        if not self._relocalization.satisfies(AFTER_LOSS if lost else MAP_STEP):
            return False
        declared = measurement.source.reset_counter != self._source_resets
        steady = credible or (carried.model.gyro and carried.covariance[8, 8] <= _STEADY_RAD**2)
        if steady and not declared and abs(residual[5]) > _TURN_OF_MAP_RAD:
            return False
        fits = self._gates.leap(residual, arrival.covariance) is None
        if contradicted or tilted or not (credible or fits):
            return self._begin(measurement, arrival.noise, self._relocalization.velocity_mps())
        if declared or not fits:
            self._move_world(measurement.source, track)
            moved = replace(measurement, position_m=track.position_m, odom_from_body=track.odom_from_body)
            arrival = pose_innovation(moved, arrival.noise, carried, here)
        if lost:
            self._health_monitor.begin(measurement.stamp_s)
        if carried.model.accelerometer:
            self._settle(arrival)
        else:
            self._settle_at_run_velocity(arrival, measurement)
        return True

    def _settle_at_run_velocity(self, arrival: Arrival, measurement: PoseMeasurement) -> None:
        """Fuse the last pose of an accepted run, and take the velocity from the run.

        Without an accelerometer a wrong velocity of the track may be what the poses contradicted.

        measurement: the pose before a step of the map.
        """
        turn = multiply(arrival.measurement.odom_from_body, conjugate(measurement.odom_from_body))
        velocity_mps = rotate(turn, self._relocalization.velocity_mps())
        self._relocalization.clear()
        self._contradicted = False
        self._bank.begin(arrival.measurement, arrival.noise, velocity_mps)
        self._health_monitor.fused(arrival.measurement.stamp_s, arrival.nis)

    def _restart_after_gap(self, measurement: PoseMeasurement, noise: PoseNoise) -> bool:
        """Restart after a silence longer than the stored track, once the source agrees with itself.

        Nothing can contradict the source then.
        """
        if measurement.stamp_s >= self.newest_pose_s:
            self._relocalization.update(measurement, measurement, inertial=False)
            if self._relocalization.satisfies(AFTER_LOSS):
                return self._begin(measurement, noise, self._relocalization.velocity_mps())
        self.rejected[PoseRejection.UNPROVEN] += 1
        return False

    def _settle(self, arrival: Arrival) -> None:
        """Fuse a pose that continues the track."""
        self._relocalization.clear()
        self._contradicted = False
        self._bank.enter(arrival)
        self._health_monitor.fused(arrival.measurement.stamp_s, arrival.nis)

    def _begin(self, measurement: PoseMeasurement, noise: PoseNoise, velocity_mps: Vector = (0.0, 0.0, 0.0)) -> bool:
        """Forget the past and restart from this pose. After the first time, odom jumps there."""
        if not self._bank.reaches(measurement.stamp_s):
            self.rejected[PoseRejection.STAMP] += 1
            return False
        if self._bank.newest is not None:
            self._reset_counter = (self._reset_counter + 1) % 256
            again = measurement.source.reset_counter != self._source_resets
            self.correction = replace(self.correction, epoch=self.correction.epoch + again)
        self._restart(measurement, noise, velocity_mps)
        return True

    def _restart(self, measurement: PoseMeasurement, noise: PoseNoise, velocity_mps: Vector) -> None:
        """Forget the nodes and restart from this pose."""
        self._relocalization.clear()
        self._contradicted = False
        self._source_resets = measurement.source.reset_counter
        self._health_monitor.begin(measurement.stamp_s)
        self._bank.begin(measurement, noise, velocity_mps)
        self._health_monitor.fused(measurement.stamp_s, 0.0)

    def _move_world(self, pose: StampedPose, track: PoseMeasurement) -> None:
        """Keep odom and move the world to where the source now reports it."""
        odom_from_body = Pose(np.array(track.odom_from_body), np.array(track.position_m))
        self.correction = WorldFromOdom(pose.odom_from_body @ odom_from_body.inverse(), self.correction.epoch + 1)
        self._source_resets = pose.reset_counter

    def _seen_in_odom(self, pose: StampedPose) -> PoseMeasurement:
        """Return the source's pose transformed from its world into odom.

        A quaternion and its negative are the same attitude.
        """
        world = self.correction.world_from_odom
        odom_from_world = conjugate(_quaternion(world))
        (px, py, pz), (wx, wy, wz) = pose.odom_from_body.translation_m.tolist(), world.translation_m.tolist()
        position_m = rotate(odom_from_world, (px - wx, py - wy, pz - wz))
        attitude = normalised(multiply(odom_from_world, _quaternion(pose.odom_from_body)))
        return PoseMeasurement(pose.stamp_s, position_m, attitude, pose)


def _quaternion(pose: Pose) -> Quaternion:
    w, x, y, z = pose.quat_wxyz.tolist()
    return (w, x, y, z)


def _with_drift(covariance: FloatArray, claimed: FloatArray, switch_m2: float) -> FloatArray:
    """Return the covariance (6, 6) of position and rotation vector.

    It is the filter's own plus the possible drift of the source, and the step at a change of the propagation.
    """
    out: FloatArray = covariance[SEEN]
    out.flat[:: len(out) + 1] += (1.0 - WHITE_SHARE) * np.minimum(np.diagonal(claimed), _LARGEST_DRIFT)
    out.flat[: 3 * len(out) : len(out) + 1] += switch_m2
    return out
