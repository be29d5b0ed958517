"""Learned field (numba): signed distance (positive in the air) and colour in a box."""

from __future__ import annotations

from typing import Any

import numpy as np

from uav_recon.geometry.jit import fast_kernel
from uav_recon.mapping.neural.sdf_numba.feature_grid import (
    DENSE_BLOCKS,
    POINTS,
    FeatureGrid,
    allocate,
    gather,
    locate,
    make_grid,
)
from uav_recon.mapping.neural.sdf_numba.network import (
    COLOUR_OUT,
    MAX_LOG_VARIANCE,
    MIN_LOG_VARIANCE,
    SHAPE_FEATURES,
    Network,
    Scratch,
    colour_forward,
    distance_alone,
    distance_forward,
    initial_parameters,
    make_scratch,
    views,
)
from uav_recon.types.frames import Float32Array, FloatArray

INITIAL_FEATURE = 1e-2  # new features are uniform in ± this: small, but enough to break the symmetry


class NumbaSdfField:
    """Parameters and queries of the field. Coordinates are in world metres; points are float32."""

    def __init__(self, box_min_m: FloatArray, box_max_m: FloatArray, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self.grid, self.slots = make_grid(box_min_m, box_max_m)
        self._dense_levels = int(np.count_nonzero(self.grid.blocks.prod(axis=1) <= DENSE_BLOCKS))  # the coarsest come first
        self.parameters = initial_parameters(self._random)
        self.network: Network = views(self.parameters)
        self.scratch: Scratch = make_scratch()
        self._fill(1, self.slots)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a checkpoint, without scratch, parameter views and unused slots."""
        capacity, used = self.grid.features.shape[0], self.grid._replace(features=self.grid.features[: self.slots])
        return self.__dict__ | {"grid": used, "capacity": capacity, "network": None, "scratch": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        capacity = state.pop("capacity")
        self.__dict__.update(state)
        features = np.zeros((capacity, self.grid.features.shape[1]), dtype=np.float32)
        features[: self.slots] = self.grid.features
        self.grid = self.grid._replace(features=features)
        self.network = views(self.parameters)
        self.scratch = make_scratch()

    @property
    def capacity(self) -> int:
        """Number of allocated slots."""
        return int(self.grid.features.shape[0])

    def cover(self, points: Float32Array) -> bool:
        """Allocate grid entries for points (N, 3).

        Returns False if all slots are used: call grow(), then cover() again.
        """
        before = self.slots
        self.slots = int(allocate(self.grid, points, self._dense_levels, before, self.capacity))
        self._fill(before, self.slots)
        return self.slots < self.capacity

    def grow(self, capacity: int) -> None:
        """Allocate memory for more slots, after NumbaAdam.grow().

        Raises MemoryError and then leaves everything unchanged.
        """
        grown = np.zeros((capacity, self.grid.features.shape[1]), dtype=np.float32)
        grown[: self.capacity] = self.grid.features
        self.grid = self.grid._replace(features=grown)

    def distance_m(self, points: Float32Array) -> Float32Array:
        """Return the signed distances (N,) at points (N, 3) float32."""
        out = np.empty(points.shape[0], dtype=np.float32)
        query_distance(self.grid, self.network, self.scratch, points, out)
        return out

    def rgb(self, points: Float32Array) -> Float32Array:
        """Return the colours (N, 3) in 0..1 at points (N, 3) float32."""
        return self._coloured(points)[:, :3]

    def colour_sigma(self, points: Float32Array) -> Float32Array:
        """Return the predicted standard deviation (N,) of the colour error, 0..1, at points (N, 3)."""
        log_variance = np.clip(self._coloured(points)[:, 3], MIN_LOG_VARIANCE, MAX_LOG_VARIANCE)
        sigma: Float32Array = np.exp(np.float32(0.5) * log_variance)
        return sigma

    def _coloured(self, points: Float32Array) -> Float32Array:
        out = np.empty((points.shape[0], COLOUR_OUT), dtype=np.float32)
        query_colour(self.grid, self.network, self.scratch, points, out)
        return out

    def _fill(self, start: int, end: int) -> None:
        width = self.grid.features.shape[1]
        fresh = self._random.uniform(-INITIAL_FEATURE, INITIAL_FEATURE, (end - start, width))
        self.grid.features[start:end] = fresh


@fast_kernel
def query_distance(grid: FeatureGrid, net: Network, s: Scratch, points: Float32Array, out: Float32Array) -> None:
    """Compute the distances in metres (N,)."""
    for start in range(0, points.shape[0], POINTS):
        count = min(POINTS, points.shape[0] - start)
        locate(grid, points, start, count, s.node, s.weight)
        gather(grid.features, s.node, s.weight, s.encoded)
        distance_alone(net, s)
        for p in range(count):
            out[start + p] = s.out[0, p]


@fast_kernel
def query_colour(grid: FeatureGrid, net: Network, s: Scratch, points: Float32Array, out: Float32Array) -> None:
    """Compute the colours and the log variance of their error (N, 4)."""
    for start in range(0, points.shape[0], POINTS):
        count = min(POINTS, points.shape[0] - start)
        locate(grid, points, start, count, s.node, s.weight)
        gather(grid.features, s.node, s.weight, s.encoded)
        distance_forward(net, s, 1 + SHAPE_FEATURES)
        colour_forward(net, s)
        for p in range(count):
            for j in range(COLOUR_OUT):
                out[start + p, j] = s.rgb[j, p]
