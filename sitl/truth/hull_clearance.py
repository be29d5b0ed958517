"""True distance between the vehicle's hull and the scene: what reports call clearance; and what is below it to stand on. It
never asks the product.

Asked of samples of the surface a centimetre apart: exact to about a centimetre at contact, to a few millimetres from 10 cm on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sitl.scene.scene import HULL_HEIGHT_M, HULL_RADIUS_M, Scene

CAP_M = 1.0
_SUNK_M = 1e-3  # what stands may have sunk in so far
F64 = NDArray[np.float64]


class HullClearance:
    """Distance from the hull, an upright cylinder centred on the body, to the scene's mesh."""

    def __init__(self, scene: Scene, radius_m: float = HULL_RADIUS_M, height_m: float = HULL_HEIGHT_M) -> None:
        self.bins = scene.samples
        self._radius_m, self._half_height_m = radius_m, 0.5 * height_m

    def hull_m(self, position_m: ArrayLike) -> float:
        """Clearance in metres at a body position (3,) in the world: 0 in contact, at most CAP_M."""
        return float(self.batch(np.asarray(position_m, np.float64)[None])[0])

    def batch(self, positions_m: F64) -> F64:
        """Clearance (M,) at positions (M, 3); quickest along a way."""
        return self.bins.distances(positions_m, self._radius_m, self._half_height_m, CAP_M)

    def standing_m(self, position_m: tuple[float, float, float]) -> float:
        """Height (m) of the body once it stands on what is straight below its middle; -inf over nothing."""
        x, y, z = position_m
        return self.bins.highest_below(x, y, z - self._half_height_m + _SUNK_M) + self._half_height_m
