"""Counts of rejected frontiers by reason, for the report at the end of a survey.

One scan over the whole map.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from uav_recon.geometry.jit import kernel
from uav_recon.planning.frontier.clustering import MIN_CELLS
from uav_recon.types.frames import BoolArray, ByteArray
from uav_recon.types.maps import FREE, UNKNOWN
from uav_recon.types.reason_code import ReasonCode

_AROUND = np.ones((3, 3, 3), dtype=np.uint8)


def count_rejected_frontiers(state: ByteArray, faces: ByteArray, exhausted: ByteArray) -> dict[ReasonCode, int]:
    """Count the rejected 26-connected frontiers by reason.

    Reasons: too small, exhausted, or outside the fence.

    state: (nx, ny, nz) uint8 voxel states.
    faces: (nx, ny, nz) uint8 unknown neighbours of frontier voxels inside the fence.
    exhausted: (nx, ny, nz) uint8, 1 = exhausted by unsuccessful views.
    """
    inside, in_vain = faces > 0, exhausted > 0
    sizes = _sizes(inside & ~in_vain)
    return {
        ReasonCode.FRONTIERS_TOO_SMALL: int(np.count_nonzero(sizes < MIN_CELLS)),
        ReasonCode.FRONTIERS_VIEWED_WITHOUT_RESULT: _cluster_count(inside & in_vain),
        ReasonCode.FRONTIERS_OUTSIDE_FENCE: _cluster_count(_beside_unknown(state) & ~inside),
    }


def _cluster_count(mask: BoolArray) -> int:
    return int(np.count_nonzero(_sizes(mask) >= MIN_CELLS))


def _sizes(mask: BoolArray) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Return the number of voxels of each component."""
    labels, count = ndimage.label(mask, structure=_AROUND)
    return np.bincount(labels.ravel(), minlength=count + 1)[1:].astype(np.int64)


@kernel
def _beside_unknown(state: ByteArray) -> BoolArray:
    """Return a mask (nx, ny, nz) of the free voxels with an unknown face neighbour."""
    nx, ny, nz = state.shape
    out = np.zeros(state.shape, dtype=np.bool_)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if state[i, j, k] == FREE:
                    beside = (i > 0 and state[i - 1, j, k] == UNKNOWN) or (i + 1 < nx and state[i + 1, j, k] == UNKNOWN)
                    beside = (
                        beside or (j > 0 and state[i, j - 1, k] == UNKNOWN) or (j + 1 < ny and state[i, j + 1, k] == UNKNOWN)
                    )
                    out[i, j, k] = (
                        beside or (k > 0 and state[i, j, k - 1] == UNKNOWN) or (k + 1 < nz and state[i, j, k + 1] == UNKNOWN)
                    )
    return out


def warm_up() -> None:
    """Compile the kernel for the read-only array of a VoxelMap."""
    state = np.zeros((2, 2, 2), dtype=np.uint8)
    state.setflags(write=False)
    _beside_unknown(state)
