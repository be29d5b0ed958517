"""How well a map agrees with a reference map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from uav_recon.types.frames import ByteArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN

_ONE_VOXEL = np.ones((3, 3, 3), dtype=bool)


@dataclass(frozen=True, slots=True)
class MapAgreement:
    """share: voxels whose state the reference has in that voxel or in one of its 26 neighbours; occupied_freed: a count."""

    share: float
    occupied_freed: int


def agreement(state: ByteArray, reference: ByteArray) -> MapAgreement:
    """Compare two maps (nx, ny, nz) uint8; walls that lie on voxel borders fall to either side, hence the one voxel."""
    near = [ndimage.binary_dilation(reference == value, _ONE_VOXEL) for value in (UNKNOWN, FREE, OCCUPIED)]
    freed = np.count_nonzero((state == FREE) & (reference == OCCUPIED))
    return MapAgreement(float(np.choose(state, near).mean()), int(freed))
