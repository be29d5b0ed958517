"""Integral of a velocity from samples at uneven instants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray


@dataclass(frozen=True, slots=True)
class VelocityIntegral:
    """Weights of the samples in the integral between two instants.

    The velocity is linear between samples.

    weights_s: (N,), s. bridged_s: longest time between two samples within. before_s, after_s: time at either end without a
    sample on both sides, where the nearest sample holds.
    """

    weights_s: FloatArray
    bridged_s: float
    before_s: float
    after_s: float

    @staticmethod
    def between(from_s: float, to_s: float, stamps_s: FloatArray) -> VelocityIntegral:
        """Return the weights for at least one sample with stamps (N,) that increase."""
        low, high = np.clip(stamps_s[:-1], from_s, to_s), np.clip(stamps_s[1:], from_s, to_s)
        apart_s, inside_s = np.diff(stamps_s), high - low
        share = ((low + high) / 2.0 - stamps_s[:-1]) / np.maximum(apart_s, 1e-9)
        weights_s = np.zeros(len(stamps_s))
        weights_s[:-1] += inside_s * (1.0 - share)
        weights_s[1:] += inside_s * share
        before_s, after_s = max(min(stamps_s[0], to_s) - from_s, 0.0), max(to_s - max(stamps_s[-1], from_s), 0.0)
        weights_s[0] += before_s
        weights_s[-1] += after_s
        bridged_s = float(np.max(apart_s[inside_s > 0.0], initial=0.0))
        return VelocityIntegral(weights_s, bridged_s, float(before_s), float(after_s))
