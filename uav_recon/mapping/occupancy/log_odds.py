"""Log-odds of a voxel: update steps, clamps, and the state for a value."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray
from uav_recon.types.maps import FREE, OCCUPIED, TILE, UNKNOWN

# Evidence in steps of log-odds. One frame never frees a voxel: it takes two clear observations or four doubtful ones (two of
# either kind if the noise of the sensor is negligible against a voxel). One solid hit at close range marks a voxel occupied,
# a thin or distant one needs two frames. The clamps bound how long a change takes.
FREE_AT = -4
OCCUPIED_AT = 2
CLEAR_STEPS = 2
MIN_LOG_ODDS = -10
MAX_LOG_ODDS = 12
NOISE_SIGMAS = 2.5  # a surface may be nearer than its measured depth by up to this many sigmas
EXACT_SHARE = 0.1  # a sensor is exact if its noise (NOISE_SIGMAS, at the largest range) is below this share of a voxel


@kernel
def weak_observation_steps(noise_per_m: float, far_m: float, resolution_m: float) -> int:
    """Return the steps towards free of an observation with less than twice its margin.

    The depth noise (one sigma) is noise_per_m * depth².
    """
    return CLEAR_STEPS if NOISE_SIGMAS * noise_per_m * far_m**2 <= EXACT_SHARE * resolution_m else CLEAR_STEPS // 2


@kernel
def add_log_odds(odds: AnyArray, index: int, evidence: int) -> bool:
    """Add evidence to a voxel; returns True if the state of the voxel may have changed."""
    before = np.int32(odds[index])
    after = min(max(before + np.int32(evidence), np.int32(MIN_LOG_ODDS)), np.int32(MAX_LOG_ODDS))
    odds[index] = np.int8(after)
    return bool(((before <= FREE_AT) != (after <= FREE_AT)) | ((before >= OCCUPIED_AT) != (after >= OCCUPIED_AT)))


@kernel
def _inside(index: int, shape: tuple[int, int, int], fence: AnyArray) -> bool:
    """Return True if a flat index lies in the box [fence[0], fence[1])."""
    column, k = divmod(index, shape[2])
    i, j = divmod(column, shape[1])
    across = (fence[0, 0] <= i < fence[1, 0]) and (fence[0, 1] <= j < fence[1, 1])
    return bool(across and (fence[0, 2] <= k < fence[1, 2]))


@kernel
def new_states(
    listed: AnyArray,
    number: int,
    odds: AnyArray,
    shape: tuple[int, int, int],
    fence: AnyArray,
    state: AnyArray,
    found: AnyArray,
) -> int:
    """Reduce the list to the voxels whose state has to change; returns their number.

    The state of a voxel has to change if it differs from that of its log-odds. listed[:number]: flat indices, each at most
    once. The remaining indices are in listed, their new states in found. Outside the fence nothing is free.
    """
    kept = 0
    for n in range(number):
        index = listed[n]
        value = odds[index]
        now = np.uint8(OCCUPIED) if value >= OCCUPIED_AT else np.uint8(UNKNOWN)
        if value <= FREE_AT and _inside(index, shape, fence):
            now = np.uint8(FREE)
        if now != state[index]:
            listed[kept], found[kept] = index, now
            kept += 1
    return kept


@kernel
def copy_changed(
    listed: AnyArray, found: AnyArray, number: int, shape: tuple[int, int, int], fence: AnyArray, revision: int,
    state: AnyArray, tile_revision: AnyArray, first: AnyArray, last: AnyArray,
) -> int:  # fmt: skip
    """Write the new states and update what depends on them; returns the growth of known voxels.

    Sets the revision of the tiles written. Widens [first[x], last[x]) by each column whose free space changed. The returned
    growth counts voxels inside the fence only.
    """
    grown = 0
    for n in range(number):
        index, now = listed[n], found[n]
        column = index // shape[2]
        i, j = divmod(column, shape[1])
        before = state[index]
        state[index] = now
        tile_revision[i // TILE, j // TILE] = revision
        if (before == FREE) != (now == FREE):
            first[i], last[i] = min(first[i], j), max(last[i], j + 1)
        if (before == UNKNOWN) != (now == UNKNOWN) and _inside(index, shape, fence):
            grown += 1 if before == UNKNOWN else -1
    return grown
