"""True clearance between the vehicle's hull and the scene, and the height of its support.

Independent of the product. Distances are measured to surface samples 1 cm apart: the error is about 1 cm at contact and
a few millimetres from 10 cm on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sitl.scene.scene import HULL_HEIGHT_M, HULL_RADIUS_M, Scene

CAP_M = 1.0
_SUNK_M = 1e-3  # depth by which a resting hull may lie below the surface it stands on
F64 = NDArray[np.float64]


class HullClearance:
    """Distance from the hull, an upright cylinder centred on the body, to the scene's mesh."""

    def __init__(self, scene: Scene, radius_m: float = HULL_RADIUS_M, height_m: float = HULL_HEIGHT_M) -> None:
        self.bins = scene.samples
        self._radius_m = radius_m
        self._half_height_m = 0.5 * height_m

    def hull_m(self, position_m: ArrayLike) -> float:
        """Return the clearance (m) at a body position (3,) in the world, 0 (contact) to CAP_M."""
        return float(self.batch(np.asarray(position_m, np.float64)[None])[0])

    def batch(self, positions_m: F64) -> F64:
        """Return the clearance (M,), m, at positions (M, 3); fastest if these follow a path."""
        return self.bins.distances(positions_m, self._radius_m, self._half_height_m, CAP_M)

    def standing_m(self, position_m: tuple[float, float, float]) -> float:
        """Return the body height (m) when resting on the highest surface straight below its centre.

        -inf if no surface is below.
        """
        x, y, z = position_m
        return self.bins.highest_below(x, y, z - self._half_height_m + _SUNK_M) + self._half_height_m
