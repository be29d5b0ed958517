"""Release of a found position error: odometry moves to the right place little by little.

A step would be refused as a jump, and an autopilot would follow it.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.types.frames import FloatArray

_SPEED_MPS = 0.3  #: brake: odometry moves at most this fast to the place that was found


class ErrorRelease:
    """The error (3,) that is still in odometry, at any instant after it was found."""

    def __init__(self) -> None:
        self._error_m: FloatArray = np.zeros(3)
        self._found_s = -math.inf

    def begin(self, stamp_s: float, error_m: FloatArray) -> None:
        """Take an error (3,) found at an instant, in place of what was left of an earlier one."""
        self._error_m, self._found_s = error_m, stamp_s

    def left_m(self, stamp_s: float) -> FloatArray:
        """Return the error (3,) that is left at an instant; zero before one was found."""
        length_m = float(np.linalg.norm(self._error_m))
        if length_m == 0.0 or stamp_s < self._found_s:
            return np.zeros(3)
        return self._error_m * max(1.0 - _SPEED_MPS * (stamp_s - self._found_s) / length_m, 0.0)
