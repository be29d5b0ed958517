"""The networks of sdf_numba.network on tensors, for any number of levels, with autograd."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import linear

from uav_recon.mapping.neural.sdf_numba.feature_grid import FEATURES
from uav_recon.mapping.neural.sdf_numba.network import COLOUR_OUT, HIDDEN, OUTSIDE_BIAS_M, SHAPE_FEATURES, TRUNCATION_M
from uav_recon.types.frames import Float32Array

Shape = tuple[int, ...]


def shapes(levels: int) -> tuple[Shape, ...]:
    """Return the shapes of w1 b1 w2 b2 c1 d1 c2 d2 c3 d3, in the order of the weight vector."""
    encoded = levels * FEATURES
    layers = (
        (HIDDEN, encoded),
        (1 + SHAPE_FEATURES, HIDDEN),
        (HIDDEN, SHAPE_FEATURES + encoded),
        (HIDDEN, HIDDEN),
        (COLOUR_OUT, HIDDEN),
    )
    return tuple(shape for rows, columns in layers for shape in ((rows, columns), (rows,)))


def initial_weights(levels: int, random: np.random.Generator) -> Float32Array:
    """Return weights uniform in ±1/sqrt(in); the bias of the distance output is zero."""
    parts = []
    for matrix, vector in zip(shapes(levels)[::2], shapes(levels)[1::2], strict=True):
        bound = 1.0 / np.sqrt(matrix[1])
        parts += [random.uniform(-bound, bound, matrix), random.uniform(-bound, bound, vector)]
    parts[3][0] = 0.0
    return np.concatenate([part.ravel() for part in parts]).astype(np.float32)


class Heads:
    """Distance and colour of encoded points for one weight vector (P,)."""

    def __init__(self, weights: Tensor, levels: int) -> None:
        parts = torch.split(weights, [int(np.prod(shape)) for shape in shapes(levels)])
        self._w1, self._b1, self._w2, self._b2, self._c1, self._d1, self._c2, self._d2, self._c3, self._d3 = (
            part.view(shape) for part, shape in zip(parts, shapes(levels), strict=True)
        )

    def distance_m(self, encoded: Tensor) -> Tensor:
        """Return the distances (N,) in metres of encoded points (N, E)."""
        hidden = linear(encoded, self._w1, self._b1).relu()
        return self._metres(linear(hidden, self._w2[:1], self._b2[:1])[:, 0])

    def colour(self, encoded: Tensor) -> tuple[Tensor, Tensor]:
        """Return rgb (N, 3) in 0..1 and the log variance (N,) of its error, for (N, E).

        The log variance only changes its own weights.
        """
        hidden = linear(encoded, self._w1, self._b1).relu()
        geometry = linear(hidden, self._w2[1:], self._b2[1:])
        x = linear(torch.cat([geometry, encoded], dim=1), self._c1, self._d1).relu()
        x = linear(x, self._c2, self._d2).relu()
        rgb = linear(x, self._c3[:3], self._d3[:3]).sigmoid()
        return rgb, linear(x.detach(), self._c3[3:], self._d3[3:])[:, 0]

    @staticmethod
    def _metres(raw: Tensor) -> Tensor:
        return raw * float(TRUNCATION_M) + float(OUTSIDE_BIAS_M)
