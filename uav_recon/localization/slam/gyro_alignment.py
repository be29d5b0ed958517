"""Gyro and camera: the turn between two frames, the bias, the delay, the angle between them.

A frame shows the body ``delay_s`` before its stamp. The turn that the images show between two frames is that of the gyro, less
its bias, between the two instants that they show. So the delay shows when the turn rate changes, and the bias always. A camera
whose mount is off turns about other axes than the gyro: this shows in a turn, across it.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from uav_recon.localization.fusion.imu_integration import InertialState, InertialTrack, conjugate, logarithm, multiply
from uav_recon.types.camera import ImuSample
from uav_recon.types.frames import FloatArray

_SURPRISE = 16.0  # squared innovation in standard deviations beyond which a comparison is not used
_GAP_S = 0.05  # the gyro measures an interval if its samples come closer than this
_MOST_GAPS = 32  # the newest that are remembered
_RATE_SPAN_S = 0.02  # time over which a turn rate is measured
_DELAY_S = 0.02  # prior standard deviation of the delay
_MOST_DELAY_S = 0.08
_BIAS_RADPS = 0.01  # the same of the bias, before the rest is seen
_REST_BIAS_RADPS = 0.001  # after a rest
_BIAS_WALK = 0.0003  # rad/s per root second
_MOUNT_RAD = math.radians(0.8)  # prior standard deviation of the angle between gyro and camera, per axis
_MOUNT_WALK = math.radians(0.005)  # per root second
_DELAY_WALK = 0.0005  # s per root second
_DRIFT_RAD = math.radians(0.04)  # standard deviation of a turn by the gyro alone
_TURN_RAD = math.radians(0.1)  # standard deviation of the turn that two frames show
JITTER_S = 0.007  # the same of the time between them


_MOUNT = slice(4, 7)


class GyroAlignment:
    """Bias of the gyro, delay of the frames, and angle from gyro to camera.

    Not thread-safe.
    """

    def __init__(self) -> None:
        self._track = InertialTrack(_GAP_S)
        self._gaps: deque[tuple[float, float]] = deque(maxlen=_MOST_GAPS)
        self._force_s = self._forceless_s = -math.inf  # stamps of the newest samples with and without a specific force
        self.used = True  # False: the images have contradicted the gyro
        self._state = np.zeros(7)  # bias, delay, mount
        self._covariance = np.diag([_BIAS_RADPS**2] * 3 + [_DELAY_S**2] + [_MOUNT_RAD**2] * 3)

    @property
    def delay_s(self) -> float:
        """Time from what a frame shows to its stamp."""
        return min(max(float(self._state[3]), -_MOST_DELAY_S), _MOST_DELAY_S)

    @property
    def delay_sigma_s(self) -> float:
        """Standard deviation of the delay."""
        return math.sqrt(self._covariance[3, 3])

    @property
    def bias_radps(self) -> FloatArray:
        """Bias of the gyro (3,)."""
        return self._state[:3].copy()

    def add(self, samples: list[ImuSample]) -> None:
        """Add inertial samples; those that are not newer or not finite are dropped.

        A specific force of NaN was not measured.
        """
        for sample in samples:
            x, y, z = sample.gyro_radps.tolist()
            a, b, c = sample.specific_force_mps2.tolist()
            measured = not all(map(math.isnan, (a, b, c)))
            finite = math.isfinite(sample.stamp_s + x + y + z + (a + b + c if measured else 0.0))
            if sample.stamp_s > self._track.newest_s and finite:
                if sample.stamp_s - self._track.newest_s > _GAP_S and len(self._track):
                    self._gaps.append((self._track.newest_s, sample.stamp_s))
                if measured:
                    self._force_s = sample.stamp_s
                else:
                    self._forceless_s = sample.stamp_s
                self._track.push(sample.stamp_s, (x, y, z), (a, b, c) if measured else None)

    def rest(self, rate_radps: FloatArray) -> None:
        """Take the mean turn rate (3,) of a rest as the bias."""
        self._state[:3] = rate_radps
        self._covariance[:3, :3] = np.eye(3) * _REST_BIAS_RADPS**2

    def turn(self, from_s: float, to_s: float) -> FloatArray | None:
        """Return the rotation vector (3,) in body axes from one frame to another.

        None if the gyro does not cover it.
        """
        a, b = from_s - self.delay_s, to_s - self.delay_s
        return self._turn(a, b)

    def track(self, from_s: float, to_s: float) -> tuple[InertialState, InertialState] | None:
        """Return the inertial track at what two frames show; None if the samples do not cover it."""
        return self.between(from_s - self.delay_s, to_s - self.delay_s)

    def between(self, from_s: float, to_s: float) -> tuple[InertialState, InertialState] | None:
        """Return the inertial track at two instants.

        None if no samples with a specific force cover the time between.
        """
        return self._measured(from_s, to_s) if self._has_force(from_s, to_s) else None

    def turned(self, from_s: float, to_s: float) -> FloatArray | None:
        """Return the rotation vector (3,) in body axes between two instants.

        None if the gyro does not cover it.
        """
        return self._turn(from_s, to_s)

    def rate(self, stamp_s: float) -> FloatArray | None:
        """Return the turn rate (3,) in body axes that a frame shows.

        None if the gyro does not cover it.
        """
        instant_s = stamp_s - self.delay_s
        turned = self._turn(instant_s - _RATE_SPAN_S, instant_s)  # about the camera's axes
        return None if turned is None else turned / _RATE_SPAN_S

    def drift_sigma_rad(self, from_s: float, to_s: float) -> float:
        """Return the standard deviation per axis of turn() against the turn of the body."""
        rate = self.rate(to_s)
        turned_rad = 0.0 if rate is None else float(np.linalg.norm(rate)) * (to_s - from_s)
        mount_rad = math.sqrt(float(np.diagonal(self._covariance)[_MOUNT].max()))
        return math.hypot(_DRIFT_RAD, (to_s - from_s) * math.sqrt(self._covariance[0, 0]), turned_rad * mount_rad)

    def turn_sigma_rad(self, from_s: float, to_s: float) -> float:
        """Return the standard deviation per axis of turn() against what the images show."""
        rate = self.rate(to_s)
        speed = 0.0 if rate is None else float(np.linalg.norm(rate))
        return math.hypot(_TURN_RAD, JITTER_S * speed, (to_s - from_s) * math.sqrt(self._covariance[0, 0]))

    def update(self, from_s: float, to_s: float, turned_rad: FloatArray) -> None:
        """Compare the gyro with the turn (3,) that the images show between two frames."""
        expected, before, after = self.turn(from_s, to_s), self.rate(from_s), self.rate(to_s)
        step_s = to_s - from_s
        self._covariance += step_s * np.diag([_BIAS_WALK**2] * 3 + [_DELAY_WALK**2] + [_MOUNT_WALK**2] * 3)
        if expected is None or before is None or after is None:
            return
        rows = np.column_stack((-step_s * np.eye(3), before - after, -_cross(expected)))
        rate = before if before @ before > after @ after else after
        noise = _TURN_RAD**2 * np.eye(3) + JITTER_S**2 * np.outer(rate, rate)
        innovation, spread = turned_rad - expected, rows @ self._covariance @ rows.T + noise
        if innovation @ np.linalg.solve(spread, innovation) > _SURPRISE:
            return
        gain = np.linalg.solve(spread, rows @ self._covariance).T
        self._state = self._state + gain @ innovation
        kept = np.eye(7) - gain @ rows
        self._covariance = kept @ self._covariance @ kept.T + gain @ noise @ gain.T

    def _measured(self, a_s: float, b_s: float) -> tuple[InertialState, InertialState] | None:
        """Return the track at two instants; None if the samples do not cover the time between them."""
        first, last = self._track.at(a_s), self._track.at(b_s)
        if first is None or last is None or b_s > self._track.newest_s + _GAP_S:
            return None
        return None if any(a_s < end_s and b_s > begin_s for begin_s, end_s in self._gaps) else (first, last)

    def at(self, stamp_s: float) -> InertialState | None:
        """Return the inertial track at an instant, used or not; None if no samples cover it."""
        return self._track.at(stamp_s) if self._has_force(stamp_s, stamp_s) else None

    def _has_force(self, from_s: float, to_s: float) -> bool:
        """Return True if the specific force is measured between two instants."""
        return from_s > self._forceless_s and to_s <= self._force_s + _GAP_S

    def _turn(self, a_s: float, b_s: float) -> FloatArray | None:
        ends = self._measured(a_s, b_s) if self.used else None
        if ends is None:
            return None
        between = multiply(conjugate(ends[0].gyro_from_body), ends[1].gyro_from_body)
        by_x, by_y, by_z, _, mount_x, mount_y, mount_z = self._state.tolist()
        x, y, z = logarithm(between)
        x, y, z = x - (b_s - a_s) * by_x, y - (b_s - a_s) * by_y, z - (b_s - a_s) * by_z
        return np.array([x + mount_y * z - mount_z * y, y + mount_z * x - mount_x * z, z + mount_x * y - mount_y * x])


def _cross(vector: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) whose product with another vector is the cross product of both."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
