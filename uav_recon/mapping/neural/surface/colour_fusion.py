"""Colour fusion: mean of the observed colours per small cell, on top of the learned colours.

A field of 4 cm cells blurs fine print on a wall during the whole flight. The mean of the observed colours in a small cell is
available at once. The colour of the field is added to it as one more observation with a low weight.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import fast_kernel
from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.keyframes.ray_sampling import TOE, WHITE, ray_points
from uav_recon.mapping.neural.sdf_interface import SdfField
from uav_recon.types.frames import AnyArray, Float32Array

# cells are stored in blocks of EDGE³, allocated where something was observed
CELL_M = 0.02
EDGE = 4
FIELD_WEIGHT_RAYS = 0.3  # weight of the field's colour, in rays
MAX_DEPTH_SIGMA_M = 0.03  # maximum depth sigma of a colour sample: beyond it a colour may belong elsewhere
BLOCKS = 4096  # initial capacity

_ON_THE_RAY = np.zeros(1, dtype=np.float32)


class ColourFusedField:
    """The field with the colours of the replayed views, at their current poses and exposures.

    low_m, high_m (3,): the box. The constructor takes about 10 ms per view.
    """

    def __init__(self, field: SdfField, replay: RayBuffer, low_m: Float32Array, high_m: Float32Array) -> None:
        self._field = field
        self._low = low_m
        blocks = np.ceil((high_m - low_m) / np.float32(CELL_M * EDGE)).astype(np.int64) + 1
        self._block = np.full(tuple(int(n) for n in blocks), -1, dtype=np.int32)
        self._sums = _sums(BLOCKS)
        self._used = 0
        for view in range(replay.count):
            self._see(replay, view)

    def distance_m(self, points: Float32Array) -> Float32Array:
        """Return the distances of the field."""
        return self._field.distance_m(points)

    def rgb(self, points: Float32Array) -> Float32Array:
        """Return the colours (N, 3) in 0..1 at points (N, 3) float32."""
        out = self._field.rgb(points)
        _mix(self._block, self._sums, self._low, points, out)
        return out

    def _see(self, replay: RayBuffer, view: int) -> None:
        records = replay.records(view)
        count = len(records)
        points, normal = np.empty((1, count, 3), dtype=np.float32), np.empty((count, 3), dtype=np.float32)
        cosine, sigma_m = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
        ray_points(replay.views, view, _ON_THE_RAY, points, cosine, sigma_m, normal)
        use = (records[:, 9] == 1) & (sigma_m < MAX_DEPTH_SIGMA_M)
        where = points[0, use]
        self._add(where, self._shown(records[use, 6:9], replay.views.gain[view], where))

    def _shown(self, level: AnyArray, gain: Float32Array, points: Float32Array) -> Float32Array:
        """Return the colours (N, 3) of levels 0..255 (N, 3) at the mean exposure.

        A saturated level that the gain darkens may have been brighter: there the colour of the field is a lower bound.
        """
        share = level.astype(np.float32) / np.float32(255.0)
        rgb: Float32Array = np.clip((share + TOE) * gain - TOE, np.float32(0.0), np.float32(1.0))
        dimmed = (level >= WHITE) & (rgb < 1.0)
        some = np.flatnonzero(dimmed.any(axis=1))
        rgb[some] = np.where(dimmed[some], np.maximum(rgb[some], self._field.rgb(points[some])), rgb[some])
        return rgb

    def _add(self, points: Float32Array, rgb: Float32Array) -> None:
        self._used = int(_reserve(self._block, self._low, points, self._used))
        if self._used > len(self._sums):
            grown = _sums(2 * self._used)
            grown[: len(self._sums)] = self._sums
            self._sums = grown
        _sum(self._block, self._sums, self._low, points, rgb)


def _sums(blocks: int) -> Float32Array:
    """Return zero sums of each cell: red, green, blue, number of rays."""
    return np.zeros((blocks, EDGE, EDGE, EDGE, 4), dtype=np.float32)


@fast_kernel
def _reserve(block: AnyArray, low: Float32Array, points: Float32Array, used: int) -> int:
    """Assign numbers to new blocks that contain points (N, 3); returns the blocks in use."""
    scale = np.float32(1.0 / (CELL_M * EDGE))
    nx, ny, nz = block.shape
    for n in range(points.shape[0]):
        x, y, z = (points[n, 0] - low[0]) * scale, (points[n, 1] - low[1]) * scale, (points[n, 2] - low[2]) * scale
        if x < 0 or y < 0 or z < 0 or x >= nx or y >= ny or z >= nz:
            continue
        if block[int(x), int(y), int(z)] < 0:
            block[int(x), int(y), int(z)] = used
            used += 1
    return used


@fast_kernel
def _sum(block: AnyArray, sums: Float32Array, low: Float32Array, points: Float32Array, rgb: Float32Array) -> None:
    scale = np.float32(1.0 / CELL_M)
    nx, ny, nz = block.shape[0] * EDGE, block.shape[1] * EDGE, block.shape[2] * EDGE
    for n in range(points.shape[0]):
        x, y, z = (points[n, 0] - low[0]) * scale, (points[n, 1] - low[1]) * scale, (points[n, 2] - low[2]) * scale
        if x < 0 or y < 0 or z < 0 or x >= nx or y >= ny or z >= nz:
            continue
        i, j, k = int(x), int(y), int(z)
        cell = sums[block[i // EDGE, j // EDGE, k // EDGE], i % EDGE, j % EDGE, k % EDGE]
        for channel in range(3):
            cell[channel] += rgb[n, channel]
        cell[3] += np.float32(1.0)


@fast_kernel
def _mix(block: AnyArray, sums: Float32Array, low: Float32Array, points: Float32Array, rgb: Float32Array) -> None:
    """Replace rgb (N, 3) by its mean with the sums of the eight cells around points (N, 3).

    The weights are trilinear.
    """
    scale, half = np.float32(1.0 / CELL_M), np.float32(0.5)
    nx, ny, nz = block.shape[0] * EDGE, block.shape[1] * EDGE, block.shape[2] * EDGE
    for n in range(points.shape[0]):
        x, y, z = ((points[n, 0] - low[0]) * scale - half, (points[n, 1] - low[1]) * scale - half,
                   (points[n, 2] - low[2]) * scale - half)  # fmt: skip
        if x < 0 or y < 0 or z < 0 or x >= nx - 1 or y >= ny - 1 or z >= nz - 1:
            continue
        i, j, k = int(x), int(y), int(z)
        u, v, w = x - np.float32(i), y - np.float32(j), z - np.float32(k)
        total = np.float32(FIELD_WEIGHT_RAYS)
        red, green, blue = total * rgb[n, 0], total * rgb[n, 1], total * rgb[n, 2]
        for corner in range(8):
            a, b, c = corner >> 2, (corner >> 1) & 1, corner & 1
            at = block[(i + a) // EDGE, (j + b) // EDGE, (k + c) // EDGE]
            if at < 0:
                continue
            cell = sums[at, (i + a) % EDGE, (j + b) % EDGE, (k + c) % EDGE]
            share = (u if a else 1 - u) * (v if b else 1 - v) * (w if c else 1 - w)
            red, green, blue, total = (red + share * cell[0], green + share * cell[1], blue + share * cell[2],
                                       total + share * cell[3])  # fmt: skip
        rgb[n, 0], rgb[n, 1], rgb[n, 2] = red / total, green / total, blue / total
