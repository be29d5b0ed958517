"""Rest before the flight: where down is, and what the gyro measures at rest."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from uav_recon.localization.fusion.imu_integration import GRAVITY_MPS2
from uav_recon.types.camera import ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

_REST_S = 0.5  #: refuse: no pose of our own before the inertial samples were at rest for this time
_KEPT_S = 1.0  #: internal: the rest is measured over the inertial samples of this time
STILL_S = 0.3  #: internal: time over which the rest on the pad is measured
#: internal: a body that turns faster has moved for the first time; until then it stands on the pad
_STILL_RADPS = 0.02
#: internal: with a larger standard deviation of the specific force the motors run. Then the rest on the pad ends ...
_STILL_MPS2 = 0.3
#: internal: ... when its mean differs from that of the rest by more, four times its noise; an image shows a lift earlier
_LIFTS_MPS2 = 0.6
_WITHOUT_S = 0.25  #: refuse: without inertial samples for this time, the body is taken as level
_MAX_SPREAD_RADPS = 0.05  #: refuse: a larger standard deviation of the turn rate is no rest
_MAX_RATE_RADPS = 0.1  #: refuse: nor a larger mean
_MAX_GRAVITY_ERROR_MPS2 = 1.0  #: refuse: nor a specific force that differs more from gravity


class RestDetector:
    """Collects inertial samples until the body is at rest."""

    def __init__(self) -> None:
        self._samples: deque[ImuSample] = deque()
        self._since_s = math.inf
        self.gyro_bias_radps: FloatArray = np.zeros(3)
        self._force_mps2: FloatArray | None = None

    def add(self, samples: list[ImuSample]) -> None:
        """Add inertial samples; the oldest are dropped, and those without a specific force."""
        self._samples.extend(sample for sample in samples if np.isfinite(sample.specific_force_mps2).all())
        while self._samples and self._samples[-1].stamp_s - self._samples[0].stamp_s > _KEPT_S:
            self._samples.popleft()

    @property
    def measured(self) -> bool:
        """True if there are inertial samples."""
        return bool(self._samples)

    def still(self, stamp_s: float) -> bool:
        """Return True while the newest inertial samples are those of a body that stands.

        Its motors may run: until it lifts, the specific force shakes about that of the rest.
        """
        newest = [sample for sample in self._samples if sample.stamp_s > stamp_s - STILL_S]
        if not newest:
            return False
        rate = np.array([sample.gyro_radps for sample in newest]) - self.gyro_bias_radps
        force = np.array([sample.specific_force_mps2 for sample in newest])
        if np.abs(rate.mean(axis=0)).max() >= _STILL_RADPS or rate.std(axis=0).max() >= _MAX_SPREAD_RADPS:
            return False
        stands = self._force_mps2 is not None and np.abs(force.mean(axis=0) - self._force_mps2).max() < _LIFTS_MPS2
        return bool(force.std(axis=0).max() < _STILL_MPS2 or stands)

    def level(self, stamp_s: float) -> Pose | None:
        """Return odom_from_body of a body at rest with heading zero; None while it is not known.

        Sets ``gyro_bias_radps``. Without inertial samples the body is taken as level.
        """
        self._since_s = min(self._since_s, stamp_s)
        if not self._samples:
            return Pose.identity() if stamp_s - self._since_s >= _WITHOUT_S else None
        if self._samples[-1].stamp_s - self._samples[0].stamp_s < _REST_S:
            return None
        rate = np.array([sample.gyro_radps for sample in self._samples])
        force = np.array([sample.specific_force_mps2 for sample in self._samples]).mean(axis=0)
        mean, spread = rate.mean(axis=0), rate.std(axis=0)
        still = spread.max() <= _MAX_SPREAD_RADPS and np.abs(mean).max() <= _MAX_RATE_RADPS
        if not (still and abs(float(np.linalg.norm(force)) - GRAVITY_MPS2) <= _MAX_GRAVITY_ERROR_MPS2):  # nor for NaN
            return None
        self.gyro_bias_radps, self._force_mps2 = mean, force
        return level_attitude(force)

    def force_offset_mps2(self, odom_from_body: Pose) -> FloatArray:
        """Return what the accelerometer measures beside gravity (3,) at rest.

        odom_from_body: attitude at rest. Body axes; zero without inertial samples.
        """
        if self._force_mps2 is None:
            return np.zeros(3)
        up: FloatArray = odom_from_body.rotation()[2]
        return self._force_mps2 - GRAVITY_MPS2 * up


def level_attitude(up_body: FloatArray) -> Pose:
    """Return odom_from_body with heading zero in which a vector (3,) of the body points up."""
    x, y, z = up_body.tolist()
    roll_rad, pitch_rad = math.atan2(y, z), math.atan2(-x, math.hypot(y, z))
    pitched = Pose(np.array([math.cos(pitch_rad / 2), 0.0, math.sin(pitch_rad / 2), 0.0]), np.zeros(3))
    rolled = Pose(np.array([math.cos(roll_rad / 2), math.sin(roll_rad / 2), 0.0, 0.0]), np.zeros(3))
    return pitched @ rolled
