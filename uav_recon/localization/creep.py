"""How fast odom creeps away from what is seen, summed over seconds: one look back tells too little of a slow drift."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.localization.witness import Agreement
from uav_recon.types.frames import FloatArray

_FADES_S = 6.0  # what was seen counts e times less after so long
_PRIOR_S3 = 0.5  # for no creep at all: as much as half of the points say in a second of a view that is a second old
_EXPLAINED, _LONGEST_STEP_S = 0.7, 0.5
_SETTLES_S = 3.0  # odom of its own accord, once it begins: views of then are not asked


class Creep:
    """Least squares for the velocity (3,) by which each shift against a past view is its age times that velocity.

    Directions in which no surface looks are told of by the prior alone. hear() once a picture; it never blocks.
    """

    def __init__(self) -> None:
        self._stamp_s = -math.inf
        self.forget()

    def forget(self) -> None:
        """Odom itself jumped."""
        self._held, self._moved = np.zeros((3, 3)), np.zeros(3)
        self._since_s = math.inf

    def hear(self, stamp_s: float, then: Agreement | None) -> None:
        """What the surfaces of a past view say, None where there is none to ask."""
        step_s = min(max(stamp_s - self._stamp_s, 0.0), _LONGEST_STEP_S)
        fading = math.exp(-step_s / _FADES_S)
        self._stamp_s, self._held, self._moved = stamp_s, fading * self._held, fading * self._moved
        self._since_s = min(self._since_s, stamp_s)
        settled = then is not None and stamp_s - then.age_s >= self._since_s + _SETTLES_S
        if then is not None and settled and then.explained >= _EXPLAINED:
            self._held += step_s * then.age_s**2 * then.held
            self._moved += step_s * then.age_s * then.held @ then.shift_m

    @property
    def velocity_mps(self) -> FloatArray:
        """Of odom against the surfaces, (3,)."""
        return np.asarray(np.linalg.solve(self._held + _PRIOR_S3 * np.eye(3), self._moved), dtype=np.float64)
