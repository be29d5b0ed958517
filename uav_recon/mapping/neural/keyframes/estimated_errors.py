"""Errors of the camera as all views show them together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.types.camera_calibration import ERROR_SIGMAS
from uav_recon.types.frames import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedErrors:
    """Errors of an imager (N,), by name with unit, with their covariance (N, N).

    hidden: names of errors that the poses of the views have too. Their values are against those poses: of the camera, no more
    is known than before.
    """

    names: tuple[str, ...]
    value: FloatArray
    covariance: FloatArray
    hidden: frozenset[str] = frozenset()

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (N,)."""
        return np.sqrt(np.diagonal(self.covariance))

    def elements(self) -> dict[str, tuple[float, float]]:
        """Return value and standard deviation of each error, by name with unit."""
        return {
            name: (float(x), ERROR_SIGMAS[name] if name in self.hidden else float(s))
            for name, x, s in zip(self.names, self.value, self.sigma, strict=True)
        }
