"""Bank of filters with and without each inertial sensor; the poses decide between them.

Each filter fuses the same poses (multiple-model estimation: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to
Tracking and Navigation, 2001, section 11.6). An honest IMU makes the first filter the sharpest. An IMU that lies makes its
innovations large, while those of a filter without that sensor stay as expected: that filter then takes over. If the innovations
of all filters are large, the poses are inconsistent, and nothing changes.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from uav_recon.localization.fusion.eskf import Estimate, PoseNoise
from uav_recon.localization.fusion.filter_pose_gates import PoseMeasurement, PoseRejection
from uav_recon.localization.fusion.fusion_history import Arrival, FusedPose, FusionHistory, pose_innovation
from uav_recon.localization.fusion.imu_integration import InertialState, Vector
from uav_recon.localization.fusion.imu_sample_gate import ImuSampleGate
from uav_recon.localization.fusion.propagation_model import GYRO, INERTIAL, KINEMATIC
from uav_recon.types.camera import ImuSample
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_MEMORY_S = 0.4  #: reject: time constant over which the innovations with and without an inertial sensor are compared
#: reject: an inertial sensor is used no more above this mean of the squared innovations with it, whose expected value is six
_SURPRISED_NIS = 15.0
#: reject: ... and if without it the costs (NIS and log determinant of the innovation) are lower by more
_COST_NIS = 2.0
_UNLIKELY_NIS = 12.6  #: reject: ... and above this for each of the newest poses: 95 % of the innovations are below (chi-square)
_SUSPECT_NIS = 9.0  #: reject: a sensor whose mean is above this loses to one pose that only fits without it
_CONTRADICTIONS = 2  #: reject: ... or after this many poses in a row that contradict it
_PROVEN_S = 3.0  #: reject: an inertial sensor that lied, until its innovations are the better ones for this time
_LATE_S = 0.1  # age of the newest pose, over which the odometry is extrapolated
_SWITCH_S = 0.5  # after this time the odometry's covariance no longer contains the step at a change of the filter
_MAX_NIS = 150.0  # limit of one value in the mean; a filter that is not chosen restarts above it
_EXPECTED_NIS = 6.0
#: reject: max. factor on the white variance that a source claims, for one whose poses scatter more: it widens the gates
_MAX_NOISE_FACTOR = 30.0
_NOISE_MEMORY_S = 8.0  #: reject: time constant with which that factor falls again

_IN_A_ROW = (0, 2, 3)  # number of newest poses, before a filter of this index is chosen
_ACCELEROMETER = 1  # index of the first filter without an accelerometer
_GYRO = 2  # ... without a gyro


@dataclass(slots=True)
class _Record:
    """The newest NIS of one filter, their mean, and that of the log determinant."""

    nis: float = _EXPECTED_NIS
    newest: tuple[float, ...] = ()
    log_determinant: float = math.inf  # before the first pose

    def update(self, arrival: Arrival, share: float) -> None:
        log_determinant = float(np.linalg.slogdet(arrival.covariance)[1])
        self.newest = (*self.newest[1 - max(_IN_A_ROW) :], arrival.nis)
        self.nis += share * (min(arrival.nis, _MAX_NIS) - self.nis)
        if math.isinf(self.log_determinant):
            self.log_determinant = log_determinant
        self.log_determinant += share * (log_determinant - self.log_determinant)

    def surprised(self, in_a_row: int) -> bool:
        """Return True if the innovations are too large, in the mean and each of the newest ones.

        One large innovation is a hard manoeuvre, or a bad pose.
        """
        newest = self.newest[-in_a_row:]
        return self.nis > _SURPRISED_NIS and len(newest) == in_a_row and min(newest) > _UNLIKELY_NIS

    def cost(self, scale: float) -> float:
        """Return the negative log likelihood, up to a constant.

        scale: factor on the expected squares of the innovations. A source that claims too small a covariance raises the NIS of
        all filters, and most that of the sharpest.
        """
        return self.nis / scale + self.log_determinant


class PropagationBank:
    """The filters, and the one whose state is the odometry. Not thread-safe.

    rejected: counts rejected inertial samples.
    """

    def __init__(self, rejected: Counter[PoseRejection]) -> None:
        self.accelerometer_excluded = False  # another track of the body contradicts the accelerometer, too
        self._gate = ImuSampleGate(rejected)
        self._histories = tuple(FusionHistory(model) for model in (INERTIAL, GYRO, KINEMATIC))
        self._records = [_Record() for _ in self._histories]
        self._chosen = 0
        self._better_since_s = math.inf
        self._compared_s = -math.inf
        self._switched_s = -math.inf
        self._switch_m = 0.0  # distance between the filters when the chosen one changed
        self._noise_scale = 1.0  # of the white variance that the source claims
        self._arrivals: list[Arrival | None] = [None] * len(self._histories)

    @property
    def newest(self) -> FusedPose | None:
        """The newest node of the chosen filter; None before the first."""
        return self._history.newest

    @property
    def _history(self) -> FusionHistory:
        return self._histories[self._chosen]

    def update(self, samples: list[ImuSample], now_s: float) -> None:
        """Add inertial samples, oldest first; invalid ones are counted and dropped."""
        readings = self._gate.admit(samples, now_s)
        for history in self._histories:
            history.update(readings)
        if self._no_accelerometer and self._chosen < _ACCELEROMETER:
            self._choose(_ACCELEROMETER)

    @property
    def _no_accelerometer(self) -> bool:
        return self.accelerometer_excluded or self._gate.accelerometer_frozen or self._gate.without_accelerometer

    def stamp_fault(self, stamp_s: float) -> PoseRejection | None:
        """Return the reason why a stamp cannot be inserted, None if it can."""
        return self._history.stamp_fault(stamp_s)

    def before(self, stamp_s: float) -> FusedPose:
        """Return the newest node that is not younger than a timely stamp."""
        return self._history.before(stamp_s)

    def reaches(self, stamp_s: float) -> bool:
        """Return True if the track goes back to the stamp."""
        return all(history.reaches(stamp_s) for history in self._histories)

    def at(self, stamp_s: float) -> tuple[FusedPose, Estimate, InertialState] | None:
        """Return the node before an instant, and estimate and track there, as FusionHistory."""
        return self._history.at(stamp_s)

    def predict_arrival(self, measurement: PoseMeasurement, noise: PoseNoise) -> Arrival | None:
        """Propagate the filters to a timely pose and return the chosen one's arrival.

        None if its track is too short.
        """
        noise = noise.scaled(self._noise_scale)
        self._arrivals = [
            history.predict_arrival(measurement, noise) if history.stamp_fault(measurement.stamp_s) is None else None
            for history in self._histories
        ]
        return self._arrivals[self._chosen]

    def begin(self, measurement: PoseMeasurement, noise: PoseNoise, velocity_mps: Vector) -> None:
        """Forget the nodes and restart all filters from a pose within the track."""
        for history in self._histories:
            if history.reaches(measurement.stamp_s):
                history.begin(measurement, noise, velocity_mps)
        self._records = [_Record() for _ in self._histories]
        self._choose(self._chosen)

    def enter(self, arrival: Arrival) -> None:
        """Insert a pose that the chosen filter has met; the others fuse it too.

        A filter that cannot continue restarts from it.
        """
        self._arrivals[self._chosen] = arrival
        self._histories[self._chosen].enter(arrival)
        newest = self._histories[self._chosen].newest
        assert newest is not None
        for index, history in enumerate(self._histories):
            if index == self._chosen or newest.stamp_s != arrival.measurement.stamp_s:
                continue  # a pose out of order corrects only the track that is flown by
            other = self._arrivals[index]
            if other is not None and other.measurement is not arrival.measurement:  # as it is after a step of the source's map
                other = self._arrivals[index] = pose_innovation(arrival.measurement, arrival.noise, other.carried, other.here)
            if other is not None and other.nis <= _MAX_NIS:
                history.enter(other)
            elif history.reaches(arrival.measurement.stamp_s):
                history.begin(arrival.measurement, arrival.noise, newest.estimate.velocity_mps)
        self._compare(arrival)

    def alternatives(self, contradictions: int) -> list[Arrival]:
        """Return the arrivals of filters with fewer sensors, if the chosen one is suspect.

        contradictions: number of poses in a row that contradict the chosen one, whether they were fused or not. They accuse the
        accelerometer alone.
        """
        if self._records[self._chosen].nis <= _SUSPECT_NIS:
            accused = self._chosen < _ACCELEROMETER and contradictions >= _CONTRADICTIONS
            without = self._arrivals[_ACCELEROMETER] if accused else None
            return [] if without is None else [without]
        fewer = zip(self._arrivals, self._records, strict=True)
        return [
            arrival
            for arrival, record in list(fewer)[self._chosen + 1 :]
            if arrival is not None and record.nis <= _SURPRISED_NIS
        ]

    def switch_to(self, arrival: Arrival) -> None:
        """Choose the filter of an arrival."""
        self._choose(next(index for index, other in enumerate(self._arrivals) if other is arrival))

    def fault(self) -> Reason | None:
        """Return the reason why not all inertial sensors are used, None if they are."""
        newest = self.newest
        if newest is None or newest.estimate.model is INERTIAL:
            return None
        if self._gate.gyro_frozen:
            return Reason(ReasonCode.IMU_FROZEN)
        if newest.estimate.model is KINEMATIC and self._chosen < _GYRO:
            return Reason(ReasonCode.NO_IMU)
        if self._chosen == _GYRO:
            return Reason(ReasonCode.GYRO_REJECTED)
        if self._gate.without_accelerometer:
            return Reason(ReasonCode.AUTOPILOT_GYRO)
        return Reason(ReasonCode.ACCELEROMETER_FROZEN if self._gate.accelerometer_frozen else ReasonCode.ACCELEROMETER_REJECTED)

    def _compare(self, arrival: Arrival) -> None:
        """Update the records with a fused pose, and choose the most likely filter."""
        share = 1.0 - math.exp(-max(arrival.measurement.stamp_s - self._compared_s, 0.0) / _MEMORY_S)
        self._compared_s = max(self._compared_s, arrival.measurement.stamp_s)
        for record, predicted in zip(self._records, self._arrivals, strict=True):
            if predicted is not None:
                record.update(predicted, share)
        least = min(record.nis for record in self._records) / _EXPECTED_NIS
        slow = 1.0 if least > 1.0 else _MEMORY_S / _NOISE_MEMORY_S
        self._noise_scale = min(max(self._noise_scale * (1.0 + slow * share * (least - 1.0)), 1.0), _MAX_NOISE_FACTOR)
        scale = max(least, 1.0)
        costs = [record.cost(scale) for record in self._records]
        here = self._chosen
        fewer = [
            k
            for k in range(here + 1, len(costs))
            if costs[here] - costs[k] > _COST_NIS
            and self._records[k].nis <= _SURPRISED_NIS
            and self._records[here].surprised(_IN_A_ROW[k])
        ]
        if fewer:
            self._choose(min(fewer, key=lambda k: costs[k]))
            return
        self._restore(costs, arrival.measurement.stamp_s)

    def _restore(self, costs: list[float], stamp_s: float) -> None:
        """Use a sensor again once it has been the better choice for a while."""
        first = _ACCELEROMETER if self._no_accelerometer else 0
        more = [k for k in range(first, self._chosen) if costs[k] <= costs[self._chosen] + _COST_NIS]
        if not more:
            self._better_since_s = math.inf
            return
        self._better_since_s = min(self._better_since_s, stamp_s)
        if stamp_s - self._better_since_s >= _PROVEN_S:
            self._choose(min(more, key=lambda k: costs[k]))

    def switch_variance_m2(self, stamp_s: float) -> float:
        """Return the variance per axis that a recent change of the filter adds to the position."""
        left = 1.0 - (stamp_s - self._switched_s) / _SWITCH_S
        return max(min(left, 1.0), 0.0) * self._switch_m**2 / 3.0

    def _choose(self, index: int) -> None:
        old, new = self._arrivals[self._chosen], self._arrivals[index]
        if old is not None and new is not None and index != self._chosen:
            self._switched_s = new.measurement.stamp_s
            apart_m = math.dist(old.carried.position_m, new.carried.position_m)
            self._switch_m = apart_m + _LATE_S * math.dist(old.carried.velocity_mps, new.carried.velocity_mps)
        self._chosen = index
        self._better_since_s = math.inf
