"""Exposure and white balance that wander, as automatic ones do."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sitl.camera.camera_errors import CameraErrors

U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]
_STREAM = 0x704E
_VALUE = np.arange(256) / 255.0
_LIGHT = np.where(_VALUE <= 0.04045, _VALUE / 12.92, ((_VALUE + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1


def tone_table(gains: F64) -> U8:
    """Return the new value of each sRGB value, (C, 256), for the gain (C,) of each channel.

    The gain multiplies linear light.
    """
    light = np.clip(_LIGHT * np.asarray(gains)[:, None], 0.0, 1.0)
    shown = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
    return np.asarray(np.rint(255.0 * shown), np.uint8)


class ColourTone:
    """Bounded random walks of the exposure (stops) and of the gains of red and blue.

    Repeatable for a seed and the stamps.
    """

    def __init__(self, errors: CameraErrors) -> None:
        e = errors.tone
        self._rng = np.random.default_rng([errors.seed, _STREAM])
        self._bound: F64 = np.array([e.exposure_ev, e.balance, e.balance])
        self._rate: F64 = np.array([e.exposure_rate_ev, e.balance_rate, e.balance_rate])
        self._state: F64 = self._bound * self._rng.uniform(-1.0, 1.0, 3)
        self._stamp_s: float | None = None

    def gains(self, stamp_s: float) -> F64:
        """Return the gains of red, green and blue in linear light at stamp_s.

        Stamps must not decrease.
        """
        dt_s = 0.0 if self._stamp_s is None else stamp_s - self._stamp_s
        self._stamp_s = stamp_s
        moved = self._state + self._rate * math.sqrt(max(dt_s, 0.0)) * self._rng.standard_normal(3)
        self._state = np.clip(moved, -self._bound, self._bound)
        stops, red, blue = self._state.tolist()
        return np.array([2.0**stops * math.exp(red), 2.0**stops, 2.0**stops * math.exp(blue)])
