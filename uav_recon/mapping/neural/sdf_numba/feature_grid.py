"""Multi-resolution grid of learned features in blocks, allocated where points were measured.

Six levels from 48 to 4 cm as in instant-ngp (Müller et al. 2022, section 3), but with exact blocks instead of a hash: no two
positions share an entry, and a position without measurement has none, so hash collisions cannot create false surface there.
A block is 2x2x2 nodes of 2 features: 64 bytes, one cache line.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import fast_kernel
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray

LEVELS = 6
FEATURES = 2
ENCODED = LEVELS * FEATURES
CORNERS = LEVELS * 8
COARSEST_CELL_M = 0.48
FINEST_CELL_M = 0.04
DENSE_BLOCKS = 20_000  # a level with at most this many blocks is fully allocated: free space needs coarse features too
POINTS = 64  # points per kernel pass: rows of this length stay in the first-level cache

_ONE = np.float32(1.0)


class FeatureGrid(NamedTuple):
    """Arrays for the kernels.

    origin_world_m (3,) f32. inverse_cell_per_m (L,) f32. cells (L, 3) i32. blocks (L, 3) i32. first (L,) i64: start of a
    level in slot. slot (sum of blocks,) i32: index of a block in features, 0 = not allocated. features (S, 16) f32 by slot;
    slot 0 is zero.
    """

    origin_world_m: Float32Array
    inverse_cell_per_m: Float32Array
    cells: AnyArray
    blocks: AnyArray
    first: AnyArray
    slot: AnyArray
    features: Float32Array


def make_grid(box_min_m: FloatArray, box_max_m: FloatArray) -> tuple[FeatureGrid, int]:
    """Create an empty grid over a box; returns it and the number of slots in use.

    Small levels are fully allocated, see DENSE_BLOCKS.
    """
    growth = (FINEST_CELL_M / COARSEST_CELL_M) ** (1.0 / (LEVELS - 1))
    cell_m = COARSEST_CELL_M * growth ** np.arange(LEVELS)
    extent_m = np.asarray(box_max_m, dtype=np.float64) - np.asarray(box_min_m, dtype=np.float64)
    cells = np.maximum(np.ceil(extent_m[None, :] / cell_m[:, None]), 1).astype(np.int64)
    blocks = (cells + 2) // 2
    count = blocks.prod(axis=1)
    first = np.concatenate(([0], np.cumsum(count)[:-1]))
    index = np.zeros(int(count.sum()), dtype=np.int32)
    used = 1
    for level in range(LEVELS):
        if count[level] <= DENSE_BLOCKS:
            index[first[level] : first[level] + count[level]] = np.arange(used, used + count[level])
            used += int(count[level])
    grid = FeatureGrid(
        np.asarray(box_min_m, dtype=np.float32),
        (1.0 / cell_m).astype(np.float32),
        cells.astype(np.int32),
        blocks.astype(np.int32),
        first,
        index,
        np.zeros((used + 4096, 8 * FEATURES), dtype=np.float32),
    )
    return grid, used


@fast_kernel
def allocate(grid: FeatureGrid, points: Float32Array, first_level: int, used: int, limit: int) -> int:
    """Allocate each missing block under points (N, 3), world metres; returns the slots in use.

    At most ``limit`` slots are used. Levels before first_level are fully allocated already. Fast if consecutive points share
    cells.
    """
    last = np.full((LEVELS, 3), -1, dtype=np.int64)
    for n in range(points.shape[0]):
        for level in range(first_level, LEVELS):
            inverse = grid.inverse_cell_per_m[level]
            x = (points[n, 0] - grid.origin_world_m[0]) * inverse
            y = (points[n, 1] - grid.origin_world_m[1]) * inverse
            z = (points[n, 2] - grid.origin_world_m[2]) * inverse
            i, j, k = int(x), int(y), int(z)
            inside = x >= 0 and y >= 0 and z >= 0
            if not inside or i >= grid.cells[level, 0] or j >= grid.cells[level, 1] or k >= grid.cells[level, 2]:
                continue
            if i == last[level, 0] and j == last[level, 1] and k == last[level, 2]:
                continue
            last[level, 0], last[level, 1], last[level, 2] = i, j, k
            for corner in range(8):
                a = (i + (corner >> 2)) >> 1
                b = (j + ((corner >> 1) & 1)) >> 1
                c = (k + (corner & 1)) >> 1
                entry = grid.first[level] + (a * grid.blocks[level, 1] + b) * grid.blocks[level, 2] + c
                if grid.slot[entry] == 0 and used < limit:
                    grid.slot[entry] = used
                    used += 1
    return used


@fast_kernel
def locate(grid: FeatureGrid, points: Float32Array, start: int, count: int, node: AnyArray, weight: Float32Array) -> None:
    """Find corner nodes (CORNERS, POINTS) and trilinear weights of points[start:start+count].

    The remaining columns get weight 0. A point outside the box is moved to its border.
    """
    for level in range(LEVELS):
        inverse = grid.inverse_cell_per_m[level]
        nx, ny, nz = grid.cells[level, 0], grid.cells[level, 1], grid.cells[level, 2]
        stride_x, stride_y = grid.blocks[level, 1] * grid.blocks[level, 2], grid.blocks[level, 2]
        first = grid.first[level]
        for p in range(count):
            x = (points[start + p, 0] - grid.origin_world_m[0]) * inverse
            y = (points[start + p, 1] - grid.origin_world_m[1]) * inverse
            z = (points[start + p, 2] - grid.origin_world_m[2]) * inverse
            x = min(max(x, np.float32(0.0)), np.float32(nx))
            y = min(max(y, np.float32(0.0)), np.float32(ny))
            z = min(max(z, np.float32(0.0)), np.float32(nz))
            i, j, k = min(int(x), nx - 1), min(int(y), ny - 1), min(int(z), nz - 1)
            u, v, w = x - np.float32(i), y - np.float32(j), z - np.float32(k)
            x0, x1 = first + (i >> 1) * stride_x, first + ((i + 1) >> 1) * stride_x
            y0, y1 = (j >> 1) * stride_y, ((j + 1) >> 1) * stride_y
            z0, z1 = k >> 1, (k + 1) >> 1
            in_x0, in_x1 = (i & 1) << 2, ((i + 1) & 1) << 2
            in_y0, in_y1 = (j & 1) << 1, ((j + 1) & 1) << 1
            in_z0, in_z1 = k & 1, (k + 1) & 1
            row = level * 8
            uv00, uv01, uv10, uv11 = (_ONE - u) * (_ONE - v), (_ONE - u) * v, u * (_ONE - v), u * v
            w0 = _ONE - w
            node[row, p] = (grid.slot[np.uint64(x0 + y0 + z0)] << 3) + (in_x0 + in_y0 + in_z0)
            node[row + 1, p] = (grid.slot[np.uint64(x0 + y0 + z1)] << 3) + (in_x0 + in_y0 + in_z1)
            node[row + 2, p] = (grid.slot[np.uint64(x0 + y1 + z0)] << 3) + (in_x0 + in_y1 + in_z0)
            node[row + 3, p] = (grid.slot[np.uint64(x0 + y1 + z1)] << 3) + (in_x0 + in_y1 + in_z1)
            node[row + 4, p] = (grid.slot[np.uint64(x1 + y0 + z0)] << 3) + (in_x1 + in_y0 + in_z0)
            node[row + 5, p] = (grid.slot[np.uint64(x1 + y0 + z1)] << 3) + (in_x1 + in_y0 + in_z1)
            node[row + 6, p] = (grid.slot[np.uint64(x1 + y1 + z0)] << 3) + (in_x1 + in_y1 + in_z0)
            node[row + 7, p] = (grid.slot[np.uint64(x1 + y1 + z1)] << 3) + (in_x1 + in_y1 + in_z1)
            weight[row, p] = uv00 * w0
            weight[row + 1, p] = uv00 * w
            weight[row + 2, p] = uv01 * w0
            weight[row + 3, p] = uv01 * w
            weight[row + 4, p] = uv10 * w0
            weight[row + 5, p] = uv10 * w
            weight[row + 6, p] = uv11 * w0
            weight[row + 7, p] = uv11 * w
    for row in range(CORNERS):
        for p in range(count, POINTS):
            node[row, p] = 0
            weight[row, p] = 0.0


@fast_kernel
def gather(features: Float32Array, node: AnyArray, weight: Float32Array, encoded: Float32Array) -> None:
    """Interpolate the features (S, 16) into encoded (ENCODED, POINTS)."""
    flat = features.reshape(-1)
    for level in range(LEVELS):
        row = level * 8
        for p in range(POINTS):
            f0, f1 = np.float32(0.0), np.float32(0.0)
            for corner in range(8):
                at = np.uint64(node[row + corner, p]) << np.uint64(1)  # slot * 16 + node in block * 2
                w = weight[row + corner, p]
                f0 += w * flat[at]
                f1 += w * flat[at + np.uint64(1)]
            encoded[level * 2, p] = f0
            encoded[level * 2 + 1, p] = f1


class Gradient(NamedTuple):
    """Sparse gradient of the features.

    features (S, 16) f32: row n belongs to slot touched[n], (S,) i32. row (S,) i32: row of a slot, -1 = not touched. rows
    (1,) i64: number of rows in use.
    """

    features: Float32Array
    touched: AnyArray
    row: AnyArray
    rows: AnyArray


def make_gradient(slots: int) -> Gradient:
    """Return an empty gradient."""
    return Gradient(
        np.zeros((slots, 8 * FEATURES), dtype=np.float32),
        np.zeros(slots, dtype=np.int32),
        np.full(slots, -1, dtype=np.int32),
        np.zeros(1, dtype=np.int64),
    )


@fast_kernel
def scatter(d_encoded: Float32Array, count: int, node: AnyArray, weight: Float32Array, gradient: Gradient) -> None:
    """Add the gradient of the features: the transpose of gather(). Slot 0 gets no gradient."""
    flat = gradient.features.reshape(-1)
    used = gradient.rows[0]
    for p in range(count):  # points outside, as neighbours on a ray share nodes: fewer dependent additions
        for level in range(LEVELS):
            d0, d1 = d_encoded[level * 2, p], d_encoded[level * 2 + 1, p]
            if d0 == 0.0 and d1 == 0.0:
                continue
            for corner in range(8):
                node_at = np.uint64(node[level * 8 + corner, p])
                slot = node_at >> np.uint64(3)
                if slot == np.uint64(0):
                    continue
                row = gradient.row[slot]
                if row < 0:
                    row = used
                    gradient.row[slot] = row
                    gradient.touched[row] = slot
                    used += 1
                w = weight[level * 8 + corner, p]
                at = (np.uint64(row) << np.uint64(4)) + ((node_at & np.uint64(7)) << np.uint64(1))
                flat[at] += w * d0
                flat[at + np.uint64(1)] += w * d1
    gradient.rows[0] = used
