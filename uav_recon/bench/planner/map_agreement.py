"""Agreement of a map with a reference map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from uav_recon.types.frames import ByteArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN

_ONE_VOXEL = np.ones((3, 3, 3), dtype=bool)


@dataclass(frozen=True, slots=True)
class MapAgreement:
    """The result of a comparison.

    share: share of voxels whose state occurs in the reference in that voxel or in one of its 26 neighbours.
    occupied_freed: number of free voxels that are occupied in the reference.
    """

    share: float
    occupied_freed: int


def agreement(state: ByteArray, reference: ByteArray) -> MapAgreement:
    """Compare two maps (nx, ny, nz) uint8.

    One voxel of tolerance, because a wall on a voxel border may be in either voxel.
    """
    near = [ndimage.binary_dilation(reference == value, _ONE_VOXEL) for value in (UNKNOWN, FREE, OCCUPIED)]
    freed = np.count_nonzero((state == FREE) & (reference == OCCUPIED))
    return MapAgreement(float(np.choose(state, near).mean()), int(freed))
