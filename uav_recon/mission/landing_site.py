"""Where to land: at home, unless the map shows that something stands there; then the nearest place that is known to be good.

What a map of voxels can tell of a patch: that nothing stands on it, that what is over it is known free, and that its floor is
no steeper and has no higher step than a voxel. Finer unevenness it cannot.
"""

from __future__ import annotations

import numpy as np

from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, VoxelMap

PATCH_M, REACH_M, STEP_M = 1.2, 5.0, 0.2  # a metre, and what voxels and a landing stray
_STANDS_M = 0.15  # over the floor; nearer to it, depth noise is floor
_FEWEST = 2  # voxels that touch: alone, they are speckles
_FLOOR_SHARE = 0.5  # of a patch that is not home: its floor was seen


class LandingSite:
    """height_m: of rest over the pad (odom's origin); ground_m: of its floor; room_m: what a flight keeps from anything."""

    def __init__(self, height_m: float, ground_m: float, room_m: float) -> None:
        self.home = np.array([0.0, 0.0, height_m])
        self._ground_m, self._room_m = ground_m, room_m

    def is_occupied(self, voxels: VoxelMap, place: FloatArray) -> bool:
        """Whether something stands where it would land from a place (3,). Beside it something may: the pad was chosen so."""
        return _stands(self._above(voxels, place, self._room_m))

    def choose(self, voxels: VoxelMap, unwanted: tuple[FloatArray, ...] = ()) -> FloatArray:
        """Over which place (3,) to land: home if nothing stands there, else the nearest good one, else home as the least bad.

        unwanted: places that turned out to be bad.
        """
        if not self.is_occupied(voxels, self.home):
            return self.home
        good = self.near(voxels, self.home, unwanted)
        return self.home if good is None else good

    def near(self, voxels: VoxelMap, here: FloatArray, unwanted: tuple[FloatArray, ...] = ()) -> FloatArray | None:
        """The good place (3,) nearest to one, level; None if there is none within REACH_M."""
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
        """Whether straight below a place (3,), however high, is a good one and nothing but known-free space in between."""
        place = np.array([*here[:2], self.home[2]])
        return self._is_good(voxels, place) and bool((self._above(voxels, here, self._room_m) == FREE).all())

    def _is_good(self, voxels: VoxelMap, place: FloatArray) -> bool:
        patch, over = self._above(voxels, place, PATCH_M / 2), self._above(voxels, place, self._room_m)
        if over.size == 0 or not (over == FREE).all() or _stands(patch):
            return False
        flyable = float(voxels.distance_m(voxels.grid.index(place))) >= self._room_m
        return flyable and self._floor_share(voxels, place) >= _FLOOR_SHARE

    def _above(self, voxels: VoxelMap, place: FloatArray, half_m: float) -> IntArray:
        """States (n, m, k) of what is over the floor of a square about a place, up to its height."""
        low = np.array([place[0] - half_m, place[1] - half_m, self._ground_m + _STANDS_M])
        high = np.array([place[0] + half_m, place[1] + half_m, place[2]])
        return _cut(voxels, low, high)

    def _floor_share(self, voxels: VoxelMap, place: FloatArray) -> float:
        """Of a patch's columns, those in which a floor was seen where the pad's floor is."""
        half_m = PATCH_M / 2
        low = np.array([place[0] - half_m, place[1] - half_m, self._ground_m - _STANDS_M])
        high = np.array([place[0] + half_m, place[1] + half_m, self._ground_m + _STANDS_M])
        seen: BoolArray = (_cut(voxels, low, high) == OCCUPIED).any(axis=2)
        return float(seen.mean()) if seen.size else 0.0


def _stands(states: IntArray) -> bool:
    """Whether something stands in a box of voxels (n, m, k): _FEWEST of them, with a corner in common at least."""
    occupied = states == OCCUPIED
    if int(occupied.sum()) < _FEWEST:
        return False
    around = np.lib.stride_tricks.sliding_window_view(np.pad(occupied, 1), (3, 3, 3))[occupied]
    return bool((around.sum(axis=(1, 2, 3)) >= _FEWEST).any())


def _cut(voxels: VoxelMap, low: FloatArray, high: FloatArray) -> IntArray:
    """The voxels whose centres lie in a box, as far as the grid goes."""
    shape = np.array(voxels.grid.shape)
    first, last = (
        np.clip(np.round((x - voxels.grid.origin_world_m) / voxels.grid.resolution_m), 0, shape) for x in (low, high)
    )
    (i, j, k), (ii, jj, kk) = first.astype(int).tolist(), last.astype(int).tolist()
    return np.asarray(voxels.state[i:ii, j:jj, k:kk])
