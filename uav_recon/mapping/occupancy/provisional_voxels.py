"""Provisional voxels: returns in known-free space, until they are confirmed or given up.

A body that walks through a room is there for less than a second at each place. Where it was, the log-odds keep it until the
camera looks there again. So a voxel that was free is provisional from its first return on, and so is the space behind it that
has become unknown. It is not free as long as that lasts. It is confirmed if its returns go on for CONFIRMED_S, and becomes
unknown if there is none for GIVEN_UP_S. Within SURFACE_VOXELS of a surface or of unknown space it is only confirmed: returns
there are the surface itself, seen with the errors of camera and pose.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.occupancy.log_odds import FREE_AT, OCCUPIED_AT
from uav_recon.types.frames import AnyArray, BoolArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN

#: plan: returns in a voxel that was free are confirmed after this time; a body of 0.5 m that walks at 0.6 m/s stays for 1.2 s
CONFIRMED_S = 2.0
GIVEN_UP_S = 2.5  #: plan: a provisional voxel without a return for this time becomes unknown
FORGOTTEN_S = 20.0  #: plan: unknown space behind returns where free space was known is no longer provisional after this time
SURFACE_VOXELS = 2  #: plan: returns no farther than this from a surface, or from unknown space, may belong to it
MOST_ODDS = 6  #: internal: upper clamp of their log-odds: each further return shows, and they are soon free again
_MOST = 65_536  #: internal: number of provisional voxels; more are confirmed at once


class _Entries(NamedTuple):
    """Provisional voxels in order of their first return; only the first ones are in use.

    Each (_MOST,). flat: indices. apart: from all surfaces and from unknown space. odds: after the newest frame. first_s and
    last_s: instants of the first and newest return. listed: (nx * ny * nz,) voxels that are among them.
    """

    flat: IntArray
    apart: BoolArray
    odds: AnyArray
    first_s: FloatArray
    last_s: FloatArray
    listed: BoolArray


class ProvisionalVoxels:
    """The provisional voxels of one map. Not thread-safe.

    ``shown``: number of them with a return in the newest frame that are away from all surfaces. shape: of the map.
    """

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self._shape = shape
        self._entries = _Entries(
            flat=np.zeros(_MOST, dtype=np.int64), apart=np.zeros(_MOST, dtype=np.bool_), odds=np.zeros(_MOST, dtype=np.int8),
            first_s=np.zeros(_MOST), last_s=np.zeros(_MOST), listed=np.zeros(int(np.prod(shape)), dtype=np.bool_),
        )  # fmt: skip
        self._number = self.shown = 0

    def clear(self) -> None:
        """Forget all of them."""
        self._entries.listed[self._entries.flat[: self._number]] = False
        self._number = self.shown = 0

    @property
    def any(self) -> bool:
        """True if there are provisional voxels."""
        return self._number > 0

    def update(self, listed: IntArray, fused: int, number: int, state: AnyArray, odds: AnyArray, stamp_s: float) -> int:
        """Bring them up to a frame that was fused; returns the new length of the list.

        listed[:fused]: as from fuse(). listed[:number], state, odds: as after reset_behind_new_obstacles(). Appends those that
        were given up.
        """
        self._number, self.shown, number = _update(
            listed, fused, number, state, odds, self._shape, stamp_s, self._entries, self._number
        )
        return number


@kernel
def _is_apart(index: int, state: AnyArray, shape: tuple[int, int, int], provisional: AnyArray) -> bool:
    """Return True if no voxel near is occupied or unknown, other than provisional ones."""
    column = index // shape[2]
    x, y, z = column // shape[1], column % shape[1], index % shape[2]
    for i in range(max(x - SURFACE_VOXELS, 0), min(x + SURFACE_VOXELS + 1, shape[0])):
        for j in range(max(y - SURFACE_VOXELS, 0), min(y + SURFACE_VOXELS + 1, shape[1])):
            for k in range(max(z - SURFACE_VOXELS, 0), min(z + SURFACE_VOXELS + 1, shape[2])):
                near = (i * shape[1] + j) * shape[2] + k
                if (state[near] == OCCUPIED or state[near] == UNKNOWN) and not provisional[near]:
                    return False
    return True


@kernel
def _update(
    listed: IntArray, fused: int, number: int, state: AnyArray, odds: AnyArray, shape: tuple[int, int, int], stamp_s: float,
    entries: _Entries, count: int,
) -> tuple[int, int, int]:  # fmt: skip
    """Return the number of provisional voxels, of those with a return, and of the list.

    See ProvisionalVoxels.update().
    """
    flat, apart, kept_odds, first_s, last_s, provisional = entries
    kept, shown, listing = 0, 0, number
    for n in range(count):
        index = flat[n]
        value, first, last = odds[index], first_s[n], last_s[n]
        if value > kept_odds[n]:
            first, last = stamp_s if kept_odds[n] <= 0 else first, stamp_s
            shown += int(apart[n])
        gone = stamp_s - last >= (GIVEN_UP_S if value > 0 else FORGOTTEN_S)
        if value <= FREE_AT or last - first >= CONFIRMED_S or (gone and (value <= 0 or not apart[n])):
            provisional[index] = False
            continue
        if gone and listing < listed.size:
            provisional[index] = False
            odds[index] = 0
            listed[listing] = index
            listing += 1
            continue
        odds[index] = min(value, MOST_ODDS) if apart[n] else value
        flat[kept], apart[kept], kept_odds[kept], first_s[kept], last_s[kept] = index, apart[n], odds[index], first, last
        kept += 1
    for n in range(number):
        index = listed[n]
        outside = state[index] == UNKNOWN and odds[index] < OCCUPIED_AT  # of the fence: seen free, but not FREE
        if (state[index] == FREE or outside) and odds[index] > FREE_AT and kept < flat.size and not provisional[index]:
            provisional[index] = True
            flat[kept], kept_odds[kept], first_s[kept], last_s[kept] = index, odds[index], stamp_s, stamp_s
            apart[kept] = _is_apart(index, state, shape, provisional)
            shown += int(n < fused and apart[kept])
            kept += 1
    return kept, shown, listing
