"""Whether the hull may go along a straight way: what is not known free is refused."""

from __future__ import annotations

import itertools
import math

from uav_recon.safety.envelope import Vec3
from uav_recon.types.maps import FreeSpace

_Index = tuple[int, int, int]

_ROUNDING = 1e-9


class KnownFree:
    """One published free space, asked for an upright hull of radius and height (m), which touches the voxels whose centres
    lie in it.
    """

    def __init__(self, space: FreeSpace, hull_radius_m: float, hull_height_m: float) -> None:
        self.map_epoch = space.map_epoch
        self._bits, self._shape, self._step_m = space.bits.tobytes(), space.grid.shape, space.grid.resolution_m
        x, y, z = space.grid.origin_world_m.tolist()
        self._origin: Vec3 = (x, y, z)
        self._wide, self._high = hull_radius_m / self._step_m, hull_height_m / 2.0 / self._step_m

    def admits(self, *way_m: Vec3) -> bool:
        """Whether the hull may go along straight legs through these places (odom, m).

        It touches nothing that is not known free, but for voxels that it touches already and does not come nearer to:
        a map that grows a ghost beside a hovering vehicle shall not keep it there.
        """
        way = [self._in_voxels(place_m) for place_m in way_m]
        touched = self._touched(way[0])
        for a, b in itertools.pairwise(way):
            steps = max(math.ceil(2.0 * math.dist(a, b)), 1)
            for n in range(steps + 1):
                share = n / steps
                here = (a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share)
                for voxel in self._touched(here):
                    if voxel not in touched or math.dist(voxel, here) < math.dist(voxel, way[0]) - _ROUNDING:
                        return False
        return True

    def _touched(self, centre: Vec3) -> set[_Index]:
        """Voxels in a hull there that are not known free."""
        x, y, z = centre
        wide, high = self._wide + _ROUNDING, self._high + _ROUNDING
        layers = range(math.ceil(z - high), math.floor(z + high) + 1)
        return {
            (i, j, k)
            for i in range(math.ceil(x - wide), math.floor(x + wide) + 1)
            for j in range(math.ceil(y - wide), math.floor(y + wide) + 1)
            if math.hypot(i - x, j - y) <= wide
            for k in layers
            if not self._is_free(i, j, k)
        }

    def _is_free(self, i: int, j: int, k: int) -> bool:
        nx, ny, nz = self._shape
        if not (0 <= i < nx and 0 <= j < ny and 0 <= k < nz):
            return False
        bit = (i * ny + j) * nz + k
        return self._bits[bit >> 3] >> (7 - (bit & 7)) & 1 == 1

    def _in_voxels(self, place_m: Vec3) -> Vec3:
        """In voxel edges, a whole number at the centre of each voxel."""
        (x, y, z), (ox, oy, oz), step_m = place_m, self._origin, self._step_m
        return (x - ox) / step_m - 0.5, (y - oy) / step_m - 0.5, (z - oz) / step_m - 0.5
