"""Texture of the floor for an optical flow sensor: a smooth random field with poor patches."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_WAVES = 12
_FINE_M = (0.8, 3.0)  # wavelengths of the common texture
_PATCH_M = (2.0, 5.0)  # wavelengths of the patches
_MEAN = 0.60
_SPREAD = 0.15
_PATCH_FROM = 0.8  # standard deviations of the patch field
_PATCH_FULL = 2.0  # about a tenth of the floor is beyond the middle between the two
_LOST_IN_PATCH = 0.85  # share of the texture that the middle of a patch lacks


class FloorTexture:
    """Texture of every surface, 0 (none) to 1, drawn from the seed.

    The field is in space, so a table has its own.
    """

    def __init__(self, seed: int) -> None:
        """Draw the plane waves of both fields."""
        rng = np.random.default_rng([seed, 0xF100])
        self._fine = _waves(rng, _FINE_M)
        self._patch = _waves(rng, _PATCH_M)

    def at(self, points_m: F64) -> F64:
        """Return the texture (N,) of points (N, 3), world."""
        common = np.clip(_MEAN + _SPREAD * _field(self._fine, points_m), 0.0, 1.0)
        depth = np.clip((_field(self._patch, points_m) - _PATCH_FROM) / (_PATCH_FULL - _PATCH_FROM), 0.0, 1.0)
        smooth = depth * depth * (3.0 - 2.0 * depth)
        return np.asarray(common * (1.0 - _LOST_IN_PATCH * smooth))


def _waves(rng: np.random.Generator, wavelengths_m: tuple[float, float]) -> tuple[F64, F64]:
    """Return wave vectors (N, 3), rad/m, and phases (N,), rad."""
    directions = rng.standard_normal((_WAVES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lengths_m = rng.uniform(*wavelengths_m, _WAVES)
    return directions * (math.tau / lengths_m)[:, None], rng.uniform(0.0, math.tau, _WAVES)


def _field(waves: tuple[F64, F64], points_m: F64) -> F64:
    """Return the sum of the waves (N,) at points (N, 3), of unit variance over space."""
    vectors, phases = waves
    return np.asarray(math.sqrt(2.0 / _WAVES) * np.cos(points_m @ vectors.T + phases).sum(axis=1))
