"""Calibration filter: drift of odom and errors of the camera, from differences of views.

An apparent surface point p of a frame is off by

    e = tau (v + w x (p - c)) + R (phi x q) + s (p - c) + f R (qx, qy, 0) + R d        q = R^T (p - c)

with the camera's position c, rotation R, velocity v and turn rate w in odom at the stamp: the frame shows where the camera was
tau before its stamp, the mount is rotated by phi and moved by d, depth is too large by the share s, and the image too wide by
the share f. Two views of one surface differ by the difference of their e, and by the drift of odom times the time between them.
All of it is linear. A Kalman filter keeps the errors, which hardly change, apart from the drift, which does: the errors show
when the camera turns, accelerates, or looks at a surface from elsewhere. What no motion has shown stays at its prior, zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from uav_recon.types.camera_calibration import ERROR_SIGMAS, CameraCalibration
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

# elements of the state
DRIFT = slice(0, 3)  # m/s, odom axes
DELAY = 3  # s
ROTATION = slice(4, 7)  # rad, axes of the depth imager
SCALE = 7
WIDTH = 8
OFFSET = slice(9, 12)  # m, axes of the depth imager
GEOMETRY = 12  # number of elements that concern depth; then the same of the colour imager, against the poses
COLOUR_DELAY = 12
COLOUR_ROTATION = slice(13, 16)
COLOUR_WIDTH = 16
SIZE = 17

_DRIFT_TIME_S = 2.5  # correlation time of the drift
_MEMORY_S = 60.0
_DRIFT_MPS = 0.03  # prior standard deviations, of honest cameras
_COLOUR_DELAY_S = 0.02
_COLOUR_ROTATION_RAD = math.radians(0.4)
# an error is corrected in full below, and not at all above these shares of its prior standard deviation
_OBSERVED = 0.5
_UNOBSERVED = 0.7
_MOST_SIGMAS = 2.5  # max. correction, in prior standard deviations
# variance that is added to a kept error, as a share of the prior's: somebody may have touched the camera
_TOUCHED_SHARE = 0.3
# variance of the displacement between two views that one second of comparisons measures
_UNIT_M2S = 3e-5

Elements = tuple[tuple[str, float, float], ...]  # errors of the camera: name with unit, value, standard deviation

NAMES = {
    **{name: DELAY + k for k, name in enumerate(ERROR_SIGMAS)},
    "colour_delay_s": COLOUR_DELAY,
    **{f"colour_rotation_{axis}_rad": COLOUR_ROTATION.start + k for k, axis in enumerate("xyz")},
    "colour_width": COLOUR_WIDTH,
}  # elements of the state that are errors of the camera
_PRIOR = np.array(
    [
        *(_DRIFT_MPS,) * 3, *ERROR_SIGMAS.values(),
        _COLOUR_DELAY_S, *(_COLOUR_ROTATION_RAD,) * 3, ERROR_SIGMAS["width"],
    ]
)  # fmt: skip


class CalibrationFilter:
    """State (17,) and covariance (17, 17); not thread-safe.

    memory_s: time in which an error of the camera may change by a prior standard deviation; in flight it is short, because
    comparisons are not independent and mounts are shaken.
    """

    def __init__(self, memory_s: float = _MEMORY_S) -> None:
        self._memory_s = memory_s
        self.state = np.zeros(SIZE)
        self.covariance = np.diag(_PRIOR**2)

    def begin(self, kept: Elements) -> None:
        """Begin from the errors that an earlier flight has observed, as widened priors.

        See kept_fault for what they may be.
        """
        for name, value, sigma in kept:
            k = NAMES[name]
            self.state[k] = value
            self.covariance[k, :] = self.covariance[:, k] = 0.0
            self.covariance[k, k] = min(sigma**2 + _TOUCHED_SHARE**2 * _PRIOR[k] ** 2, _PRIOR[k] ** 2)

    def forget_drift(self) -> None:
        """Forget the drift after a jump of odom; the errors of the camera are still those."""
        self._decay_drift(0.0)

    def predict(self, step_s: float, *, at_rest: bool = False) -> None:
        """Let the drift decay, and the camera's errors change slowly unless it is at rest."""
        self._decay_drift(math.exp(-step_s / _DRIFT_TIME_S))
        if at_rest:
            return
        errors = np.arange(DRIFT.stop, SIZE)
        self.covariance[errors, errors] += step_s / self._memory_s * _PRIOR[errors] ** 2

    def update(self, information: FloatArray, weighted: FloatArray) -> None:
        """Add comparisons.

        information (17, 17): sum of weight * row * row^T, weighted (17,): of weight * row * displacement (m), over the
        comparisons, times their duration (s).
        """
        before = np.linalg.inv(self.covariance)
        covariance = np.linalg.inv(before + information / _UNIT_M2S)
        self.state = covariance @ (before @ self.state + weighted / _UNIT_M2S)
        self.covariance = 0.5 * (covariance + covariance.T)

    def calibration(self) -> CameraCalibration:
        """Return the errors of the depth imager as known now.

        What has not been observed is left out, and nothing is larger than an honest camera's error.
        """
        unknown, most = np.sqrt(np.diagonal(self.covariance)) / _PRIOR, _MOST_SIGMAS * _PRIOR
        observed = np.clip((_UNOBSERVED - unknown) / (_UNOBSERVED - _OBSERVED), 0.0, 1.0)
        x = observed * np.clip(self.state, -most, most)
        wrong = Pose.from_rotation_vector(x[ROTATION], x[OFFSET])
        return CameraCalibration(float(x[DELAY]), wrong.inverse(), float(x[SCALE]))

    def summary(self) -> Elements:
        """Return the errors of the camera as known now."""
        sigma = np.sqrt(np.diagonal(self.covariance))
        return tuple((name, float(self.state[k]), float(sigma[k])) for name, k in NAMES.items())

    @property
    def drift_mps(self) -> FloatArray:
        """Velocity (3,) of odom against the surfaces."""
        return np.array(self.state[DRIFT])

    def drift_at_least_mps(self, sigmas: float) -> float:
        """Return the drift less a number of its standard deviations."""
        drift = self.state[DRIFT]
        speed_mps = float(np.linalg.norm(drift))
        if speed_mps < 1e-9:
            return 0.0
        way = drift / speed_mps
        return max(speed_mps - sigmas * math.sqrt(float(way @ self.covariance[DRIFT, DRIFT] @ way)), 0.0)

    def _decay_drift(self, keep: float) -> None:
        self.state[DRIFT] *= keep
        self.covariance[DRIFT, :] *= keep
        self.covariance[:, DRIFT] *= keep
        self.covariance[DRIFT, DRIFT] += (1.0 - keep * keep) * _DRIFT_MPS**2 * np.eye(3)


def observed(elements: Iterable[tuple[str, float, float]]) -> Elements:
    """Return the errors that motion has shown: their deviation has left that of the prior."""
    return tuple(each for each in elements if each[2] <= _UNOBSERVED * _PRIOR[NAMES[each[0]]])


def prior_sigma(name: str) -> float:
    """Return the standard deviation of an error before anything has shown it."""
    return float(_PRIOR[NAMES[name]])


def kept_fault(elements: Elements) -> str:
    """Return what is wrong with kept errors, '' for nothing.

    No honest camera has errors beyond the prior's bounds, and a deviation is between zero and the prior's.
    """
    for name, value, sigma in elements:
        if name not in NAMES:
            return f"unknown element {name}"
        prior = _PRIOR[NAMES[name]]
        if not abs(value) <= _MOST_SIGMAS * prior:
            return f"{name} {value:.4g} is outside -{_MOST_SIGMAS * prior:.4g} to {_MOST_SIGMAS * prior:.4g}"
        if not 0.0 < sigma <= prior:
            return f"{name} has a deviation of {sigma:.4g}, not in 0 to {prior:.4g}"
    return ""
