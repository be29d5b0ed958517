"""One field and how it is taught: a step at a time, from rays drawn at random from the views that it may know."""

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
    """stream (1,) uint64: state of the random numbers, which goes on changing; colour_error: is told of every step's errors."""

    def __init__(
        self, low_m: Float32Array, high_m: Float32Array, seed: int, stream: AnyArray, colour_error: ColourError
    ) -> None:
        self._low, self._high, self._stream, self._colour_error = low_m, high_m, stream, colour_error
        self.field = NumbaSdfField(low_m.astype(np.float64), high_m.astype(np.float64), seed)
        self._optimiser = NumbaAdam(self.field)
        self._batch = make_batch()
        self._corners = np.zeros((POINTS, 3), dtype=np.float32)

    @property
    def skipped(self) -> int:
        """Steps whose gradient was not finite, and which changed nothing."""
        return self._optimiser.skipped

    def cover(self, points: Float32Array) -> None:
        """Make room for what will be learned at points (N, 3). Raises MemoryError; then what there is can be taught on."""
        while not self.field.cover(points):
            capacity = 2 * self.field.capacity
            self._optimiser.grow(capacity)
            self.field.grow(capacity)

    def step(self, views: Views, known: int, rate: float) -> float:
        """Teach what the first ``known`` views say, at a share of the full learning rate; returns the loss before."""
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
