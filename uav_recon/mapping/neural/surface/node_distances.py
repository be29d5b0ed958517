"""Distances of the field at the nodes of sparse blocks, with shared interpolation.

Nodes are evenly spaced, so the cell indices and weights of each level are a table per axis. A block spans few cells of a
coarse level: such a level is interpolated for the whole block, one axis after the other, eight nodes at a time. Fine levels
are interpolated node by node. The sum is that of feature_grid.gather(), in another order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import fast_kernel
from uav_recon.mapping.neural.sdf_numba.feature_grid import FEATURES, LEVELS, POINTS, FeatureGrid
from uav_recon.mapping.neural.sdf_numba.network import Network, Scratch, distance_alone
from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.mapping.neural.surface.surface_nets import ABSENT, EDGE, SparseNodes
from uav_recon.types.frames import AnyArray, Float32Array

MAX_SHARED = 8  # a level with at most this many nodes along a block is interpolated for the whole block

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_STEP = np.uint64(1)
_TWO = np.uint64(2)


class AxisTables(NamedTuple):
    """Interpolation along each axis, by level and node.

    cell: (LEVELS, 3, length) int32 cell of each node. share: (LEVELS, 3, length) where it lies between the cell and the next.
    shared: number of levels, the coarsest, that are interpolated for whole blocks.
    """

    cell: NDArray[np.int32]
    share: Float32Array
    shared: int


def fill_distances(field: NumbaSdfField, nodes: SparseNodes) -> None:
    """Write the signed distance in metres to every wanted node."""
    grid = field.grid
    length = EDGE * max(nodes.slot.shape)
    cell = np.zeros((LEVELS, 3, length), dtype=np.int32)
    share = np.zeros((LEVELS, 3, length), dtype=np.float32)
    for level in range(LEVELS):
        for axis in range(3):
            along = nodes.origin_m[axis] + nodes.voxel_m * np.arange(length, dtype=np.float32)
            at = (along - grid.origin_world_m[axis]) * grid.inverse_cell_per_m[level]
            at = np.clip(at, np.float32(0.0), np.float32(grid.cells[level, axis]))
            cell[level, axis] = np.minimum(at.astype(np.int32), grid.cells[level, axis] - 1)
            share[level, axis] = at - cell[level, axis].astype(np.float32)
    spans = (EDGE - 1) * float(nodes.voxel_m) * grid.inverse_cell_per_m
    shared = int(np.count_nonzero(np.ceil(spans) + 2 <= MAX_SHARED))  # the coarsest come first
    tables = AxisTables(cell=cell, share=share, shared=shared)
    _fill(grid, field.network, field.scratch, tables, nodes.blocks, nodes.values.reshape(-1, EDGE**3))


@fast_kernel
def _fill(grid: FeatureGrid, net: Network, s: Scratch, tables: AxisTables, blocks: AnyArray, values: Float32Array) -> None:
    raw = np.zeros((FEATURES, MAX_SHARED, MAX_SHARED, MAX_SHARED), dtype=np.float32)
    along_y = np.zeros((FEATURES, MAX_SHARED, EDGE, MAX_SHARED), dtype=np.float32)
    along_xy = np.zeros((LEVELS * FEATURES, EDGE, EDGE * MAX_SHARED), dtype=np.float32)
    flat = along_xy.reshape(LEVELS * FEATURES, EDGE * EDGE * MAX_SHARED)
    inner = np.zeros(POINTS, dtype=np.int64)
    target = np.zeros(POINTS, dtype=np.int64)
    out = values.reshape(-1)
    count = 0
    for block in range(blocks.shape[0]):
        _share_levels(grid, tables, blocks, block, raw, along_y, along_xy)
        node = 0
        while node < EDGE**3:
            start = count
            while node < EDGE**3 and count < POINTS:
                inner[count] = node
                target[count] = block * EDGE**3 + node
                count += values[block, node] < ABSENT
                node += 1
            _along_z(tables, blocks, block, flat, inner, start, count, s.encoded)
            _each_node(grid, tables, blocks, block, inner, start, count, s)
            if count == POINTS:
                distance_alone(net, s)
                for p in range(POINTS):
                    out[target[p]] = s.out[0, p]
                count = 0
    distance_alone(net, s)
    for p in range(count):
        out[target[p]] = s.out[0, p]


@fast_kernel
def _share_levels(  # noqa: C901
    grid: FeatureGrid, tables: AxisTables, blocks: AnyArray, block: int, raw: Float32Array, along_y: Float32Array,
    along_xy: Float32Array,
) -> None:  # fmt: skip
    """Interpolate the coarse levels along y, then x, for all nodes of a block.

    Indices are unsigned, because numba adds a check for negative values to signed ones.
    """
    cell, share, shared = tables
    features, layer = grid.features.reshape(-1), along_y.reshape(FEATURES, MAX_SHARED, EDGE * MAX_SHARED)
    x0, y0, z0 = (np.uint64(blocks[block, 0] * EDGE), np.uint64(blocks[block, 1] * EDGE),
                  np.uint64(blocks[block, 2] * EDGE))  # fmt: skip
    last = np.uint64(EDGE - 1)
    for level in range(shared):
        i0, j0, k0 = np.uint64(cell[level, 0, x0]), np.uint64(cell[level, 1, y0]), np.uint64(cell[level, 2, z0])
        ni = int(np.uint64(cell[level, 0, x0 + last]) - i0) + 2
        nj = int(np.uint64(cell[level, 1, y0 + last]) - j0) + 2
        nk = int(np.uint64(cell[level, 2, z0 + last]) - k0) + 2
        by, bz, first = np.uint64(grid.blocks[level, 1]), np.uint64(grid.blocks[level, 2]), np.uint64(grid.first[level])
        for i in range(ni):
            x = i0 + np.uint64(i)
            for j in range(nj):
                y = j0 + np.uint64(j)
                row = first + ((x >> _STEP) * by + (y >> _STEP)) * bz
                inside = ((x & _STEP) << np.uint64(3)) + ((y & _STEP) << _TWO)
                for k in range(nk):
                    z = k0 + np.uint64(k)
                    slot = np.uint64(grid.slot[row + (z >> _STEP)])
                    at = (slot << np.uint64(4)) + inside + ((z & _STEP) << _STEP)
                    raw[0, i, j, k] = features[at]
                    raw[1, i, j, k] = features[at + _STEP]
        for feature in range(FEATURES):
            for b in range(EDGE):
                y, v = np.uint64(cell[level, 1, y0 + np.uint64(b)]) - j0, share[level, 1, y0 + np.uint64(b)]
                for i in range(ni):
                    for k in range(MAX_SHARED):
                        near, far = raw[feature, i, y, k], raw[feature, i, y + _STEP, k]
                        along_y[feature, i, b, k] = near + v * (far - near)
            for a in range(EDGE):
                x, u = np.uint64(cell[level, 0, x0 + np.uint64(a)]) - i0, share[level, 0, x0 + np.uint64(a)]
                for bk in range(EDGE * MAX_SHARED):
                    near, far = layer[feature, x, bk], layer[feature, x + _STEP, bk]
                    along_xy[level * 2 + feature, a, bk] = near + u * (far - near)


@fast_kernel
def _along_z(
    tables: AxisTables, blocks: AnyArray, block: int, along_xy: Float32Array, inner: AnyArray, start: int, end: int,
    encoded: Float32Array,
) -> None:  # fmt: skip
    """Interpolate the coarse levels at nodes start to end of a batch, all of one block."""
    cell, share, shared = tables
    z0 = blocks[block, 2] * EDGE
    for level in range(shared):
        k0 = cell[level, 2, z0]
        for p in range(start, end):
            z = np.uint64(z0 + (inner[p] & 7))
            w = share[level, 2, z]
            at = np.uint64((inner[p] >> 3) * MAX_SHARED + cell[level, 2, z] - k0)
            near, far = along_xy[level * 2, at], along_xy[level * 2, at + _STEP]
            encoded[level * 2, p] = near + w * (far - near)
            near, far = along_xy[level * 2 + 1, at], along_xy[level * 2 + 1, at + _STEP]
            encoded[level * 2 + 1, p] = near + w * (far - near)


@fast_kernel
def _each_node(
    grid: FeatureGrid, tables: AxisTables, blocks: AnyArray, block: int, inner: AnyArray, start: int, end: int, s: Scratch
) -> None:
    """Interpolate the fine levels at the same nodes."""
    cell, share, shared = tables
    at, weight, encoded = s.node, s.weight, s.encoded
    features = grid.features.reshape(-1)
    x0, y0, z0 = blocks[block, 0] * EDGE, blocks[block, 1] * EDGE, blocks[block, 2] * EDGE
    for level in range(shared, LEVELS):
        stride_x, stride_y = grid.blocks[level, 1] * grid.blocks[level, 2], grid.blocks[level, 2]
        first = grid.first[level]
        for p in range(start, end):
            x, y, z = (np.uint64(x0 + (inner[p] >> 6)), np.uint64(y0 + ((inner[p] >> 3) & 7)),
                       np.uint64(z0 + (inner[p] & 7)))  # fmt: skip
            i, j, k = cell[level, 0, x], cell[level, 1, y], cell[level, 2, z]
            u, v, w = share[level, 0, x], share[level, 1, y], share[level, 2, z]
            x_0, x_1 = first + (i >> 1) * stride_x, first + ((i + 1) >> 1) * stride_x
            y_0, y_1 = (j >> 1) * stride_y, ((j + 1) >> 1) * stride_y
            z_0, z_1 = k >> 1, (k + 1) >> 1
            in_x0, in_x1 = (i & 1) << 2, ((i + 1) & 1) << 2
            in_y0, in_y1 = (j & 1) << 1, ((j + 1) & 1) << 1
            in_z0, in_z1 = k & 1, (k + 1) & 1
            uv00, uv01, uv10, uv11 = (_ONE - u) * (_ONE - v), (_ONE - u) * v, u * (_ONE - v), u * v
            w0 = _ONE - w
            at[0, p] = (grid.slot[np.uint64(x_0 + y_0 + z_0)] << 3) + (in_x0 + in_y0 + in_z0)
            at[1, p] = (grid.slot[np.uint64(x_0 + y_0 + z_1)] << 3) + (in_x0 + in_y0 + in_z1)
            at[2, p] = (grid.slot[np.uint64(x_0 + y_1 + z_0)] << 3) + (in_x0 + in_y1 + in_z0)
            at[3, p] = (grid.slot[np.uint64(x_0 + y_1 + z_1)] << 3) + (in_x0 + in_y1 + in_z1)
            at[4, p] = (grid.slot[np.uint64(x_1 + y_0 + z_0)] << 3) + (in_x1 + in_y0 + in_z0)
            at[5, p] = (grid.slot[np.uint64(x_1 + y_0 + z_1)] << 3) + (in_x1 + in_y0 + in_z1)
            at[6, p] = (grid.slot[np.uint64(x_1 + y_1 + z_0)] << 3) + (in_x1 + in_y1 + in_z0)
            at[7, p] = (grid.slot[np.uint64(x_1 + y_1 + z_1)] << 3) + (in_x1 + in_y1 + in_z1)
            weight[0, p], weight[1, p], weight[2, p], weight[3, p] = uv00 * w0, uv00 * w, uv01 * w0, uv01 * w
            weight[4, p], weight[5, p], weight[6, p], weight[7, p] = uv10 * w0, uv10 * w, uv11 * w0, uv11 * w
        for p in range(start, end):
            f0, f1 = _ZERO, _ZERO
            for corner in range(8):
                feature = np.uint64(at[corner, p]) << _STEP
                f0 += weight[corner, p] * features[feature]
                f1 += weight[corner, p] * features[feature + _STEP]
            encoded[level * 2, p] = f0
            encoded[level * 2 + 1, p] = f1
