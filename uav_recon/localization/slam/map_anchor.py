"""Map anchor: how far the surroundings may be off against the map from before.

New landmarks are placed from the present pose and have its error. They hold the camera well to themselves, so the covariance of
the registration shrinks, and the error stays. It ends when depth shows a surface of the map from before in all directions.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.localization.slam.landmarks import Landmarks
from uav_recon.localization.slam.rgbd_registration import Registration
from uav_recon.types.frames import FloatArray

SURE_M = 0.05  # within twice this the nearest fit of depth is the right one
_ANCHORED_M = 0.01  # uncertainty of a place that depth determines
_DETERMINED_M = 0.02  # standard deviation of the place by depth alone
_FIT_SHARE = 0.85
_COVERAGE_SHARE = 0.5
_FEWEST_LANDMARKS = 8
_OLDEST_SHARE = 0.2  # the oldest landmarks say where the place is


class MapAnchor:
    """Standard deviation (m) of the surroundings against the map from before, per axis. Not thread-safe."""

    def __init__(self) -> None:
        self.sigma_m = 0.0

    def total_m(self, covariance: FloatArray) -> float:
        """Return the standard deviation of a place against the map from before, in its worst direction.

        covariance (3, 3): of the place against the surroundings.
        """
        return math.hypot(self.sigma_m, _worst_m(covariance))

    def settle(self, found: Registration, followed: Landmarks, prior: FloatArray, proven: bool) -> None:
        """Take a believed frame.

        prior (3, 3): covariance of the predicted place against the surroundings. proven: a search found no other place that
        fits.
        """
        before_m, step_m = self.total_m(prior), _worst_m(prior)
        if determined(found) and (proven or before_m <= SURE_M):
            self.sigma_m = _ANCHORED_M
            return
        known = found.landmarks >= _FEWEST_LANDMARKS
        oldest_m = float(np.quantile(followed.born_m, _OLDEST_SHARE)) if known else before_m
        if known:
            self.sigma_m = max(self.sigma_m, oldest_m)
        if step_m > SURE_M:  # what is not known to be the map from before may not make the place more certain
            needed_m2 = min(oldest_m, before_m) ** 2 - _worst_m(found.covariance[3:, 3:]) ** 2
            self.sigma_m = max(self.sigma_m, math.sqrt(max(needed_m2, 0.0)))


def determined(found: Registration) -> bool:
    """Return True if depth alone shows the place against the map."""
    return found.depth_sigma_m <= _DETERMINED_M and found.fit >= _FIT_SHARE and found.coverage >= _COVERAGE_SHARE


def _worst_m(covariance: FloatArray) -> float:
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
