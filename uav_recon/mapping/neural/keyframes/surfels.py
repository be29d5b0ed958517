"""Surfels: mean point, normal and colour of each small surface cell of a view.

A cell is CELL_M wide across the half axis nearest to its normals, and DEEP_M deep along it. So a cell contains the surface
of views that disagree by several centimetres, but not both sides of a thin wall. Cells overlap by half in depth: a surface
never lies on the border of all of its cells.
"""

from __future__ import annotations

from itertools import compress

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.neural.keyframes.ray_records import BEARING_UNIT, DEPTH_UNIT_M, NORMAL_UNIT
from uav_recon.mapping.neural.keyframes.ray_sampling import TOE, WHITE
from uav_recon.types.frames import AnyArray, BoolArray, FloatArray, IntArray

CELL_M = 0.20
DEEP_M = 0.25
RAYS_USED = 2500
MAX_OVERLAPPING_VIEWS = 40  # maximum number of views that a view is compared with
FEWEST_RAYS = 1.5  # minimum weight of a surfel

LOG_LEVEL = np.log(np.arange(256) / 255.0 + float(TOE))  # of the 256 levels of a channel

# columns of a row
WEIGHT = 0
POINT = slice(1, 4)
NORMAL = slice(4, 7)
VARIANCE = 7
COLOURED = 8
COLOUR = slice(9, 12)
WHITENED = slice(12, 15)
COLUMNS = 15


class Surfels:
    """Surfels of all views at their current poses.

    A row contains the weight in rays, the mean point and normal in world, the mean variance of depth, the weight of the rays
    with a colour, their mean log(rgb + TOE), and the share of them that may be saturated, per channel.
    """

    def __init__(self, box_min_m: FloatArray, box_max_m: FloatArray) -> None:
        self._origin = np.asarray(box_min_m, dtype=np.float64)
        extent = np.asarray(box_max_m, dtype=np.float64) - self._origin
        self._across = np.ceil(extent / CELL_M).astype(np.int64)
        self._along = np.ceil(extent / DEEP_M).astype(np.int64) + 2
        layers = [int(np.prod(np.delete(self._across, axis))) * int(self._along[axis]) for axis in range(3)]
        self._first = np.concatenate([[0], np.cumsum(np.repeat(layers, 2))])
        self.cells = int(self._first[-1])
        self._sums = np.zeros((self.cells, COLUMNS))
        self._key: list[IntArray] = []
        self._row: list[FloatArray] = []

    def place(
        self,
        view: int,
        records: AnyArray,
        measured: AnyArray,
        rotation: FloatArray,
        position: FloatArray,
        lens: FloatArray,
    ) -> None:
        """Compute the surfels of a known view or the next one, at a pose.

        records (N, 10), measured (M,): depth of the first rays as measured, which are used; world_from_depth as rotation (3, 3)
        and position (3,); lens (3,): sigma of inverse depth, then the stretch of bearings and depth (ray_sampling.Views).
        """
        touched = np.zeros(2 * RAYS_USED, dtype=np.int64)
        count = _sum(
            records, measured, rotation, position, lens, self._origin, np.stack([self._across, self._along]), self._first,
            LOG_LEVEL, self._sums, touched,
        )  # fmt: skip
        key = touched[:count]
        row = self._sums[key]
        self._sums[key] = 0.0
        key, row = key[row[:, 0] >= FEWEST_RAYS], row[row[:, 0] >= FEWEST_RAYS]
        row[:, POINT.start : COLOURED] /= row[:, :1]
        row[:, COLOUR.start :] /= np.maximum(row[:, COLOURED, None], 1e-9)
        if view == len(self._key):
            self._key.append(key)
            self._row.append(row)
        self._key[view], self._row[view] = key, row

    def keep(self, which: BoolArray) -> None:
        """Drop all views except those selected by a mask (V,)."""
        self._key = list(compress(self._key, which))
        self._row = list(compress(self._row, which))

    def overlapping_views(self, view: int) -> tuple[IntArray, IntArray]:
        """Return the views (M,) that share most cells with a view, itself first, and counts (M,)."""
        mark = np.zeros(self.cells, dtype=np.int64)
        mark[self._key[view]] = 1
        shared = np.array([int(mark[key].sum()) for key in self._key])
        shared[view] += 1  # sort it before a view that shares all its cells
        most = np.argsort(-shared, kind="stable")[:MAX_OVERLAPPING_VIEWS]
        return most, shared[most]

    def of(self, views: IntArray, beside: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Return the surfels of the views ``beside`` in the cells of ``views``, sorted by cell.

        Returns cell (N,), view (N,), rows (N, COLUMNS).
        """
        mark = np.zeros(self.cells, dtype=np.bool_)
        for view in views:
            mark[self._key[view]] = True
        kept = [mark[self._key[view]] for view in beside]
        key = np.concatenate([self._key[view][keep] for view, keep in zip(beside, kept, strict=True)])
        row = np.concatenate([self._row[view][keep] for view, keep in zip(beside, kept, strict=True)])
        whose = np.repeat(beside, [int(keep.sum()) for keep in kept])
        order = np.argsort(key, kind="stable")
        return key[order], whose[order], row[order]


@kernel
def _sum(  # noqa: C901
    records: AnyArray, measured: AnyArray, rotation: FloatArray, position: FloatArray, lens: FloatArray, origin: FloatArray,
    layers: IntArray, first: IntArray, logarithm: FloatArray, rows: FloatArray, touched: IntArray,
) -> int:  # fmt: skip
    """Sum the rays of a view in its cells.

    lens: sigma of inverse depth, then the stretch of bearings and depth.
    """
    point, normal, colour = np.zeros(3), np.zeros(3), np.zeros(3)
    across, along = layers[0], layers[1]
    wider, deeper = lens[1] * BEARING_UNIT, lens[2] * DEPTH_UNIT_M
    count = 0
    for n in range(measured.shape[0]):
        record = records[n]
        if record[3] == 0 and record[4] == 0 and record[5] == 0:
            continue
        z = np.float64(measured[n]) * deeper
        x, y = record[0] * wider * z, record[1] * wider * z
        axis = 0
        for i in range(3):
            point[i] = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z + position[i]
            normal[i] = (rotation[i, 0] * record[3] + rotation[i, 1] * record[4] + rotation[i, 2] * record[5]) * NORMAL_UNIT
            if abs(normal[i]) > abs(normal[axis]):
                axis = i
        one, two = (axis + 1) % 3, (axis + 2) % 3
        if one > two:
            one, two = two, one
        i, j = int(np.floor((point[one] - origin[one]) / CELL_M)), int(np.floor((point[two] - origin[two]) / CELL_M))
        # from half a cell outside the box: if noise took points behind a wall away, the wall would seem nearer
        depth = (point[axis] - origin[axis]) / DEEP_M + 1.5
        k = int(np.floor(depth))
        if i < 0 or j < 0 or i >= across[one] or j >= across[two] or k < 1 or k >= along[axis]:
            continue
        for c in range(3):
            colour[c] = logarithm[record[6 + c]]
        layer = 2 * axis + (1 if normal[axis] > 0.0 else 0)
        for side in range(2):
            share = (depth - k if side else 1.0 - (depth - k)) + 1e-9
            key = first[layer] + ((k - 1 + side) * across[one] + i) * across[two] + j
            sums = rows[key]
            if sums[WEIGHT] == 0.0:
                touched[count] = key
                count += 1
            sums[WEIGHT] += share
            sums[VARIANCE] += share * (z * z * lens[0]) ** 2
            for c in range(3):
                sums[1 + c] += share * point[c]
                sums[4 + c] += share * normal[c]
                if record[9] == 1:
                    sums[9 + c] += share * colour[c]
                    sums[12 + c] += share if record[6 + c] >= WHITE else 0.0
            if record[9] == 1:
                sums[COLOURED] += share
    return count
