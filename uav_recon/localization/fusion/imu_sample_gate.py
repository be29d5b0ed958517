"""Gate for inertial samples: drops invalid ones, and notices values that repeat."""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

import numpy as np

from uav_recon.localization.fusion.filter_pose_gates import PoseRejection
from uav_recon.localization.fusion.imu_integration import Vector
from uav_recon.types.camera import ImuSample
from uav_recon.types.frames import FloatArray

_FASTEST_RADPS = 35.0  #: reject: inertial samples beyond: any gyro (2000 degrees/s) saturates there
_HARDEST_MPS2 = 160.0  #: reject: inertial samples beyond: any accelerometer (16 g) saturates there
_FUTURE_S = 0.01  #: reject: inertial samples stamped later than the clock by this
#: reject: inertial values that repeat to the last bit for this time: noise changes each value of a working sensor
_FROZEN_S = 0.1
_WORKS_S = 1.0  #: reject: inertial values until they have changed for this time, after they were frozen

_NO_FORCE = np.full(3, math.nan)


class InertialReading(NamedTuple):
    """An inertial sample as plain numbers, in body axes."""

    stamp_s: float
    rate_radps: Vector
    force_mps2: Vector | None  # None: not measured


class ImuSampleGate:
    """Checks the samples of one IMU in order. ``rejected``: counter, shared with the filter's.

    ``without_accelerometer``: True if the newest sample has no specific force.
    """

    def __init__(self, rejected: Counter[PoseRejection]) -> None:
        self._rejected = rejected
        self._newest_s = -math.inf
        self._rate = _RepeatedValues()
        self._force = _RepeatedValues()
        self.without_accelerometer = False

    @property
    def gyro_frozen(self) -> bool:
        """True while the turn rates repeat."""
        return self._rate.frozen

    @property
    def accelerometer_frozen(self) -> bool:
        """True while the specific forces repeat."""
        return self._force.frozen

    def admit(self, samples: list[ImuSample], now_s: float) -> list[InertialReading]:
        """Return the valid samples, oldest first.

        Dropped and counted: samples that no sensor can measure, that are not newer than the one before, that lie in the future,
        and those of a frozen gyro: without the turn rates the forces have no direction.
        """
        admitted = []
        for sample in samples:
            measured = _vector(sample.specific_force_mps2)
            force = None if all(map(math.isnan, measured)) else measured
            reading = InertialReading(sample.stamp_s, _vector(sample.gyro_radps), force)
            reason = self._fault(reading, now_s)
            if reason is None:
                self._newest_s = reading.stamp_s
                self._rate.update(reading.stamp_s, reading.rate_radps)
                self.without_accelerometer = force is None
                if force is not None:
                    self._force.update(reading.stamp_s, force)
                reason = PoseRejection.IMU_FROZEN if self.gyro_frozen else None
            if reason is None:
                admitted.append(reading)
            else:
                self._rejected[reason] += 1
        return admitted

    def valid(self, samples: list[ImuSample], now_s: float) -> list[ImuSample]:
        """Return the samples that admit() accepts.

        The specific force is NaN while it is not measured or repeats.
        """
        readings = self.admit(samples, now_s)
        return [
            ImuSample(stamp_s, np.array(rate), _NO_FORCE if force is None or self.accelerometer_frozen else np.array(force))
            for stamp_s, rate, force in readings
        ]

    def _fault(self, reading: InertialReading, now_s: float) -> PoseRejection | None:
        stamp_s, rate, force = reading
        if not math.isfinite(stamp_s + sum(rate) + sum(force or ())) or max(map(abs, rate)) > _FASTEST_RADPS:
            return PoseRejection.IMU_NOT_FINITE
        if force is not None and max(map(abs, force)) > _HARDEST_MPS2:
            return PoseRejection.IMU_FORCE
        return None if self._newest_s < stamp_s <= now_s + _FUTURE_S else PoseRejection.IMU_STAMP


class _RepeatedValues:
    """Notices that the values of one sensor repeat, and that they change again."""

    def __init__(self) -> None:
        self.frozen = False
        self._value: Vector | None = None
        self._changed_s = -math.inf  # since when the value repeats
        self._works_s = -math.inf  # since when no value repeated for _FROZEN_S

    def update(self, stamp_s: float, value: Vector) -> None:
        if value != self._value:
            if self._value is None or stamp_s - self._changed_s >= _FROZEN_S:
                self._works_s = stamp_s
            self._value = value
            self._changed_s = stamp_s
        repeats = stamp_s - self._changed_s >= _FROZEN_S
        self.frozen = repeats or (self.frozen and stamp_s - self._works_s < _WORKS_S)


def _vector(values: FloatArray) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)
