"""Landing site: home, or the nearest good position if the map shows an obstacle at home.

What a voxel map can show of a patch: that nothing stands on it, that the space over it is known free, and that its floor is
no steeper and has no higher step than a voxel. It cannot show finer unevenness.
"""

from __future__ import annotations

import numpy as np

from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, VoxelMap

PATCH_M = 1.2  #: land: edge of the square that must be free: one metre, plus the errors of voxels and of a landing
REACH_M = 5.0  #: land: no site farther away is looked for
STEP_M = 0.2  #: land: distance between the sites that are tried
_STANDS_M = 0.15  #: land: what is this high over the floor stands on it; below, depth noise is part of the floor
_FEWEST = 2  #: land: fewer touching voxels are speckles, and no obstacle
_FLOOR_SHARE = 0.5  #: land: no site, other than home, with less of its floor seen


class LandingSite:
    """Finds a landing site.

    height_m: of rest over the pad (odom's origin). ground_m: of its floor. clearance_m: clearance of a flight.
    """

    def __init__(self, height_m: float, ground_m: float, clearance_m: float) -> None:
        self.home = np.array([0.0, 0.0, height_m])
        self._ground_m = ground_m
        self._clearance_m = clearance_m

    def is_occupied(self, voxels: VoxelMap, place: FloatArray) -> bool:
        """Return True if something stands where the vehicle would land from a position (3,).

        Obstacles beside it are allowed: the pad was chosen like that.
        """
        return _stands(self._above(voxels, place, self._clearance_m))

    def choose(self, voxels: VoxelMap, unwanted: tuple[FloatArray, ...] = ()) -> FloatArray:
        """Return the position (3,) over the landing site.

        It is home if nothing stands there, else the nearest good position, else home as the least bad.

        unwanted: positions that turned out to be bad.
        """
        if not self.is_occupied(voxels, self.home):
            return self.home
        good = self.near(voxels, self.home, unwanted)
        return self.home if good is None else good

    def near(self, voxels: VoxelMap, here: FloatArray, unwanted: tuple[FloatArray, ...] = ()) -> FloatArray | None:
        """Return the good position (3,) nearest to a position, level; None if none within REACH_M."""
        offsets = np.arange(-REACH_M, REACH_M + STEP_M / 2, STEP_M)
        across, along = np.meshgrid(offsets, offsets, indexing="ij")
        away = np.hypot(across, along).ravel()
        for n in np.argsort(away, kind="stable"):
            place: FloatArray = np.array([here[0] + across.flat[n], here[1] + along.flat[n], self.home[2]])
            tried = any(np.linalg.norm(place - other) < PATCH_M / 2 for other in unwanted)
            if away[n] <= REACH_M and not tried and self._is_good(voxels, place):
                return place
        return None

    def is_below(self, voxels: VoxelMap, here: FloatArray) -> bool:
        """Return True if a good site is straight below a position (3,) at any height.

        The space in between must be known free.
        """
        place = np.array([*here[:2], self.home[2]])
        return self._is_good(voxels, place) and bool((self._above(voxels, here, self._clearance_m) == FREE).all())

    def _is_good(self, voxels: VoxelMap, place: FloatArray) -> bool:
        patch, over = self._above(voxels, place, PATCH_M / 2), self._above(voxels, place, self._clearance_m)
        if over.size == 0 or not (over == FREE).all() or _stands(patch):
            return False
        flyable = float(voxels.distance_m(voxels.grid.index(place))) >= self._clearance_m
        return flyable and self._floor_share(voxels, place) >= _FLOOR_SHARE

    def _above(self, voxels: VoxelMap, place: FloatArray, half_m: float) -> IntArray:
        """Return the states (n, m, k) of the voxels over the floor of a square about a position.

        They reach up to the position's height.
        """
        low = np.array([place[0] - half_m, place[1] - half_m, self._ground_m + _STANDS_M])
        high = np.array([place[0] + half_m, place[1] + half_m, place[2]])
        return _cut(voxels, low, high)

    def _floor_share(self, voxels: VoxelMap, place: FloatArray) -> float:
        """Return the share of a patch's columns with a seen floor at the height of the pad's floor."""
        half_m = PATCH_M / 2
        low = np.array([place[0] - half_m, place[1] - half_m, self._ground_m - _STANDS_M])
        high = np.array([place[0] + half_m, place[1] + half_m, self._ground_m + _STANDS_M])
        seen: BoolArray = (_cut(voxels, low, high) == OCCUPIED).any(axis=2)
        return float(seen.mean()) if seen.size else 0.0


def _stands(states: IntArray) -> bool:
    """Return True if a box of voxels (n, m, k) holds an obstacle.

    That is _FEWEST occupied voxels that share at least a corner.
    """
    occupied = states == OCCUPIED
    if int(occupied.sum()) < _FEWEST:
        return False
    around = np.lib.stride_tricks.sliding_window_view(np.pad(occupied, 1), (3, 3, 3))[occupied]
    return bool((around.sum(axis=(1, 2, 3)) >= _FEWEST).any())


def _cut(voxels: VoxelMap, low: FloatArray, high: FloatArray) -> IntArray:
    """Return the voxels whose centres lie in a box, clipped to the grid."""
    shape = np.array(voxels.grid.shape)
    first, last = (
        np.clip(np.round((x - voxels.grid.origin_world_m) / voxels.grid.resolution_m), 0, shape) for x in (low, high)
    )
    (i, j, k), (ii, jj, kk) = first.astype(int).tolist(), last.astype(int).tolist()
    return np.asarray(voxels.state[i:ii, j:jj, k:kk])
