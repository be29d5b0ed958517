"""Places that a survey leaves although it could have seen them.

These are openings, frontiers with much unknown space beyond, whose views had no result, showed too little, or were not flown
to. Those outside the fence, too narrow for the vehicle, behind what it cannot pass, or out of its camera's view wherever it may
fly are no such places.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from scipy import ndimage

from uav_recon.planning.frontier.cluster_table import OPENING, ClusterTable
from uav_recon.planning.frontier.clustering import MAX_EXTENT_M
from uav_recon.planning.frontier.frontier_views import FlyableInterface, FrontierViews
from uav_recon.planning.frontier.frontiers import Frontiers
from uav_recon.types.frames import ByteArray, IntArray
from uav_recon.types.maps import VoxelMap
from uav_recon.types.reason_code import ReasonCode

_AROUND = np.ones((3, 3, 3), dtype=np.uint8)
_NEVER_TO_BE_SEEN = (
    ReasonCode.FRONTIERS_TOO_NARROW,
    ReasonCode.FRONTIERS_NOT_REACHABLE,
    ReasonCode.FRONTIERS_OUT_OF_VIEW,  # from any place where it may fly
)


def count_places_left(
    voxels: VoxelMap, space: FlyableInterface, frontiers: Frontiers, exhausted: ByteArray, views: FrontierViews
) -> dict[ReasonCode, int]:
    """Count the places that are left, by reason.

    Openings side by side with the same reason are one place. Slow; meant for the end of a flight.

    frontiers: up to date with voxels. exhausted: (nx, ny, nz) uint8, 1 = exhausted by unsuccessful views. views: with the
    demand of a usual view.
    """
    cells: dict[ReasonCode, list[IntArray]] = defaultdict(list)
    clusters = frontiers.rows()
    openings = clusters[frontiers.table.rows.beyond[clusters] >= OPENING]
    for row, reason in zip(openings.tolist(), views.reasons_of_clusters(voxels, space, frontiers, openings), strict=True):
        if reason not in _NEVER_TO_BE_SEEN:
            cells[reason or ReasonCode.FRONTIERS_NOT_FLOWN_TO].append(frontiers.flat(row))
    cells[ReasonCode.FRONTIERS_VIEWED_WITHOUT_RESULT] += _exhausted_openings(voxels, frontiers, exhausted)
    counts = {reason: _places(found, voxels.grid.shape) for reason, found in sorted(cells.items())}
    return {reason: count for reason, count in counts.items() if count}


def _exhausted_openings(voxels: VoxelMap, frontiers: Frontiers, exhausted: ByteArray) -> list[IntArray]:
    """Return the flat cells of each opening of which all cells are exhausted."""
    table = ClusterTable(voxels.grid.shape)
    blocks = np.ascontiguousarray(np.argwhere(np.ones(table.rows.head.shape, dtype=np.bool_)))
    table.cluster_again(frontiers.faces, (exhausted == 0).view(np.uint8), blocks, MAX_EXTENT_M / voxels.grid.resolution_m)
    rows = np.flatnonzero((table.rows.cells > 0) & (table.rows.speck == 0))
    found = [table.rows.pool[table.rows.start[row] : table.rows.start[row] + table.rows.cells[row]].copy() for row in rows]
    beyond = frontiers.unknown_beyond(voxels, found)
    return [cells for cells, unknown in zip(found, beyond.tolist(), strict=True) if unknown >= OPENING]


def _places(cells: list[IntArray], shape: tuple[int, int, int]) -> int:
    """Return the number of connected places that some cells form."""
    mask = np.zeros(shape, dtype=np.bool_)
    for flat in cells:
        mask.reshape(-1)[flat] = True
    return int(ndimage.label(mask, structure=_AROUND)[1])
