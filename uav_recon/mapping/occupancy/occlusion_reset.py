"""Occlusion reset: space behind an obstacle that appears in free space becomes unknown."""

from __future__ import annotations

import math

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.occupancy.log_odds import FREE_AT
from uav_recon.types.frames import AnyArray
from uav_recon.types.maps import FREE


@kernel
def reset_behind_new_obstacles(
    listed: AnyArray, number: int, odds: AnyArray, state: AnyArray, shape: tuple[int, int, int], origin: AnyArray, reach: float
) -> int:
    """Reset the free voxels behind new obstacles to unknown; returns the new length of the list.

    A new obstacle is a listed voxel that was free and has returns in this frame. A box that appears shows one side only, and
    the rest of it occupies space that was observed as free. The reset follows the ray from the camera behind the obstacle,
    up to ``reach`` voxels or up to the first voxel that is not free.

    listed[:number]: as from fuse(); state (nx * ny * nz,): as before the frame; origin: the camera, in voxels. Appends the
    flat indices of the voxels that were reset to the list.
    """
    listing = number
    for n in range(number):
        index = listed[n]
        if state[index] != FREE or odds[index] <= FREE_AT:
            continue
        column = index // shape[2]
        x, y, z = column // shape[1] + 0.5, column % shape[1] + 0.5, index % shape[2] + 0.5
        dx, dy, dz = x - origin[0], y - origin[1], z - origin[2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if length < 1e-6:
            continue
        dx, dy, dz = dx / length, dy / length, dz / length
        t = 0.5
        while t <= reach and listing < listed.size:
            i, j, k = math.floor(x + t * dx), math.floor(y + t * dy), math.floor(z + t * dz)
            t += 0.5
            if not (0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]):
                break
            behind = (i * shape[1] + j) * shape[2] + k
            if state[behind] != FREE:
                break
            if odds[behind] <= FREE_AT:
                odds[behind] = 0
                listed[listing] = behind
                listing += 1
    return listing
