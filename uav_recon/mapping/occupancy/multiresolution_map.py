"""Occupancy map with fine maps of some places.

There the size of a voxel decides whether the vehicle fits.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from uav_recon.mapping.occupancy.occupancy_map import OccupancyMap
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import FloatArray
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.maps import GridSpec, VoxelMap
from uav_recon.types.pose import Pose

FINE_RESOLUTION_M = 0.025  #: plan: voxels of a fine map; LARGEST_DISTANCE_VOXELS of them reach beyond a hull and its margin
FINE_SIZE_M = (2.0, 2.0, 1.2)  #: plan: box of a fine map: a passage, and the reach of its distances around that
FINE_RANGE_M = 2.5  #: reject: depth beyond this in a fine map: its noise is more than a fine voxel
MAX_FINE_MAPS = 12  #: plan: number of fine maps
SAME_PLACE_M = 0.3  # a place this near to the centre of a fine map has that map

Place = tuple[float, float, float]  # x, y, z in world, m


class MultiResolutionMap:
    """An occupancy map, and fine maps of places in it, from the same frames.

    Implements interfaces.OccupancyMapInterface.
    """

    def __init__(self, coarse: OccupancyMap, make_fine: Callable[[GridSpec, int], OccupancyMap]) -> None:
        """Start without fine maps.

        make_fine: returns the empty map of a grid in a map epoch.
        """
        self._coarse = coarse
        self._make_fine = make_fine
        self._fine: dict[Place, OccupancyMap] = {}
        self._map_epoch = 0
        self._shown: VoxelMap | None = None

    @property
    def grid(self) -> GridSpec:
        """The grid of the whole map."""
        return self._coarse.grid

    @property
    def shows_motion(self) -> bool:
        """See OccupancyMap."""
        return self._coarse.shows_motion

    def refine(self, places_world: Sequence[FloatArray]) -> None:
        """Keep fine maps around positions (3,) from now on, the first MAX_FINE_MAPS of them.

        Frames from before are not in a new one. A map that is no longer asked for is dropped when its room is needed.
        """
        wanted = [(float(x), float(y), float(z)) for x, y, z in places_world]
        for place in wanted:
            if _is_near(place, self._fine):
                continue
            if len(self._fine) == MAX_FINE_MAPS:
                unwanted = next((one for one in self._fine if not _is_near(one, wanted)), None)
                if unwanted is None:
                    return
                del self._fine[unwanted]
            self._fine[place] = self._make_fine(_grid_around(place), self._map_epoch)

    def reset(self, map_epoch: int) -> None:
        """See OccupancyMap."""
        self._coarse.reset(map_epoch)
        self._map_epoch = map_epoch
        self._fine.clear()

    def integrate(self, posed: PosedFrame) -> int:
        """See OccupancyMap. A fine map in view costs about a millisecond.

        Thin gaps in it are closed, see thin_gaps.
        """
        changed = self._coarse.integrate(posed)
        for place, fine in self._fine.items():
            if not _may_show(posed.world_from_depth, np.array(place)):
                fine.give_up_provisional(posed.frame.stamp_s)
            elif fine.integrate(posed):
                fine.close_thin_gaps()
        return changed

    def integrate_cone(self, cone: FreeCone) -> int:
        """See OccupancyMap. It shows no detail."""
        return self._coarse.integrate_cone(cone)

    def declare_free(self, centre_world: FloatArray, radius_m: float, z_min_m: float, z_max_m: float) -> None:
        """See OccupancyMap."""
        for one in (self._coarse, *self._fine.values()):
            one.declare_free(centre_world, radius_m, z_min_m, z_max_m)

    def snapshot(self) -> VoxelMap:
        """See OccupancyMap."""
        coarse, fine = self._coarse.snapshot(), tuple(one.snapshot() for one in self._fine.values())
        if not fine:
            return coarse
        shown = self._shown
        if shown is None or shown.state is not coarse.state or shown.fine != fine:
            self._shown = shown = dataclasses.replace(coarse, fine=fine)
        return shown

    def explored_m3(self) -> float:
        """See OccupancyMap."""
        return self._coarse.explored_m3()

    def warm_up(self) -> None:
        """Compile every kernel on a small separate map."""
        self._coarse.warm_up()


def _is_near(place: Place, others: Iterable[Place]) -> bool:
    """Return True if one of some places is the same."""
    return any(np.linalg.norm(np.subtract(one, place)) < SAME_PLACE_M for one in others)


def _grid_around(place: Place) -> GridSpec:
    """Return the grid of a fine map."""
    size_voxels = np.rint(np.array(FINE_SIZE_M) / FINE_RESOLUTION_M).astype(int)
    first = np.rint(np.array(place) / FINE_RESOLUTION_M - size_voxels / 2)
    nx, ny, nz = size_voxels.tolist()
    return GridSpec(first * FINE_RESOLUTION_M, FINE_RESOLUTION_M, (nx, ny, nz))


def _may_show(world_from_depth: Pose, place_world: FloatArray) -> bool:
    """Return True if a camera may see the surroundings of a position."""
    towards = place_world - world_from_depth.translation_m
    ahead_m = float(world_from_depth.rotation()[:, 2] @ towards)
    return bool(np.linalg.norm(towards) <= FINE_RANGE_M and ahead_m > -FINE_SIZE_M[0] / 2)
