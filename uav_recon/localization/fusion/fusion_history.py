"""Fused poses with their estimates, and the inertial track between them, for one model."""

from __future__ import annotations

import functools
import math
from collections import deque
from dataclasses import dataclass

from uav_recon.localization.fusion.eskf import (
    Estimate,
    PoseNoise,
    innovation,
    propagate,
    propagate_mean,
    spread,
    update_estimate,
)
from uav_recon.localization.fusion.filter_pose_gates import (
    PoseMeasurement,
    PoseRejection,
    max_step_noise_scale,
    normalized_innovation_squared,
    outlier_noise_scale,
    same_stamp,
)
from uav_recon.localization.fusion.imu_integration import (
    GRAVITY_MPS2,
    InertialState,
    InertialTrack,
    Vector,
    conjugate,
    exponential,
    logarithm,
    multiply,
    rotate,
)
from uav_recon.localization.fusion.imu_sample_gate import InertialReading
from uav_recon.localization.fusion.propagation_model import KINEMATIC, PropagationModel
from uav_recon.types.frames import FloatArray

_HISTORY_S = 2.0  #: reject: late poses and frames are possible for this time
_IMU_GAP_S = 0.05  #: brake: retreat_speed_mps after a longer gap of the inertial samples, as without an IMU


@dataclass(frozen=True, slots=True)
class FusedPose:
    """A fused pose, and the estimate after it. nis: normalized innovation squared of the pose."""

    measurement: PoseMeasurement
    noise: PoseNoise
    estimate: Estimate
    nis: float

    @property
    def stamp_s(self) -> float:
        """Stamp of the pose."""
        return self.measurement.stamp_s


@dataclass(frozen=True, eq=False)
class Arrival:
    """A new pose and the filter's prediction for its instant.

    carried: the estimate propagated there. here: the track there. residual: (6,) innovation. covariance: (6, 6) of the
    innovation.
    """

    measurement: PoseMeasurement
    noise: PoseNoise
    carried: Estimate
    here: InertialState
    residual: FloatArray
    covariance: FloatArray

    @functools.cached_property
    def nis(self) -> float:
        """Normalized innovation squared."""
        return normalized_innovation_squared(self.residual, self.covariance)


class FusionHistory:
    """The nodes of the filter and the track, with one propagation model.

    Without inertial samples the model is the kinematic one.
    """

    def __init__(self, model: PropagationModel) -> None:
        self._model = model
        self._track = InertialTrack()
        self._nodes: deque[FusedPose] = deque()
        # the newest run of inertial samples without a gap
        self._imu_since_s = math.inf
        self._imu_s = -math.inf

    @property
    def newest(self) -> FusedPose | None:
        """The newest node; None before the first."""
        return self._nodes[-1] if self._nodes else None

    def update(self, samples: list[InertialReading]) -> None:
        """Add valid inertial samples, oldest first."""
        if not self._model.gyro:
            return
        estimate = self._nodes[-1].estimate if self._nodes else None
        bias = estimate.gyro_bias_radps if estimate is not None and estimate.model.gyro else (0.0, 0.0, 0.0)
        for stamp_s, rate, force in samples:
            if stamp_s <= self._track.newest_s:
                continue  # the track went on without samples until there
            if stamp_s - self._imu_s > _IMU_GAP_S:
                self._imu_since_s = stamp_s
            self._imu_s = stamp_s
            self._track.push(stamp_s, rate, force if self._model.accelerometer else None, bias)

    def stamp_fault(self, stamp_s: float) -> PoseRejection | None:
        """Return the reason why a stamp cannot be inserted, None if it can."""
        if not self._nodes:
            return None if self.reaches(stamp_s) else PoseRejection.STAMP
        early = stamp_s < self._nodes[0].stamp_s
        k = 0 if early else self._before(stamp_s)
        beside = (self._nodes[n] for n in (k, k + 1) if n < len(self._nodes))
        if any(same_stamp(node.stamp_s, stamp_s) for node in beside):
            return PoseRejection.DUPLICATE
        return PoseRejection.STAMP if early else None

    def before(self, stamp_s: float) -> FusedPose:
        """Return the newest node that is not younger than a timely stamp."""
        return self._nodes[self._before(stamp_s)]

    def predict_arrival(self, measurement: PoseMeasurement, noise: PoseNoise) -> Arrival | None:
        """Propagate the node before a timely pose to the pose.

        None if the track no longer reaches back to that node.
        """
        return self._predict_arrival(self.before(measurement.stamp_s), measurement, noise)

    def reaches(self, stamp_s: float) -> bool:
        """Return True if the track goes back to the stamp."""
        return not len(self._track) or stamp_s >= self._track.oldest_s

    def begin(self, measurement: PoseMeasurement, noise: PoseNoise, velocity_mps: Vector) -> None:
        """Forget the nodes and restart from a pose within the track."""
        model = self._model_between(measurement.stamp_s, measurement.stamp_s)
        if not model.gyro:
            self._coast_to(measurement.stamp_s)
        base = self._track.at(measurement.stamp_s)
        assert base is not None
        self._nodes.clear()
        estimate = Estimate.at_rest(base, measurement.position_m, measurement.odom_from_body, noise, model)
        self._keep(FusedPose(measurement, noise, estimate._replace(velocity_mps=velocity_mps), 0.0))

    def enter(self, arrival: Arrival) -> None:
        """Insert a pose by its stamp; the nodes after it are computed again."""
        k = self._before(arrival.measurement.stamp_s)
        later = [self._nodes.pop() for _ in range(len(self._nodes) - 1 - k)]
        self._append(arrival)
        for node in reversed(later):
            again = self._predict_arrival(self._nodes[-1], node.measurement, node.noise)
            if again is not None:
                self._append(again)
        while self._nodes[-1].stamp_s - self._nodes[0].stamp_s > _HISTORY_S:
            self._nodes.popleft()

    def at(self, stamp_s: float) -> tuple[FusedPose, Estimate, InertialState] | None:
        """Return the node before an instant, and the estimate and the track there.

        None if too long ago, or if the attitude is a guess: after a whirl until the next node, and also before the whirl once
        that node is known, because the whole path between two nodes is corrected.
        """
        if not self._nodes or stamp_s < self._nodes[0].stamp_s:
            return None
        k = self._before(stamp_s)
        node, after = self._nodes[k], self._nodes[k + 1] if k + 1 < len(self._nodes) else None
        base, here = self._track.at(node.stamp_s), self._track.at(stamp_s)
        there = here if after is None else self._track.at(after.stamp_s)
        if base is None or here is None or there is None or _attitude_unknown(base, here, there):
            return None
        if after is None:
            return node, propagate(node.estimate, base, here, node.noise), here
        return node, _smoothed(node, after, base, here, there), here

    def _predict_arrival(self, node: FusedPose, measurement: PoseMeasurement, noise: PoseNoise) -> Arrival | None:
        model = self._model_between(node.stamp_s, measurement.stamp_s)
        if not model.gyro:
            self._coast_to(measurement.stamp_s)
        base, here = self._track.at(node.stamp_s), self._track.at(measurement.stamp_s)
        if base is None or here is None:
            return None
        return pose_innovation(measurement, noise, propagate(node.estimate.propagated_by(model), base, here, node.noise), here)

    def _append(self, arrival: Arrival) -> None:
        """Add a node: the propagated estimate corrected by the pose."""
        nis = arrival.nis
        variance_m2 = sum(arrival.carried.covariance.diagonal()[:3].tolist()) / 3.0
        doubts = max(outlier_noise_scale(nis), max_step_noise_scale(arrival.residual, variance_m2, arrival.noise.position_m2))
        self._keep(
            FusedPose(
                arrival.measurement,
                arrival.noise,
                update_estimate(arrival.carried, arrival.residual, arrival.noise, doubts),
                nis,
            )
        )

    def _keep(self, node: FusedPose) -> None:
        self._nodes.append(node)
        self._track.hover_force_gyro = rotate(conjugate(node.estimate.odom_from_gyro), (0.0, 0.0, GRAVITY_MPS2))

    def _before(self, stamp_s: float) -> int:
        k = len(self._nodes) - 1
        while self._nodes[k].stamp_s > stamp_s:
            k -= 1
        return k

    def _model_between(self, start_s: float, end_s: float) -> PropagationModel:
        """Return the own model if inertial samples cover the interval, otherwise the kinematic one."""
        covered = self._imu_since_s <= start_s + _IMU_GAP_S and self._imu_s >= end_s - _IMU_GAP_S
        return self._model if covered else KINEMATIC

    def _coast_to(self, stamp_s: float) -> None:
        if stamp_s > self._track.newest_s:
            estimate = self._nodes[-1].estimate if self._nodes else None
            turning = estimate is not None and not estimate.model.gyro
            bx, by, bz = estimate.gyro_bias_radps if estimate is not None and turning else (0.0, 0.0, 0.0)
            self._track.coast(stamp_s, (-bx, -by, -bz))


def pose_innovation(measurement: PoseMeasurement, noise: PoseNoise, carried: Estimate, here: InertialState) -> Arrival:
    """Return the innovation of a pose against an estimate propagated to its instant."""
    residual = innovation(carried, here, measurement.position_m, measurement.odom_from_body)
    return Arrival(measurement, noise, carried, here, residual, spread(carried, noise))


def _attitude_unknown(base: InertialState, here: InertialState, there: InertialState) -> bool:
    """Return True if the attitude at ``here`` is unknown.

    ``here`` lies between a node, and the next node or the present.
    """
    return here.stamp_s > base.stamp_s and there.overrate_angle_rad > base.overrate_angle_rad


def _smoothed(node: FusedPose, after: FusedPose, base: InertialState, here: InertialState, there: InertialState) -> Estimate:
    """Return the estimate between two nodes, corrected so that the path ends at the next one."""
    state = propagate_mean(node.estimate, base, here)
    share = (here.stamp_s - node.stamp_s) / (after.stamp_s - node.stamp_s)
    end, goal = propagate_mean(node.estimate, base, there), after.estimate
    turn = logarithm(multiply(goal.odom_from_gyro, conjugate(end.odom_from_gyro)))
    return state._replace(
        position_m=_towards(state.position_m, end.position_m, goal.position_m, share),
        velocity_mps=_towards(state.velocity_mps, end.velocity_mps, goal.velocity_mps, share),
        odom_from_gyro=multiply(exponential((share * turn[0], share * turn[1], share * turn[2])), state.odom_from_gyro),
    )


def _towards(here: Vector, end: Vector, goal: Vector, share: float) -> Vector:
    return (
        here[0] + share * (goal[0] - end[0]),
        here[1] + share * (goal[1] - end[1]),
        here[2] + share * (goal[2] - end[2]),
    )
