"""Thin gaps: unknown voxels that no line of sight passed, between free ones.

At the edge of a near surface a depth camera measures nothing, so a sheet as thin as a pixel stays unknown behind it. In voxels
of that size, it would part the free space of a doorway.
"""

from __future__ import annotations

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.occupancy.log_odds import FREE_AT
from uav_recon.types.frames import AnyArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN


@kernel
def close_thin_gaps(state: AnyArray, shape: tuple[int, int, int], odds: AnyArray, listed: AnyArray) -> int:
    """Give the voxels of thin gaps the least evidence of free space; returns their number.

    Such a voxel is unknown, with free voxels on both sides of it along one axis, and none of the 26 voxels around it is
    occupied. A single solid return marks it later. state, odds (nx * ny * nz,): flat. listed: output, flat indices.
    """
    nx, ny, nz = shape
    across, along = ny * nz, nz
    count = 0
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            for k in range(1, nz - 1):
                index = (i * ny + j) * nz + k
                if state[index] != UNKNOWN or odds[index] > 0 or count == listed.size:
                    continue
                if not (
                    (state[index - across] == FREE and state[index + across] == FREE)
                    or (state[index - along] == FREE and state[index + along] == FREE)
                    or (state[index - 1] == FREE and state[index + 1] == FREE)
                ):
                    continue
                beside = False
                for step in range(27):
                    to = index + (step // 9 - 1) * across + (step // 3 % 3 - 1) * along + step % 3 - 1
                    beside = beside or state[to] == OCCUPIED
                if not beside:
                    odds[index] = FREE_AT
                    listed[count] = index
                    count += 1
    return count
