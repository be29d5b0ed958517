"""Zero level set of a field on sparse blocks: naive surface nets (Gibson 1998).

One vertex per cell that the surface crosses, at the mean of its edge crossings; one quad per crossed edge. A cell with a
corner that was not evaluated has no vertex, so no surface closes over unknown space.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, BoolArray, Float32Array, FloatArray, IntArray

EDGE = 8  # nodes along a block
ABSENT = 1e9  # value of a node that was not evaluated


class SparseNodes(NamedTuple):
    """Nodes on a lattice over a box, in blocks of EDGE³.

    origin_m (3,) f32 and voxel_m: node (i, j, k) lies at origin + voxel * (i, j, k). slot (bx, by, bz) i32, -1 = no block.
    blocks (B, 3) i32: block coordinates. values (B, EDGE, EDGE, EDGE) f32: ABSENT where not wanted, 0 where wanted.
    """

    origin_m: Float32Array
    voxel_m: np.float32
    slot: AnyArray
    blocks: AnyArray
    values: Float32Array


def wanted_nodes(wanted: BoolArray, origin_m: FloatArray, cell_m: float, voxel_m: float) -> SparseNodes:
    """Return the nodes in wanted cells (nx, ny, nz) of a lattice with corner origin_m (3,)."""
    extent = np.array(wanted.shape) * cell_m
    shape = np.ceil((np.floor(extent / voxel_m) + 1) / EDGE).astype(int)
    slot = np.full(tuple(int(n) for n in shape), -1, dtype=np.int32)
    ratio = float(voxel_m / cell_m)
    count = _place_blocks(wanted, ratio, slot)
    blocks = np.zeros((count, 3), dtype=np.int32)
    at = np.argwhere(slot >= 0)
    blocks[slot[slot >= 0]] = at
    values = np.empty((count, EDGE, EDGE, EDGE), dtype=np.float32)
    _mark_nodes(wanted, ratio, blocks, values)
    return SparseNodes(np.asarray(origin_m, dtype=np.float32), np.float32(voxel_m), slot, blocks, values)


def node_points(nodes: SparseNodes) -> tuple[Float32Array, BoolArray]:
    """Return world points (N, 3) of all wanted nodes, and the mask to assign their values.

    Use: nodes.values[mask] = f(points).
    """
    mask: BoolArray = nodes.values != ABSENT
    block, *inner = np.nonzero(mask)
    node = nodes.blocks[block] * np.int32(EDGE) + np.stack(inner, axis=1).astype(np.int32)
    points: Float32Array = nodes.origin_m + nodes.voxel_m * node.astype(np.float32)
    return points, mask


def net_vertices(nodes: SparseNodes) -> tuple[Float32Array, Float32Array]:
    """Return vertices (V, 3) and unit normals towards positive values (V, 3)."""
    return _vertices(nodes)[1:]


def surface_net(nodes: SparseNodes) -> tuple[Float32Array, Float32Array, IntArray]:
    """Return vertices, normals and quads (Q, 4), counter-clockwise seen from positive values."""
    cells, vertices, normals = _vertices(nodes)
    quads = np.empty((3 * len(vertices), 4), dtype=np.int64)
    return vertices, normals, quads[: _join(nodes, cells, quads)]


def _vertices(nodes: SparseNodes) -> tuple[AnyArray, Float32Array, Float32Array]:
    cells = np.empty(nodes.values.shape, dtype=np.int32)
    most = int(np.count_nonzero(nodes.values < ABSENT))
    vertices = np.empty((most, 3), dtype=np.float32)
    normals = np.empty((most, 3), dtype=np.float32)
    count = _place_vertices(nodes, cells, vertices, normals)
    return cells, vertices[:count], normals[:count]


@kernel
def _place_blocks(wanted: BoolArray, ratio: float, slot: AnyArray) -> int:  # noqa: C901
    count = 0
    first, last = np.empty((3, max(wanted.shape)), dtype=np.int64), np.empty((3, max(wanted.shape)), dtype=np.int64)
    for axis in range(3):
        for i in range(wanted.shape[axis]):
            first[axis, i] = int(np.ceil(i / ratio)) // EDGE
            last[axis, i] = min(int(np.floor((i + 1) / ratio)) // EDGE, slot.shape[axis] - 1)
    for i in range(wanted.shape[0]):
        for j in range(wanted.shape[1]):
            for k in range(wanted.shape[2]):
                if not wanted[i, j, k]:
                    continue
                for a in range(first[0, i], last[0, i] + 1):
                    for b in range(first[1, j], last[1, j] + 1):
                        for c in range(first[2, k], last[2, k] + 1):
                            if slot[a, b, c] < 0:
                                slot[a, b, c] = count
                                count += 1
    return count


@kernel
def _mark_nodes(wanted: BoolArray, ratio: float, blocks: AnyArray, values: Float32Array) -> None:
    nx, ny, nz = wanted.shape
    along_z = np.empty(EDGE, dtype=np.int64)
    for block in range(blocks.shape[0]):
        for c in range(EDGE):
            along_z[c] = int((blocks[block, 2] * EDGE + c) * ratio)
        for a in range(EDGE):
            i = int((blocks[block, 0] * EDGE + a) * ratio)
            for b in range(EDGE):
                j = int((blocks[block, 1] * EDGE + b) * ratio)
                for c in range(EDGE):
                    k = along_z[c]
                    inside = i < nx and j < ny and k < nz and wanted[i, j, k]
                    values[block, a, b, c] = 0.0 if inside else ABSENT


@kernel
def _read(slot: AnyArray, array: AnyArray, i: int, j: int, k: int, otherwise: float) -> float:
    a, b, c = i // EDGE, j // EDGE, k // EDGE
    if i < 0 or j < 0 or k < 0 or a >= slot.shape[0] or b >= slot.shape[1] or c >= slot.shape[2]:
        return otherwise
    block = slot[a, b, c]
    if block < 0:
        return otherwise
    return float(array[block, i % EDGE, j % EDGE, k % EDGE])


@kernel
def _with_halo(nodes: SparseNodes, block: int, values: Float32Array) -> None:
    """Copy a block and the first layer of the seven next blocks.

    values: (EDGE + 1, EDGE + 1, EDGE + 1).
    """
    values[:] = ABSENT
    for n in range(8):
        i, j, k = n >> 2, (n >> 1) & 1, n & 1
        a, b, c = nodes.blocks[block, 0] + i, nodes.blocks[block, 1] + j, nodes.blocks[block, 2] + k
        if a >= nodes.slot.shape[0] or b >= nodes.slot.shape[1] or c >= nodes.slot.shape[2] or nodes.slot[a, b, c] < 0:
            continue
        other = nodes.values[nodes.slot[a, b, c]]
        for x in range(1 if i else EDGE):
            for y in range(1 if j else EDGE):
                for z in range(1 if k else EDGE):
                    values[i * EDGE + x, j * EDGE + y, k * EDGE + z] = other[x, y, z]


@kernel
def _place_vertices(nodes: SparseNodes, cells: AnyArray, vertices: Float32Array, normals: Float32Array) -> int:
    """Compute the vertices of the crossed cells and write their numbers to ``cells`` (else -1).

    Returns the number of vertices.
    """
    near = np.empty((EDGE + 1, EDGE + 1, EDGE + 1), dtype=np.float32)
    least, most = np.empty(EDGE + 1, dtype=np.float32), np.empty(EDGE + 1, dtype=np.float32)
    f = np.empty(8)
    mean = np.empty(3)
    count = 0
    for block in range(cells.shape[0]):
        _with_halo(nodes, block, near)
        for a in range(EDGE):
            for b in range(EDGE):
                for c in range(EDGE + 1):  # over the four corners at c
                    p, q, r, s = near[a, b, c], near[a, b + 1, c], near[a + 1, b, c], near[a + 1, b + 1, c]
                    least[c], most[c] = min(p, q, r, s), max(p, q, r, s)
                for c in range(EDGE):
                    cells[block, a, b, c] = -1
                    high = max(most[c], most[c + 1])
                    if not (min(least[c], least[c + 1]) < 0.0 <= high < ABSENT):
                        continue
                    cells[block, a, b, c] = count
                    for n in range(8):
                        f[n] = near[a + (n >> 2), b + ((n >> 1) & 1), c + (n & 1)]
                    _mean_crossing(f, mean)
                    u, v, w = mean[0], mean[1], mean[2]
                    vertices[count, 0] = nodes.origin_m[0] + nodes.voxel_m * (nodes.blocks[block, 0] * EDGE + a + u)
                    vertices[count, 1] = nodes.origin_m[1] + nodes.voxel_m * (nodes.blocks[block, 1] * EDGE + b + v)
                    vertices[count, 2] = nodes.origin_m[2] + nodes.voxel_m * (nodes.blocks[block, 2] * EDGE + c + w)
                    gx = (1 - v) * ((1 - w) * (f[4] - f[0]) + w * (f[5] - f[1])) + v * (
                        (1 - w) * (f[6] - f[2]) + w * (f[7] - f[3])
                    )
                    gy = (1 - u) * ((1 - w) * (f[2] - f[0]) + w * (f[3] - f[1])) + u * (
                        (1 - w) * (f[6] - f[4]) + w * (f[7] - f[5])
                    )
                    gz = (1 - u) * ((1 - v) * (f[1] - f[0]) + v * (f[3] - f[2])) + u * (
                        (1 - v) * (f[5] - f[4]) + v * (f[7] - f[6])
                    )
                    length = np.sqrt(gx * gx + gy * gy + gz * gz) + 1e-9
                    normals[count, 0], normals[count, 1], normals[count, 2] = gx / length, gy / length, gz / length
                    count += 1
    return count


@kernel
def _mean_crossing(f: FloatArray, mean: FloatArray) -> None:
    """Compute the mean (3,), in cells, of the sign changes on the edges of a crossed cell.

    f (8,): values at the corners.
    """
    mean[:] = 0.0
    crossings = 0
    for n in range(8):
        for axis in range(3):
            bit = 4 >> axis
            if n & bit or (f[n] < 0.0) == (f[n | bit] < 0.0):
                continue
            crossings += 1
            mean[0] += n >> 2
            mean[1] += (n >> 1) & 1
            mean[2] += n & 1
            mean[axis] += f[n] / (f[n] - f[n | bit])
    mean /= crossings


@kernel
def _join(nodes: SparseNodes, cells: AnyArray, quads: AnyArray) -> int:
    count = 0
    step = np.zeros((2, 3), dtype=np.int64)
    for block in range(cells.shape[0]):
        for a in range(EDGE):
            for b in range(EDGE):
                for c in range(EDGE):
                    if cells[block, a, b, c] < 0:
                        continue
                    i, j, k = (nodes.blocks[block, 0] * EDGE + a, nodes.blocks[block, 1] * EDGE + b,
                               nodes.blocks[block, 2] * EDGE + c)  # fmt: skip
                    here = nodes.values[block, a, b, c]
                    for axis in range(3):
                        there = _read(nodes.slot, nodes.values, i + (axis == 0), j + (axis == 1), k + (axis == 2), ABSENT)
                        if (here < 0.0) == (there < 0.0):
                            continue
                        step[:] = 0
                        step[0, (axis + 1) % 3] = 1
                        step[1, (axis + 2) % 3] = 1
                        whole = True
                        for n in range(4):
                            s, t = int(n in (0, 3)), int(n in (0, 1))
                            cell = _read(
                                nodes.slot,
                                cells,
                                i - s * step[0, 0] - t * step[1, 0],
                                j - s * step[0, 1] - t * step[1, 1],
                                k - s * step[0, 2] - t * step[1, 2],
                                -1.0,
                            )
                            whole = whole and cell >= 0
                            quads[count, n if here < 0.0 else 3 - n] = int(cell)
                        count += whole
    return count
