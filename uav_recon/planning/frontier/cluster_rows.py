"""The arrays of the table of frontier clusters, as kernels take them."""

from __future__ import annotations

from typing import NamedTuple

from uav_recon.types.frames import ByteArray, FloatArray, IntArray


class ClusterRows(NamedTuple):
    """Arrays of M rows, one per cluster, and their index by block.

    head: (blocks) first row of a block + 1, or 0.
    after: (M,) next row of the block + 1, or 0.
    cells: (M,) number of cells; 0 = the row is unused.
    speck: (M,) 1 = too few connected cells to be worth a view.
    key: (M,) hash of the cells and their unknown faces.
    start: (M,) start of the cells' flat indices in ``pool``.
    centre: (M, 3) mean of the cells' centres, voxels.
    beyond: (M,) unknown voxels behind the cluster, see unknown_volume.py.
    spare: (M,) stack of unused rows.
    fill: (2,) used length of ``pool``, and number of unused rows.
    pool: flat indices of the cells of all clusters.
    """

    head: IntArray
    after: IntArray
    cells: IntArray
    speck: ByteArray
    key: IntArray
    start: IntArray
    centre: FloatArray
    beyond: IntArray
    spare: IntArray
    fill: IntArray
    pool: IntArray
