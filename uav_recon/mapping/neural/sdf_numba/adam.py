"""Adam (Kingma and Ba 2015) for the network weights and the touched grid entries."""

from __future__ import annotations

from typing import Any

import numpy as np

from uav_recon.geometry.jit import fast_kernel
from uav_recon.mapping.neural.sdf_numba.feature_grid import FEATURES, Gradient, make_gradient
from uav_recon.mapping.neural.sdf_numba.network import PARAMETERS, Network, views
from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.types.frames import Float32Array

BETA_1 = np.float32(0.9)
BETA_2 = np.float32(0.99)
EPSILON = np.float32(1e-15)  # for the grid, whose gradients are tiny
WEIGHT_EPSILON = np.float32(1e-8)
GRID_RATE = 2e-2
WEIGHT_RATE = 4e-3
PREFETCH_SLOTS = 64  # slots fetched together: they fit into the first-level cache

_ONE = np.float32(1.0)


class NumbaAdam:
    """Gradients and moments of the parameters of a field.

    skipped: number of steps skipped because their gradient was not finite.
    """

    def __init__(self, field: NumbaSdfField) -> None:
        self._step = 0
        self.skipped = 0
        self._allocate(field)

    def _allocate(self, field: NumbaSdfField) -> None:
        self._field = field
        self.gradient: Gradient = make_gradient(field.grid.features.shape[0])
        self.flat_gradient = np.zeros(PARAMETERS, dtype=np.float32)
        self.network_gradient: Network = views(self.flat_gradient)
        self._weight_moments = np.zeros((2, PARAMETERS), dtype=np.float32)
        self._slot_moments = _slot_moments(field.grid.features.shape[0])

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a checkpoint: the moments only, as gradients are zero between steps."""
        return {
            "field": self._field,
            "weight_moments": self._weight_moments,
            "slot_moments": self._slot_moments[: self._field.slots],
            "step": self._step,
            "skipped": self.skipped,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._allocate(state["field"])
        self._weight_moments = state["weight_moments"]
        self._step = state["step"]
        self.skipped = state["skipped"]
        self._slot_moments[: self._field.slots] = state["slot_moments"]

    def grow(self, slots: int) -> None:
        """Allocate memory for more slots, between steps.

        Call before NumbaSdfField.grow(): a larger capacity here does no harm. Raises MemoryError and then leaves everything
        unchanged.
        """
        held = self.gradient.row.shape[0]
        if slots <= held:
            return
        moments = _slot_moments(slots)
        moments[:held] = self._slot_moments
        self.gradient = make_gradient(slots)
        self._slot_moments = moments

    def step(self, rate_factor: float = 1.0) -> bool:
        """Apply and clear the gradients; returns False if one was not finite.

        Such a step is counted and changes nothing else. rate_factor: share of the full learning rate.
        """
        if not self._finite():
            self._clear()
            self.skipped += 1
            return False
        self._step += 1
        first, second = self._weight_moments
        rate = WEIGHT_RATE * rate_factor
        step_weights(self._field.parameters, self.flat_gradient, first, second, rate, self._step)
        rate = GRID_RATE * rate_factor
        step_slots(self._field.grid.features, self.gradient, self._slot_moments, rate, self._step)
        return True

    def _finite(self) -> bool:
        """Return True if the sum of the squares of all gradients is finite.

        The second moments need exactly this. Takes 0.1 ms.
        """
        slots = self.gradient.features[: int(self.gradient.rows[0])].reshape(-1)
        return bool(np.isfinite(np.vdot(self.flat_gradient, self.flat_gradient)) and np.isfinite(np.vdot(slots, slots)))

    def _clear(self) -> None:
        rows = int(self.gradient.rows[0])
        self.flat_gradient[:] = 0.0
        self.gradient.features[:rows] = 0.0
        self.gradient.row[self.gradient.touched[:rows]] = -1
        self.gradient.rows[0] = 0


def _slot_moments(slots: int) -> Float32Array:
    """Return zero moments (slots, 2, 16): first, then second moments, side by side in memory.

    The step is limited by memory access, not by arithmetic.
    """
    return np.zeros((slots, 2, 8 * FEATURES), dtype=np.float32)


@fast_kernel
def step_weights(
    value: Float32Array, gradient: Float32Array, first: Float32Array, second: Float32Array, rate: float, step: int
) -> None:
    """Run one step on vectors (P,), with bias correction for step number ``step`` (from 1)."""
    scale = _corrected(rate, step)
    for i in range(value.shape[0]):
        g = gradient[i]
        first[i] = BETA_1 * first[i] + (_ONE - BETA_1) * g
        second[i] = BETA_2 * second[i] + (_ONE - BETA_2) * g * g
        value[i] -= scale * first[i] / (np.sqrt(second[i]) + WEIGHT_EPSILON)
        gradient[i] = 0.0


@fast_kernel
def step_slots(value: Float32Array, gradient: Gradient, moments: Float32Array, rate: float, step: int) -> np.float32:
    """Run one step on the touched slots of features (S, 16).

    Entries without a gradient keep their value and moments. Slots are scattered in memory. Each batch of slots is read
    first, so that the processor waits for all cache misses at once: this takes a third of the time. Returns the sum of the
    values read, which keeps the compiler from removing those reads.
    """
    scale = _corrected(rate, step)
    read, rows = np.float32(0.0), gradient.rows[0]
    for start in range(0, rows, PREFETCH_SLOTS):
        end = min(start + PREFETCH_SLOTS, rows)
        for n in range(start, end):
            slot = np.uint64(gradient.touched[n])
            read += value[slot, 0] + moments[slot, 0, 0] + moments[slot, 1, 0]
            gradient.row[slot] = -1
        for n in range(start, end):
            slot = np.uint64(gradient.touched[n])
            step_of, moment, parameter = gradient.features[n], moments[slot], value[slot]
            for i in range(8 * FEATURES):
                g = step_of[i]
                hit = g != 0.0
                m = BETA_1 * moment[0, i] + (_ONE - BETA_1) * g
                v = BETA_2 * moment[1, i] + (_ONE - BETA_2) * g * g
                moment[0, i] = m if hit else moment[0, i]
                moment[1, i] = v if hit else moment[1, i]
                parameter[i] -= scale * m / (np.sqrt(v) + EPSILON) if hit else np.float32(0.0)
                step_of[i] = 0.0
    gradient.rows[0] = 0
    return read


@fast_kernel
def _corrected(rate: float, step: int) -> np.float32:
    power = np.float32(min(step, 2000))
    return np.float32(np.float32(rate) * np.sqrt(_ONE - BETA_2**power) / (_ONE - BETA_1**power))
