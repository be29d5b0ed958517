"""Depth images that repeat the one before: sent twice by a driver, or by a frozen camera."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.types.frames import Float32Array

FROZEN_S = 0.3  #: reject: an image that repeats for longer is that of a frozen camera; before, a repeat is no frame


class RepeatedImage:
    """The newest depth image, and since when it has been sent."""

    def __init__(self) -> None:
        self._depth_m: Float32Array | None = None
        self._first_s = -math.inf

    def repeats_s(self, stamp_s: float, depth_m: Float32Array) -> float:
        """Return for how long this image has repeated, to the last bit.

        It is 0 for a new image, and for one without returns: a covered lens gives no other. depth_m (H, W), NaN = no return.
        """
        if self._depth_m is None or not np.array_equal(self._depth_m, depth_m, equal_nan=True) or not (depth_m > 0.0).any():
            self._depth_m, self._first_s = depth_m, stamp_s
        return stamp_s - self._first_s
