"""Clustering of frontier cells, one block of columns at a time.

A change thus affects only the clusters of the changed block. The clusters of a block depend on the cells of the block: its
26-connected components, each halved along its first principal component (3-D) until one view covers it. Only the test
whether a small cluster is a speck extends farther, by at most MIN_CELLS voxels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, TILE, UNKNOWN

Int32Array = NDArray[np.int32]

BLOCK = 2 * TILE  # columns along x and y
MIN_CELLS = 20  # fewer connected cells (0.2 m² at 0.1 m) are a speck on a surface or a sampling gap, not worth a flight
MAX_EXTENT_M = 1.2  # along the first principal component: up to this extent one view from the shell covers a cluster
_STACK = 64  # max. pending halves; a component of a block never needs as many
# bit positions and mask of a cell's packed indices in its block
_I = 25
_J = 20
_K = (1 << 20) - 1


@kernel
def scan(  # noqa: C901, PLR0912
    state: ByteArray,
    known: ByteArray,
    faces: ByteArray,
    low: IntArray,
    high: IntArray,
    tiles: IntArray,
    revision: int,
    closed: IntArray,
    dirty: ByteArray,
) -> None:
    """Update ``known`` and ``faces`` in the changed tiles and one column around them.

    known: the last state, flat, padded by one slice of constant i before and after.
    faces: (nx, ny, nz) bits of the unknown face neighbours, see frontiers.Frontier.
    tiles: (N, 2) tiles to compare.
    closed: (tiles) revision at which a voxel of the tile last stopped being free.
    dirty: (blocks) set to 1 where a face changed.
    """
    nx, ny, nz = state.shape
    slab = ny * nz
    moved = np.zeros(len(tiles), dtype=np.bool_)
    flat, flat_faces = state.reshape(-1), faces.reshape(-1)
    for n in range(len(tiles)):
        lost = np.uint8(0)
        j0, j1 = tiles[n, 1] * TILE, min(tiles[n, 1] * TILE + TILE, ny)
        for i in range(tiles[n, 0] * TILE, min(tiles[n, 0] * TILE + TILE, nx)):
            # the columns of a tile with the same i are contiguous
            a, b = (i * ny + j0) * nz, (i * ny + j1) * nz
            now, before = flat[a:b], known[slab + a : slab + b]
            if _differ(now, before):
                moved[n] = True
                for m in range(len(now)):
                    gone = np.uint8(1) if (before[m] == FREE) & (now[m] != FREE) else np.uint8(0)
                    lost = np.uint8(lost | gone)
                    before[m] = now[m]
        if lost:
            closed[tiles[n, 0], tiles[n, 1]] = revision
    # the permitted faces by height, for the max. number of columns processed together
    allowed = np.zeros((TILE + 2, nz), dtype=np.uint8)
    allowed[:, low[2] : high[2]] = 63
    if high[2] > low[2]:
        for n in range(TILE + 2):
            allowed[n, low[2]] &= np.uint8(63 - 16)
            allowed[n, high[2] - 1] &= np.uint8(63 - 32)
    row = np.zeros((TILE + 2) * nz, dtype=np.uint8)
    for n in range(len(tiles)):
        if not moved[n]:
            continue
        i0, j0 = tiles[n, 0] * TILE, tiles[n, 1] * TILE
        ja, jb = max(j0 - 1, low[1]), min(j0 + TILE + 1, high[1])
        for i in range(max(i0 - 1, low[0]), min(i0 + TILE + 1, high[0])):
            a, length = (i * ny + ja) * nz, (jb - ja) * nz
            if length <= 0:
                continue
            p = slab + a
            here = known[p : p + length]
            new = row[:length]
            _faces(
                here,
                known[p - slab : p - slab + length] if i > low[0] else here,  # a free voxel is not unknown: no face
                known[p + slab : p + slab + length] if i + 1 < high[0] else here,
                known[p - nz : p - nz + length],
                known[p + nz : p + nz + length],
                known[p - 1 : p - 1 + length],
                known[p + 1 : p + 1 + length],
                allowed.reshape(-1)[:length],
                new,
            )
            if ja == low[1]:
                for k in range(nz):
                    new[k] &= np.uint8(63 - 4)
            if jb == high[1]:
                for k in range(length - nz, length):
                    new[k] &= np.uint8(63 - 8)
            old = flat_faces[a : a + length]
            if _differ(new, old):
                for m in range(jb - ja):
                    if _differ(new[m * nz : m * nz + nz], old[m * nz : m * nz + nz]):
                        dirty[i // BLOCK, (ja + m) // BLOCK] = 1
                for m in range(length):
                    old[m] = new[m]


@kernel
def _differ(a: ByteArray, b: ByteArray) -> bool:
    bits = np.uint8(0)
    for n in range(len(a)):
        bits = np.uint8(bits | np.uint8(a[n] ^ b[n]))
    return bool(bits != 0)


@kernel
def _faces(
    here: ByteArray,
    west: ByteArray,
    east: ByteArray,
    south: ByteArray,
    north: ByteArray,
    below: ByteArray,
    above: ByteArray,
    allowed: ByteArray,
    out: ByteArray,
) -> None:
    """Write the bits of the unknown neighbours of each free voxel, in the order of FACES."""
    for n in range(len(out)):  # branch-free, with each result cast back to a byte: the loop is vectorized over 32 voxels
        bits = np.uint8(1) if west[n] == UNKNOWN else np.uint8(0)
        bits = np.uint8(bits | (np.uint8(2) if east[n] == UNKNOWN else np.uint8(0)))
        bits = np.uint8(bits | (np.uint8(4) if south[n] == UNKNOWN else np.uint8(0)))
        bits = np.uint8(bits | (np.uint8(8) if north[n] == UNKNOWN else np.uint8(0)))
        bits = np.uint8(bits | (np.uint8(16) if below[n] == UNKNOWN else np.uint8(0)))
        bits = np.uint8(bits | (np.uint8(32) if above[n] == UNKNOWN else np.uint8(0)))
        bits = np.uint8(bits & allowed[n])
        out[n] = bits if here[n] == FREE else np.uint8(0)


@kernel
def cut(  # noqa: C901, PLR0912, PLR0915
    faces: ByteArray, ignored: ByteArray, block_i: int, block_j: int, max_extent: float, cells: IntArray, starts: IntArray
) -> int:
    """Divide one block into clusters and return their number.

    cells: filled with flat indices, cluster after cluster, ascending within each; length at least the voxels of the block.
    starts: filled with the start of each cluster and the end of the last; length at least the voxels of the block + 1.
    ignored: voxels with 1 are not frontier cells.
    """
    nx, ny, nz = faces.shape
    i0, j0 = block_i * BLOCK, block_j * BLOCK
    i1, j1 = min(i0 + BLOCK, nx), min(j0 + BLOCK, ny)
    tall, wide = nz + 2, (BLOCK + 2) * (nz + 2)
    run_of = np.zeros((BLOCK + 2) * wide, dtype=np.int32)  # with a border, so that no bounds check is needed
    parent = np.zeros(BLOCK * BLOCK * (nz // 2 + 1) + 1, dtype=np.int32)
    found = np.empty((i1 - i0) * (j1 - j0) * nz, dtype=np.int32)  # packed: 5 bits i, 5 bits j, the rest k
    found_run = np.empty(len(found), dtype=np.int32)
    # offsets of the neighbour columns scanned earlier; flat, because slicing an array costs more than reading a column
    before = (-wide - tall, -wide, -wide + tall, -tall)
    face, skip = faces.reshape(-1), ignored.reshape(-1)
    runs, total = 0, 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            at = (i * ny + j) * nz
            own = (i - i0 + 1) * wide + (j - j0 + 1) * tall + 1
            k = 0
            while k < nz:
                if face[at + k] == 0 or skip[at + k] != 0:
                    k += 1
                    continue
                first = k
                runs += 1
                parent[runs] = runs
                while k < nz and face[at + k] != 0 and skip[at + k] == 0:
                    run_of[own + k] = runs
                    found[total] = ((i - i0) << _I) | ((j - j0) << _J) | k
                    found_run[total] = runs
                    total += 1
                    k += 1
                root = runs
                for side in range(4):
                    joined = 0
                    # 26-connectivity: corners touch too
                    for c in range(own + before[side] + first - 1, own + before[side] + k + 1):
                        if run_of[c] != joined and run_of[c] != 0:
                            joined = run_of[c]
                            root = _join(parent, root, joined)
    # components in the order of their first cells; cells keep the scan order within each
    piece_of = np.zeros(runs + 1, dtype=np.int32)
    pieces = 0
    for run in range(1, runs + 1):
        root = _root(parent, run)  # the lowest run number of its component
        if root == run:
            piece_of[run] = pieces
            pieces += 1
        else:
            piece_of[run] = piece_of[root]
    ends = np.zeros(pieces + 1, dtype=np.int64)
    for n in range(total):
        ends[piece_of[found_run[n]] + 1] += 1
    for piece in range(pieces):
        ends[piece + 1] += ends[piece]
    free_at = ends.copy()
    packed = np.empty(total, dtype=np.int32)
    for n in range(total):
        piece = piece_of[found_run[n]]
        packed[free_at[piece]] = found[n]
        free_at[piece] += 1
    clusters = 0
    along = np.empty(total)
    for piece in range(pieces):
        clusters = _split(packed, ends[piece], ends[piece + 1], max_extent, found, along, starts, clusters)
    starts[clusters] = total
    for n in range(total):
        cells[n] = ((i0 + (packed[n] >> _I)) * ny + j0 + ((packed[n] >> _J) & 31)) * nz + (packed[n] & _K)
    return clusters


@kernel
def _root(parent: Int32Array, run: int) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@kernel
def _join(parent: Int32Array, root: int, other: int) -> int:
    """Merge the trees of a root and of another run; return the new root, the lower number."""
    other = _root(parent, other)
    if root < other:
        parent[other] = root
        return root
    parent[root] = other
    return other


@kernel
def _split(
    packed: Int32Array,
    first: int,
    end: int,
    max_extent: float,
    scratch: Int32Array,
    along: FloatArray,
    starts: IntArray,
    clusters: int,
) -> int:
    """Halve packed[first:end] in place until each part fits in one view.

    Writes the starts of the parts and returns the new number of clusters.
    """
    todo = np.empty((_STACK, 2), dtype=np.int64)
    todo[0, 0], todo[0, 1] = first, end
    depth = 1
    while depth:
        depth -= 1
        a, b = todo[depth, 0], todo[depth, 1]
        if depth + 2 > _STACK or _extent(packed, a, b, along) <= max_extent:
            starts[clusters] = a
            clusters += 1
            continue
        # the sign of an axis is arbitrary: the half with the first cell comes first
        positive = along[0] > 0.0
        kept, moved = a, 0
        for n in range(a, b):
            if (along[n - a] > 0.0) == positive:
                packed[kept] = packed[n]
                kept += 1
            else:
                scratch[moved] = packed[n]
                moved += 1
        for n in range(moved):
            packed[kept + n] = scratch[n]
        todo[depth, 0], todo[depth, 1] = kept, b
        todo[depth + 1, 0], todo[depth + 1, 1] = a, kept
        depth += 2
    return clusters


@kernel
def _extent(packed: Int32Array, a: int, b: int, along: FloatArray) -> float:
    """Return the length of packed[a:b] along its first principal component.

    The coordinates along the component are written to ``along``.
    """
    count = b - a
    sx, sy, sz, xx, yy, zz, xy, xz, yz = 0, 0, 0, 0, 0, 0, 0, 0, 0
    for n in range(a, b):
        x, y, z = packed[n] >> _I, (packed[n] >> _J) & 31, packed[n] & _K
        sx += x
        sy += y
        sz += z
        xx += x * x
        yy += y * y
        zz += z * z
        xy += x * y
        xz += x * z
        yz += y * z
    # integers up to here, so the moments are exact
    ux, uy, uz = main_axis(
        float(count * xx - sx * sx),
        float(count * yy - sy * sy),
        float(count * zz - sz * sz),
        float(count * xy - sx * sy),
        float(count * xz - sx * sz),
        float(count * yz - sy * sz),
    )
    mean = (ux * sx + uy * sy + uz * sz) / count
    least, most = np.inf, -np.inf
    for n in range(a, b):
        value = ux * (packed[n] >> _I) + uy * ((packed[n] >> _J) & 31) + uz * (packed[n] & _K) - mean
        along[n - a] = value
        least, most = min(least, value), max(most, value)
    return most - least


@kernel
def main_axis(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> tuple[float, float, float]:
    """Return the unit eigenvector of the largest eigenvalue of a symmetric 3x3 matrix.

    For equal eigenvalues, one of them is chosen. The eigenvalue is in closed form: Smith, "Eigenvalues of a symmetric 3x3
    matrix" (1961).
    """
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    p = np.sqrt((a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
    if p <= 1e-12 * abs(mean):
        return 1.0, 0.0, 0.0
    half_det = (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / (2.0 * p * p * p)
    largest = 2.0 * p * np.cos(np.arccos(min(max(half_det, -1.0), 1.0)) / 3.0)
    a, b, c = a - largest, b - largest, c - largest
    # the rows (a xy xz), (xy b yz), (xz yz c) are all orthogonal to the eigenvector: take their longest cross product
    best, ux, uy, uz = 0.0, 0.0, 0.0, 0.0
    for pair in range(3):
        if pair == 0:
            x, y, z = xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy
        elif pair == 1:
            x, y, z = xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz
        else:
            x, y, z = b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz
        length2 = x * x + y * y + z * z
        if length2 > best:
            best, ux, uy, uz = length2, x, y, z
    if best <= 1e-20 * p * p * p * p:
        # the two largest eigenvalues are equal: take any vector orthogonal to the longest row
        if abs(a) >= abs(b) and abs(a) >= abs(c):
            ux, uy, uz = (-xy, a, 0.0)
        elif abs(b) >= abs(c):
            ux, uy, uz = (b, -xy, 0.0)
        else:
            ux, uy, uz = (c, 0.0, -xz)
        best = ux * ux + uy * uy + uz * uz
    length = np.sqrt(best)
    return ux / length, uy / length, uz / length


@kernel
def is_speck(faces: ByteArray, ignored: ByteArray, start: int) -> bool:
    """Return True if fewer than MIN_CELLS cells are connected with the cell at a flat index.

    The cell itself counts.
    """
    nx, ny, nz = faces.shape
    seen = np.empty(MIN_CELLS, dtype=np.int64)
    seen[0] = start
    count, done = 1, 0
    while done < count:
        column = seen[done] // nz
        i, j, k = column // ny, column % ny, seen[done] % nz
        done += 1
        for a in range(max(i - 1, 0), min(i + 2, nx)):
            for b in range(max(j - 1, 0), min(j + 2, ny)):
                for c in range(max(k - 1, 0), min(k + 2, nz)):
                    if faces[a, b, c] == 0 or ignored[a, b, c] != 0:
                        continue
                    flat = (a * ny + b) * nz + c
                    fresh = True
                    for n in range(count):
                        fresh = fresh and seen[n] != flat
                    if fresh:
                        if count + 1 >= MIN_CELLS:
                            return False
                        seen[count] = flat
                        count += 1
    return True
