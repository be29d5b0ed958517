"""Free-space check of straight paths for the whole hull. Unknown space is rejected."""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Iterator

from uav_recon.safety.envelope import Vec3
from uav_recon.types.maps import FreeSpace

_ROUNDING_M = 1e-9  #: internal: tolerance for the rounding of sums, in m and m²
_STANDING = 1e-30  # square of the length of a leg that counts as standing


class FreeSpaceCheck:
    """A published free space, checked for an upright hull of radius and height (m).

    The hull touches the voxels whose centres lie in it.
    """

    def __init__(self, space: FreeSpace, hull_radius_m: float, hull_height_m: float) -> None:
        self.map_epoch = space.map_epoch
        self._bits = space.bits.tobytes()
        self._shape = space.grid.shape
        self._step_m = space.grid.resolution_m
        x, y, z = space.grid.origin_world_m.tolist()
        self._origin: Vec3 = (x, y, z)
        self._wide = hull_radius_m / self._step_m
        self._high = hull_height_m / 2.0 / self._step_m

    def admits(self, *way_m: Vec3) -> bool:
        """Return True if the hull may move along straight legs through these positions (odom, m).

        It must touch nothing that is not known free, except voxels that it touches already and that no leg approaches: a false
        obstacle beside a vehicle must not keep it there.
        """
        way = [self._in_voxels(place_m) for place_m in way_m]
        met = ((a, b, voxel) for a, b in itertools.pairwise(way) for voxel in self._touched(a, b))
        return all(
            c in self._touched(way[0], way[0])
            and sum((q - p) * (r - p) for p, q, r in zip(a, b, c, strict=True)) <= _ROUNDING_M
            for a, b, c in met
        )

    def _touched(self, a: Vec3, b: Vec3) -> Iterator[tuple[int, int, int]]:
        """Yield the voxels not known free in a hull that moves from a to b.

        For each column, these are the voxels that it passes while the column is within its radius, from root to root of
        |column - a - share (b - a)| = radius.
        """
        wide, high, (x, y, z), (dx, dy, dz) = self._wide + _ROUNDING_M, self._high + _ROUNDING_M, a, map(operator.sub, b, a)
        rows, columns = _between(x, b[0], wide), _between(y, b[1], wide)
        if self._is_open(rows, columns, _between(z, z + dz, high)):
            return  # true for nearly every path that is flown
        square = dx * dx + dy * dy + _STANDING
        for i, j in itertools.product(rows, columns):
            along = (i - x) * dx + (j - y) * dy
            root2 = along * along - square * ((i - x) ** 2 + (j - y) ** 2 - wide * wide)
            root = math.sqrt(max(root2, 0.0))
            first, last = max((along - root) / square, 0.0), min((along + root) / square, 1.0)
            if root2 >= 0.0 and first <= last:
                column, layers = (range(i, i + 1), range(j, j + 1)), _between(z + dz * first, z + dz * last, high)
                yield from ((i, j, k) for k in layers if not self._is_open(*column, range(k, k + 1)))

    def _is_open(self, rows: range, columns: range, layers: range) -> bool:
        """Return True if a whole box is known free.

        The bits of a row are consecutive, and are read together.
        """
        nx, ny, nz = self._shape
        if min(rows.start, columns.start, layers.start) < 0 or rows.stop > nx or columns.stop > ny or layers.stop > nz:
            return False
        row = sum([(1 << len(layers)) - 1 << n * nz for n in range(len(columns))])
        for i in rows:
            first = (i * ny + columns.start) * nz + layers.start
            end = first + row.bit_length()
            if int.from_bytes(self._bits[first >> 3 : (end + 7) >> 3], "big") >> (-end & 7) & row != row:
                return False
        return True

    def _in_voxels(self, place_m: Vec3) -> Vec3:
        """Return a position in voxel edges, a whole number at the centre of each voxel."""
        (x, y, z), (ox, oy, oz), step_m = place_m, self._origin, self._step_m
        return (x - ox) / step_m - 0.5, (y - oy) / step_m - 0.5, (z - oz) / step_m - 0.5


def _between(a: float, b: float, reach: float) -> range:
    """Return the voxels whose centres lie between two positions or within reach of one."""
    return range(math.ceil(min(a, b) - reach), math.floor(max(a, b) + reach) + 1)
