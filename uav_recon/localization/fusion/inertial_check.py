"""Check of the inertial sensors against one track of poses: fault detection over windows.

Over a window the positions of a track are those of the inertial samples, up to a start position and a start velocity. What is
left grows with the square of the time: half the error of the accelerometer. No state of a filter enters, so that no filter
which follows a lying sensor can hide it. The turns are compared the same way.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from uav_recon.localization.fusion.imu_integration import GRAVITY_MPS2, InertialState, conjugate, logarithm, multiply
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

#: reject: windows (s) with the accelerometer's error (m/s²) and the gyro's (rad/s) beyond which the sensor is not used
_LIMITS = ((0.5, 1.8, 0.10), (1.0, 0.9, 0.05))
_SIGMAS = 5.0  #: reject: the same, but never within this many standard deviations of the error
_IN_A_ROW = 2  #: reject: number of poses in a row that must show it
_RIGHT_SHARE = 0.6  #: reject: share of the limit of the longest window, below which a sensor is right again ...
_RIGHT_S = 3.0  #: reject: ... for this time
_SLACK_S = 0.05  #: internal: a window may be longer by this: at 6 Hz stamps that jitter would leave one pose too few
_LEAST_POSES = 4  #: internal: a window of fewer poses shows nothing
_SPAN_SHARE = 0.8  #: internal: nor one that spans a smaller share of its time
_LEARNT_SHARE = 0.3  # of the limit: least standard deviation of an error that the usual one is learnt from
_USUAL_SIGMAS = 3.0  #: reject: nor within this many standard deviations of the usual error, as far as it is not known yet
_USUAL_MPS2 = 0.25  # standard deviation of bias and tilt before the flight
_USUAL_WALK_MPS2 = 0.01  # per root second
_USUAL_RADPS = 0.01
_USUAL_WALK_RADPS = 0.0005
_NOISE_M = 0.003  # least noise of a position
_NOISE_RAD = math.radians(0.1)  # of an attitude
_GRAVITY = np.array([0.0, 0.0, -GRAVITY_MPS2])


class _Sample(NamedTuple):
    stamp_s: float
    pose: Pose
    shown: FloatArray  # (3, 3): share of the position that the pose itself has measured, in odom axes
    noise_m: float  # white noise of the position that the track claims


class _Measured(NamedTuple):
    """Error of a sensor over a window, body axes (3,).

    sigma: its standard deviation per axis. limit: of the window. body_from_odom (3, 3).
    """

    body_from_odom: FloatArray
    error: FloatArray
    sigma: float
    limit: float


class UsualError:
    """Error that a sensor has in any case.

    One part turns with the body, one does not. The first is its bias, the second the tilt of the track. Kalman filter of both
    (6,). sigma: of each before the flight. walk: per root second.
    """

    def __init__(self, sigma: float, walk: float) -> None:
        self._state: FloatArray = np.zeros(6)
        self._covariance: FloatArray = sigma**2 * np.eye(6)
        self._walk = walk

    def predict(self, body_from_odom: FloatArray) -> tuple[FloatArray, float]:
        """Return the error (3,) in body axes at an attitude (3, 3), and its standard deviation."""
        rows = np.hstack((np.eye(3), body_from_odom))
        return rows @ self._state, math.sqrt(float(np.linalg.eigvalsh(rows @ self._covariance @ rows.T)[-1]))

    def learn(self, body_from_odom: FloatArray, error: FloatArray, sigma: float, step_s: float) -> None:
        """Take a measured error (3,)."""
        self._covariance = self._covariance + self._walk**2 * step_s * np.eye(6)
        rows = np.hstack((np.eye(3), body_from_odom))
        spread = rows @ self._covariance @ rows.T + sigma**2 * np.eye(3)
        gain = np.linalg.solve(spread, rows @ self._covariance).T
        self._state = self._state + gain @ (error - rows @ self._state)
        kept = self._covariance - gain @ spread @ gain.T
        self._covariance = 0.5 * (kept + kept.T)


class SensorCheck:
    """One sensor: its usual error, and whether it is used.

    ``fault``: it is not used. ``excess``: largest error beside the usual one, as a multiple of its limit.
    """

    def __init__(self, usual: UsualError) -> None:
        self.fault = False
        self.excess = 0.0
        self._usual = usual
        self._row = 0
        self._right_since_s = math.inf

    def right(self, stamp_s: float) -> bool:
        """Return True if the sensor has been right for a while, whatever was found before."""
        return stamp_s - self._right_since_s >= _RIGHT_S

    def update(self, stamp_s: float, step_s: float, windows: list[_Measured]) -> None:
        """Take the errors of the windows, the longest last."""
        ratios = [self._ratio(measured) for measured in windows]
        self.excess = max(ratios)
        self._row = self._row + 1 if self.excess > 1.0 else 0
        self.fault = self.fault or self._row >= _IN_A_ROW
        if self.excess > 1.0:
            self._right_since_s = math.inf
            return
        longest = windows[-1]
        self._usual.learn(longest.body_from_odom, longest.error, max(longest.sigma, _LEARNT_SHARE * longest.limit), step_s)
        self._right_since_s = min(self._right_since_s, stamp_s) if ratios[-1] < _RIGHT_SHARE else math.inf
        self.fault = self.fault and not self.right(stamp_s)

    def _ratio(self, measured: _Measured) -> float:
        usual, sigma = self._usual.predict(measured.body_from_odom)
        off = float(np.linalg.norm(measured.error - usual))
        return off / max(measured.limit, _SIGMAS * measured.sigma, _USUAL_SIGMAS * sigma)


class InertialCheck:
    """Accelerometer and gyro against one track. Not thread-safe; about 0.3 ms a pose.

    ``judged_s``: stamp of the newest pose for which all windows were known. track_at: the inertial track at an instant, None
    where no samples cover it. Its integrals may restart at any time.
    """

    def __init__(self, track_at: Callable[[float], InertialState | None]) -> None:
        self._track_at = track_at
        self.judged_s = -math.inf
        self.accelerometer = SensorCheck(UsualError(_USUAL_MPS2, _USUAL_WALK_MPS2))
        self.gyro = SensorCheck(UsualError(_USUAL_RADPS, _USUAL_WALK_RADPS))
        self._samples: deque[_Sample] = deque()

    def forget(self) -> None:
        """Forget the track, as after a gap or a jump; what is known of the sensors stays."""
        self._samples.clear()
        self.judged_s = -math.inf

    def update(self, stamp_s: float, pose: Pose, shown: FloatArray, noise_m: float) -> None:
        """Add a pose of the track.

        shown (3, 3): share of its position that the pose has measured itself. noise_m:
        white noise of the position that it claims.
        """
        step_s = stamp_s - self._samples[-1].stamp_s if self._samples else 0.0
        self._samples.append(_Sample(stamp_s, pose, shown, noise_m))
        while stamp_s - self._samples[0].stamp_s > _LIMITS[-1][0] + _SLACK_S:
            self._samples.popleft()
        found = [self._errors(*limits) for limits in _LIMITS]
        known = [errors for errors in found if errors is not None]
        if len(known) == len(_LIMITS):
            self.judged_s = stamp_s
            self.accelerometer.update(stamp_s, step_s, [force for force, _ in known])
            self.gyro.update(stamp_s, step_s, [rate for _, rate in known])

    def _errors(self, window_s: float, force_limit: float, rate_limit: float) -> tuple[_Measured, _Measured] | None:
        """Return what the sensors measure too much over the newest window; None if it shows nothing."""
        newest_s = self._samples[-1].stamp_s
        seen = [sample for sample in self._samples if newest_s - sample.stamp_s <= window_s + _SLACK_S]
        first, last = seen[0], seen[-1]
        span_s = newest_s - first.stamp_s
        if len(seen) < _LEAST_POSES or span_s < _SPAN_SHARE * window_s:
            return None
        track = [here for sample in seen if (here := self._track_at(sample.stamp_s)) is not None]
        if len(track) < len(seen):
            return None
        body, start, end = first.pose.rotation(), track[0], track[-1]
        since_s = np.array([sample.stamp_s for sample in seen]) - first.stamp_s
        turn = body @ Pose(np.array(conjugate(start.gyro_from_body)), np.zeros(3)).rotation()
        swept = np.array([here.position_integral for here in track]) - np.array(start.position_integral)
        swept -= since_s[:, None] * np.array(start.velocity_integral)
        place_m = np.array([sample.pose.translation_m for sample in seen])
        left_m = place_m - swept @ turn.T - 0.5 * since_s[:, None] ** 2 * _GRAVITY
        design = np.column_stack((np.ones(len(seen)), since_s, 0.5 * since_s**2))
        inverse = np.linalg.inv(design.T @ design)
        fitted = inverse @ design.T @ left_m
        noise_m = np.linalg.norm(left_m - design @ fitted) / math.sqrt(3.0 * max(len(seen) - 3, 1))
        shown = first.shown @ last.shown
        force = -body.T @ (shown @ fitted[2])
        measured = logarithm(multiply(conjugate(start.gyro_from_body), end.gyro_from_body))
        turned = (first.pose.inverse() @ last.pose).rotation_vector()
        sigma_m = max(float(noise_m), min(sample.noise_m for sample in seen), _NOISE_M)
        force_sigma = sigma_m * math.sqrt(float(inverse[2, 2]))
        rate_sigma = math.sqrt(2.0) * _NOISE_RAD / span_s
        return (
            _Measured(body.T, force, force_sigma, force_limit),
            _Measured(body.T, (np.array(measured) - turned) / span_s, rate_sigma, rate_limit),
        )
