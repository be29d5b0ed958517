"""Uncertainty measures of surface points, interchangeable; higher = less certain.

The default counts measurements and checks their agreement; `uav-recon bench uncertainty` reports how well each measure ranks
errors. The others: the network output of the paper; a colour error that is stored in space, so that it cannot extrapolate;
the standard deviation left by the depth measurements (similar to BayesRays, Goli et al. 2024); and the product of the last
two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from uav_recon.geometry.jit import fast_kernel
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray

INFORMATION_CELL_M = 0.08
COLOUR_CELL_M = 0.10
# at most half of the margin of IncrementalSurface
END_CELL_M = 0.05
PLANE_CELL_M = 0.10
ROUND_CELL_M = 0.10
ROUND_STRIDE = 4  # every ROUND_STRIDE-th measurement enters the wider mean: many fall into one cell
COUNT_OFFSET = 0.1  # added to the number of measurements
MIN_DISAGREEMENT = 0.05  # disagreement of equal normals
MIN_PAST_M = 0.001  # distance of a surface from its measurements: resolution
MAX_OFFSET_M = 0.10  # ... without measurements
MIN_COUNT = 0.05  # number of measurements below which there are none
SHARP_SIGMA_M = 0.015  # a measurement with this depth sigma has half the weight of an exact one
PRIOR_SIGMA_M = 1.0  # sigma of a surface that was never measured
# sigma of a colour that was never observed, and the weight of this prior in samples
PRIOR_COLOUR_SIGMA = 0.3
PRIOR_COUNT = 8.0
COLOUR_MEMORY = 400.0  # maximum weight in samples: older errors, from an earlier state of the field, decay


class SurfaceUncertainty(Protocol):
    """Uncertainty of surface points."""

    def at(self, points: Float32Array) -> Float32Array:
        """Return positive numbers (N,) for world points (N, 3); higher = less certain.

        The numbers are comparable within one map.
        """
        ...


class Lattice:
    """Values (nx, ny, nz, C) float32 at the nodes of a regular lattice over a box."""

    def __init__(self, box_min_m: FloatArray, box_max_m: FloatArray, cell_m: float, channels: int) -> None:
        extent = np.asarray(box_max_m, dtype=np.float64) - np.asarray(box_min_m, dtype=np.float64)
        nodes = np.ceil(extent / cell_m).astype(int) + 1
        self.origin_m = np.asarray(box_min_m, dtype=np.float32)
        self.inverse_cell = 1.0 / cell_m
        self.values = np.zeros((*(int(n) for n in nodes), channels), dtype=np.float32)

    def clear(self) -> None:
        """Set all values to zero."""
        self.values[:] = 0.0

    def splat(self, points: Float32Array, amounts: Float32Array) -> None:
        """Add amounts (N, C) at points (N, 3) with trilinear weights; points outside are ignored."""
        _splat(self.values, self.origin_m, self.inverse_cell, points, amounts)

    def at(self, points: Float32Array) -> Float32Array:
        """Return trilinear values (N, C); zero outside."""
        out = np.zeros((points.shape[0], self.values.shape[3]), dtype=np.float32)
        _interpolate(self.values, self.origin_m, self.inverse_cell, points, out)
        return out

    def dot(self, points: Float32Array, weights: Float32Array) -> Float32Array:
        """Return the dot products (N,) of at(points) and weights (N, C).

        The values are not stored in between.
        """
        out = np.empty(points.shape[0], dtype=np.float32)
        _dot(self.values, self.origin_m, self.inverse_cell, points, weights, out)
        return out


class DepthInformation:
    """Standard deviation left by all depth measurements of a point, in metres.

    1 / sqrt(sum of cos² / sigma_z²).
    """

    def __init__(self, box_min_m: FloatArray, box_max_m: FloatArray) -> None:
        self._lattice = Lattice(box_min_m, box_max_m, INFORMATION_CELL_M, 1)

    def add(self, points: Float32Array, cosine: Float32Array, sigma_m: Float32Array) -> None:
        """Add measurements: points (N, 3), viewing cosine (N,), depth sigma (N,)."""
        self._lattice.splat(points, np.square(np.maximum(cosine, 0.15) / sigma_m)[:, None])

    def clear(self) -> None:
        """Forget all measurements."""
        self._lattice.clear()

    def at(self, points: Float32Array) -> Float32Array:
        """Return sigma (N,), at most PRIOR_SIGMA_M."""
        sigma: Float32Array = 1.0 / np.sqrt(self._lattice.at(points)[:, 0] + np.float32(1.0 / PRIOR_SIGMA_M**2))
        return sigma


class ColourError:
    """Standard deviation of the colour error near a point, 0..1.

    It is the optimum of the Gaussian loss, in closed form.
    """

    def __init__(self, box_min_m: FloatArray, box_max_m: FloatArray) -> None:
        self._lattice = Lattice(box_min_m, box_max_m, COLOUR_CELL_M, 2)  # sum of weighted squares, sum of weights

    def add(self, points: Float32Array, error_squared: Float32Array) -> None:
        """Add the colour errors of one training step.

        points (N, 3); error_squared (N,): mean squared error, negative where unknown.
        """
        points, error_squared = points[error_squared >= 0.0], error_squared[error_squared >= 0.0]
        _fade(self._lattice.values, self._lattice.origin_m, self._lattice.inverse_cell, points, COLOUR_MEMORY)
        self._lattice.splat(points, np.stack([error_squared, np.ones_like(error_squared)], axis=1))

    def at(self, points: Float32Array) -> Float32Array:
        """Return sigma (N,); PRIOR_COLOUR_SIGMA where no colour was observed."""
        found = self._lattice.at(points)
        sigma: Float32Array = np.sqrt((found[:, 0] + PRIOR_COUNT * PRIOR_COLOUR_SIGMA**2) / (found[:, 1] + PRIOR_COUNT))
        return sigma.astype(np.float32)


class MeasuredAgreement:
    """Product of three terms: lack of measurements, disagreement of normals, squared offset.

    A measurement is weighted by its sharpness. Lack of measurements: 1 / sqrt(count) on a 5 cm lattice. Disagreement: 1.05
    less the mean resultant length of the measured normals on a 10 cm lattice (1 less that is the spherical variance: Mardia
    and Jupp 2000, section 9.2). Offset of the learned surface: the geometric mean of three distances along the mean normal:
    from the mean of the end points within 5 cm, from that within 10 cm, and the mean distance from all measured planes.
    Noise shifts the near mean and the shape of the surface shifts the wider ones, so a surface with all three offsets is
    wrong. Errors of a field concentrate at edges, corners and clutter.
    """

    def __init__(self, box_min_m: FloatArray, box_max_m: FloatArray) -> None:
        self._ends = Lattice(box_min_m, box_max_m, END_CELL_M, 4)  # sum of end points, number
        self._planes = Lattice(box_min_m, box_max_m, PLANE_CELL_M, 5)  # sum of normals, sum of their planes' offsets, number
        self._round = Lattice(box_min_m, box_max_m, ROUND_CELL_M, 4)  # as _ends, of every ROUND_STRIDE-th measurement

    def add(self, points: Float32Array, normal: Float32Array, sigma_m: Float32Array) -> None:
        """Add end points (N, 3) with unit normals (N, 3) and depth sigma (N,).

        A normal of zero is unknown and agrees with no other.
        """
        count = (np.float32(1.0) / (np.float32(1.0) + np.square(sigma_m / np.float32(SHARP_SIGMA_M))))[:, None]
        place = points - self._ends.origin_m
        offset = np.einsum("nc,nc->n", normal, place)[:, None]
        ends = count * np.concatenate([place, np.ones_like(count)], axis=1)
        self._ends.splat(points, ends)
        self._round.splat(points[::ROUND_STRIDE].copy(), ends[::ROUND_STRIDE].copy())  # contiguous: one compilation
        self._planes.splat(points, count * np.concatenate([normal, offset, np.ones_like(count)], axis=1))

    def clear(self) -> None:
        """Forget all measurements."""
        for lattice in (self._ends, self._planes, self._round):
            lattice.clear()

    def at(self, points: Float32Array) -> Float32Array:
        """Return positive numbers (N,), largest where nothing was measured."""
        out = np.empty(len(points), dtype=np.float32)
        place = points - self._ends.origin_m
        _disagree(self._ends.at(points), self._round.at(points), self._planes.at(points), place, out)
        return out


class NetworkColourSigma:
    """The measure of the paper: the network's own colour sigma.

    It is queried at surface points without a ray direction.
    """

    def __init__(self, colour_sigma: Callable[[Float32Array], Float32Array]) -> None:
        self._colour_sigma = colour_sigma

    def at(self, points: Float32Array) -> Float32Array:
        """Return sigma (N,) of the colour, 0..1."""
        return self._colour_sigma(points)


class ProductUncertainty:
    """The product of two measures."""

    def __init__(self, first: SurfaceUncertainty, second: SurfaceUncertainty) -> None:
        self._first = first
        self._second = second

    def at(self, points: Float32Array) -> Float32Array:
        """Return positive numbers (N,)."""
        return self._first.at(points) * self._second.at(points)


@fast_kernel
def _splat(values: AnyArray, origin: Float32Array, inverse: float, points: Float32Array, amounts: Float32Array) -> None:
    nx, ny, nz, channels = values.shape
    for n in range(points.shape[0]):
        x, y, z = ((points[n, 0] - origin[0]) * inverse, (points[n, 1] - origin[1]) * inverse,
                   (points[n, 2] - origin[2]) * inverse)  # fmt: skip
        if x < 0 or y < 0 or z < 0 or x >= nx - 1 or y >= ny - 1 or z >= nz - 1:
            continue
        i, j, k = int(x), int(y), int(z)
        u, v, w = x - i, y - j, z - k
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    share = (u if a else 1 - u) * (v if b else 1 - v) * (w if c else 1 - w)
                    for channel in range(channels):
                        values[i + a, j + b, k + c, channel] += share * amounts[n, channel]


@fast_kernel
def _interpolate(values: AnyArray, origin: Float32Array, inverse: float, points: Float32Array, out: Float32Array) -> None:
    nx, ny, nz, channels = values.shape
    flat = values.reshape(-1)
    for n in range(points.shape[0]):
        x, y, z = ((points[n, 0] - origin[0]) * inverse, (points[n, 1] - origin[1]) * inverse,
                   (points[n, 2] - origin[2]) * inverse)  # fmt: skip
        if x < 0 or y < 0 or z < 0 or x >= nx - 1 or y >= ny - 1 or z >= nz - 1:
            continue
        i, j, k = int(x), int(y), int(z)
        u, v, w = np.float32(x - i), np.float32(y - j), np.float32(z - k)
        step_x, step_y, step_z = np.uint64(ny * nz * channels), np.uint64(nz * channels), np.uint64(channels)
        at = np.uint64(((i * ny + j) * nz + k) * channels)
        u0, v0, w0 = np.float32(1.0) - u, np.float32(1.0) - v, np.float32(1.0) - w
        for c in range(channels):
            p = at + np.uint64(c)
            q = p + step_x
            near = v0 * (w0 * flat[p] + w * flat[p + step_z]) + v * (w0 * flat[p + step_y] + w * flat[p + step_y + step_z])
            far = v0 * (w0 * flat[q] + w * flat[q + step_z]) + v * (w0 * flat[q + step_y] + w * flat[q + step_y + step_z])
            out[n, np.uint64(c)] = u0 * near + u * far


@fast_kernel
def _dot(
    values: AnyArray, origin: Float32Array, inverse: float, points: Float32Array, weights: Float32Array, out: Float32Array
) -> None:
    nx, ny, nz, channels = values.shape
    flat = values.reshape(-1)
    for n in range(points.shape[0]):
        x, y, z = ((points[n, 0] - origin[0]) * inverse, (points[n, 1] - origin[1]) * inverse,
                   (points[n, 2] - origin[2]) * inverse)  # fmt: skip
        out[n] = 0.0
        if x < 0 or y < 0 or z < 0 or x >= nx - 1 or y >= ny - 1 or z >= nz - 1:
            continue
        i, j, k = int(x), int(y), int(z)
        u, v, w = x - i, y - j, z - k
        total = 0.0
        for a in range(2):
            for b in range(2):
                row = np.uint64((((i + a) * ny + j + b) * nz + k) * channels)  # two neighbours along z are adjacent in memory
                low, high = 0.0, 0.0
                for channel in range(channels):
                    low += weights[n, channel] * flat[row + np.uint64(channel)]
                    high += weights[n, channel] * flat[row + np.uint64(channels + channel)]
                total += (u if a else 1 - u) * (v if b else 1 - v) * (low + w * (high - low))
        out[n] = total


@fast_kernel
def _disagree(ends: Float32Array, farther: Float32Array, planes: Float32Array, place: Float32Array, out: Float32Array) -> None:
    """Compute MeasuredAgreement from the values of its lattices at points.

    place: the points relative to the corner of the box.
    """
    for n in range(place.shape[0]):
        x, y, z = place[n, 0], place[n, 1], place[n, 2]
        nx, ny, nz, count = planes[n, 0], planes[n, 1], planes[n, 2], planes[n, 4]
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        together, past_each = 0.0, MAX_OFFSET_M
        if count > MIN_COUNT:
            together = length / count
            past_each = min(abs(nx * x + ny * y + nz * z - planes[n, 3]) / count, MAX_OFFSET_M)
        near = _offset_from_mean(ends[n, 0], ends[n, 1], ends[n, 2], ends[n, 3], x, y, z, nx, ny, nz, length)
        far = _offset_from_mean(farther[n, 0], farther[n, 1], farther[n, 2], farther[n, 3], x, y, z, nx, ny, nz, length)
        past = np.cbrt((past_each**2 + MIN_PAST_M**2) * (near**2 + MIN_PAST_M**2) * (far**2 + MIN_PAST_M**2))
        out[n] = past / MAX_OFFSET_M**2 * (1.0 + MIN_DISAGREEMENT - together) / np.sqrt(ends[n, 3] + COUNT_OFFSET)


@fast_kernel
def _offset_from_mean(
    sum_x: float, sum_y: float, sum_z: float, known: float,
    x: float, y: float, z: float, nx: float, ny: float, nz: float, length: float,
) -> float:  # fmt: skip
    """Return the distance of a point from the mean of end points, along a normal.

    length: that of the normal. known: number of end points; sum_x, sum_y, sum_z: their sum.
    """
    if known <= MIN_COUNT or length <= 0.0:
        return MAX_OFFSET_M
    along = nx * (x - sum_x / known) + ny * (y - sum_y / known) + nz * (z - sum_z / known)
    return min(abs(along) / length, MAX_OFFSET_M)


@fast_kernel
def _fade(values: AnyArray, origin: Float32Array, inverse: float, points: Float32Array, memory: float) -> None:
    """Scale the values at the node nearest to each point: their weight is at most ``memory``."""
    nx, ny, nz, _ = values.shape
    for n in range(points.shape[0]):
        i, j, k = (int((points[n, 0] - origin[0]) * inverse + 0.5), int((points[n, 1] - origin[1]) * inverse + 0.5),
                   int((points[n, 2] - origin[2]) * inverse + 0.5))  # fmt: skip
        if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
            continue
        held = values[i, j, k, 1]
        if held > memory:
            values[i, j, k, 0] *= memory / held
            values[i, j, k, 1] = memory
