"""Integration of one depth frame into the log-odds: pooling, hit counts, carving, marking."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.occupancy.depth_min_pooling import CELL, LEVELS, STRIP, PooledDepth, min_pool
from uav_recon.mapping.occupancy.free_space_carving import carve_free, view_box
from uav_recon.mapping.occupancy.grid_camera import GridCamera
from uav_recon.mapping.occupancy.hit_integration import HitCounts, count_hits, mark_occupied
from uav_recon.mapping.occupancy.log_odds import weak_observation_steps
from uav_recon.types.frames import AnyArray, Float32Array, IntArray
from uav_recon.types.maps import GridSpec


class FrameScratch:
    """Scratch memory reused by every frame; its size depends on the view, not on the map."""

    def __init__(self, grid: GridSpec, far_m: float) -> None:
        across = 2 * int(np.ceil(far_m / grid.resolution_m)) + 3  # edge in voxels of a box around the range sphere
        box = int(np.prod(np.minimum(grid.shape, across)))
        self._counts = np.zeros(box + 1, dtype=np.int32)
        self.listed = np.zeros(box, dtype=np.int64)
        self.found = np.zeros(box, dtype=np.uint8)
        self._pixels = (0, 0)

    def fit(self, pixels: tuple[int, ...]) -> FrameScratch:
        """Allocate the arrays for images of (H, W) pixels; returns self."""
        if pixels != self._pixels:
            height, width = pixels
            self._pixels = (height, width)
            rows, columns = -(-height // CELL), -(-width // CELL)
            self.pooled = PooledDepth(
                lowest_m=np.zeros((LEVELS, rows, columns), dtype=np.float32),
                farthest_m=np.zeros(-(-columns // STRIP), dtype=np.float32),
                valid=np.zeros((rows + 1, columns + 1), dtype=np.int32),
            )
            self.hits = HitCounts(counts=self._counts, touched=np.zeros(height * width + 1, dtype=np.int32))
        return self

    def list(self, flat: IntArray) -> None:
        """Set the list of voxels to ``flat``, replacing its content."""
        if flat.size > self.listed.size:
            self.listed = np.zeros(flat.size, dtype=np.int64)
            self.found = np.zeros(flat.size, dtype=np.uint8)
        self.listed[: flat.size] = flat


@kernel
def fuse(
    depth_m: Float32Array, camera: GridCamera, shape: tuple[int, int, int], pooled: PooledDepth, hits: HitCounts,
    odds: AnyArray, listed: IntArray,
) -> int:  # fmt: skip
    """Integrate a frame into the log-odds; returns the number of voxels listed.

    The listed voxels are those whose state may have changed. depth_m: (H, W). pooled, hits, listed: see FrameScratch.
    """
    box = np.empty((2, 3), dtype=np.int64)
    pixels = depth_m.shape
    view_box(camera, pixels, shape, box)
    min_pool(depth_m, camera.near_m, pooled)
    doubtful = weak_observation_steps(camera.noise_per_m, camera.far_m, camera.resolution_m)
    number = count_hits(depth_m, camera, box, hits)
    listing = carve_free(pooled, camera, pixels, doubtful, box, shape, hits.counts, odds, listed)
    return mark_occupied(hits, number, camera, box, shape, odds, listed, listing)
