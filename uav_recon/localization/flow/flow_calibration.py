"""Flow calibration: scale and delay of optical flow, estimated against a track that is sure.

The lens of a sensor gives its scale, known to some per cent; a driver stamps a reading when it arrives. Each interval of the
track says what the flow should have been. The sums of squares are kept for every delay of a grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray

DELAYS_S = np.arange(0.0, 0.151, 0.01)  # of the grid
_SCALE_SIGMA = 0.05  # of a sensor as it is built
_DELAY_S, _DELAY_SIGMA_S = 0.03, 0.03  # of a sensor as it is stamped
_LEAST_SCALE_FACTOR = 0.8  #: internal: the estimated scale of optical flow is at least this
_LARGEST_SCALE_FACTOR = 1.25  #: internal: the estimated scale of optical flow is at most this
_SHARED = 2.0  # variance of an interval: those that follow each other share errors
_KEEP = 0.995  # of the sums, with each interval
_SMALLEST_SCALE_SIGMA, _SMALLEST_DELAY_SIGMA_S = 0.004, 0.002  # what the model leaves out
_OUTLIER_SIGMAS = 4.0  #: reject: an interval of the track that optical flow contradicts by more than this and the next two
_OUTLIER_M = 0.03  #: reject: the same, in metres
_OUTLIER_FACTOR = 0.25  #: reject: the same, as a share of the motion: the scale may be wrong by as much


@dataclass(frozen=True, slots=True)
class FlowErrors:
    """Estimated errors of a flow sensor.

    The flow is ``scale`` times as large as it should be, and ``delay_s`` older than its stamp.
    """

    scale: float = 1.0
    delay_s: float = _DELAY_S
    scale_sigma: float = _SCALE_SIGMA
    delay_sigma_s: float = _DELAY_SIGMA_S


class FlowCalibration:
    """Sums over the intervals of the track. ``errors``: the estimate."""

    def __init__(self) -> None:
        self._expected = 0.0  # sum of the squares of what was expected, in variances of the noise
        self._product = np.zeros(len(DELAYS_S))
        self._measured = np.zeros(len(DELAYS_S))
        self.errors = FlowErrors()

    def add(self, measured_m: FloatArray, expected_m: FloatArray, flow_sigma_m: float, track_sigma_m: float) -> bool:
        """Use an interval of the track. Return False if it contradicts the estimate.

        measured_m: (K, 3), integral of distance times flow for each delay of DELAYS_S, with a scale of one. expected_m: (3,),
        the same by the track and the gyro. flow_sigma_m: rms noise of a component. track_sigma_m: likewise of the track.
        """
        variance_m2 = _SHARED * (flow_sigma_m**2 + track_sigma_m**2)
        now_m = np.array([np.interp(self.errors.delay_s, DELAYS_S, measured_m[:, k]) for k in range(3)])
        error_m = float(np.linalg.norm(now_m - self.errors.scale * expected_m))
        size_m = float(np.linalg.norm(expected_m))
        if error_m > _OUTLIER_SIGMAS * math.sqrt(variance_m2) + _OUTLIER_M + _OUTLIER_FACTOR * size_m:
            return False
        self._expected = _KEEP * self._expected + max(size_m**2 - 2.0 * track_sigma_m**2, 0.0) / variance_m2
        self._product = _KEEP * self._product + measured_m @ expected_m / variance_m2
        self._measured = _KEEP * self._measured + np.sum(measured_m**2, axis=1) / variance_m2
        self.errors = self._estimate()
        return True

    def _estimate(self) -> FlowErrors:
        """Return the most likely errors, with standard deviations from the curvature of the cost."""
        weight = 1.0 / _SCALE_SIGMA**2
        scales = np.clip((self._product + weight) / (self._expected + weight), _LEAST_SCALE_FACTOR, _LARGEST_SCALE_FACTOR)
        costs = self._measured - 2.0 * scales * self._product + scales**2 * self._expected
        costs = costs + weight * (scales - 1.0) ** 2 + ((DELAYS_S - _DELAY_S) / _DELAY_SIGMA_S) ** 2
        best = int(np.clip(np.argmin(costs), 1, len(DELAYS_S) - 2))
        left, middle, right = costs[best - 1 : best + 2]
        curvature = max(float(left - 2.0 * middle + right), 1e-9)
        step_s = float(DELAYS_S[1])
        shift = min(max(0.5 * float(left - right) / curvature, -1.0), 1.0)
        delay_s = min(max(float(DELAYS_S[best]) + shift * step_s, 0.0), float(DELAYS_S[-1]))
        delay_sigma_s = min(step_s * math.sqrt(2.0 / curvature), _DELAY_SIGMA_S)
        scale_sigma = 1.0 / math.sqrt(self._expected + weight)
        return FlowErrors(
            scale=float(np.interp(delay_s, DELAYS_S, scales)),
            delay_s=delay_s,
            scale_sigma=math.hypot(scale_sigma, _SMALLEST_SCALE_SIGMA),
            delay_sigma_s=math.hypot(delay_sigma_s, _SMALLEST_DELAY_SIGMA_S),
        )
