"""One training step of the numba field on random rays of the known views."""

from __future__ import annotations

import numpy as np

from uav_recon.mapping.neural.keyframes.ray_sampling import Views, draw, make_batch
from uav_recon.mapping.neural.sdf_numba.adam import NumbaAdam
from uav_recon.mapping.neural.sdf_numba.feature_grid import POINTS
from uav_recon.mapping.neural.sdf_numba.losses import TETRAHEDRON, fit_colour, fit_distance, fit_shape
from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.mapping.neural.surface.uncertainty import ColourError
from uav_recon.types.frames import AnyArray, Float32Array


class NumbaTrainingStep:
    """A field, its optimiser and its training step.

    stream (1,) uint64: random state, advanced by every step. colour_error: receives the colour errors of every step.
    """

    def __init__(
        self, low_m: Float32Array, high_m: Float32Array, seed: int, stream: AnyArray, colour_error: ColourError
    ) -> None:
        self._low = low_m
        self._high = high_m
        self._stream = stream
        self._colour_error = colour_error
        self.field = NumbaSdfField(low_m.astype(np.float64), high_m.astype(np.float64), seed)
        self._optimiser = NumbaAdam(self.field)
        self._batch = make_batch()
        self._corners = np.zeros((POINTS, 3), dtype=np.float32)

    @property
    def skipped(self) -> int:
        """Number of steps skipped because their gradient was not finite."""
        return self._optimiser.skipped

    def cover(self, points: Float32Array) -> None:
        """Allocate grid entries for points (N, 3).

        Raises MemoryError; training can continue with the existing entries.
        """
        while not self.field.cover(points):
            capacity = 2 * self.field.capacity
            self._optimiser.grow(capacity)
            self.field.grow(capacity)

    def step(self, views: Views, known: int, rate: float) -> float:
        """Run one step on the first ``known`` views; returns the loss before the step.

        rate: share of the full learning rate.
        """
        f, o, b = self.field, self._optimiser, self._batch
        coloured = int(draw(self._stream, views, known, self._low, self._high, b))
        shared = (f.grid, f.network, o.network_gradient, o.gradient, f.scratch)
        loss = fit_distance(*shared, b.points, b.target_m, b.weight, b.at_least)
        loss += fit_shape(*shared, TETRAHEDRON, self._corners, b.surface, b.normal, b.eikonal_weight, b.normal_weight)
        points, error = b.coloured[:coloured], b.colour_error[:coloured]
        loss += fit_colour(*shared, points, b.rgb[:coloured], b.at_least_rgb[:coloured], b.colour_weight[:coloured], error)
        if o.step(rate):
            self._colour_error.add(points, error)
        return float(loss)
