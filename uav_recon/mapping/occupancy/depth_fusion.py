"""Integration of one depth frame into the log-odds: pooling, hit counts, carving, marking."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.occupancy.depth_min_pooling import CELL, LEVELS, STRIP, min_pool
from uav_recon.mapping.occupancy.free_space_carving import carve_free, view_box
from uav_recon.mapping.occupancy.hit_integration import count_hits, mark_occupied
from uav_recon.mapping.occupancy.log_odds import weak_observation_steps
from uav_recon.types.frames import AnyArray, IntArray
from uav_recon.types.maps import GridSpec


class FrameScratch:
    """Scratch memory reused by every frame; its size depends on the view, not on the map."""

    def __init__(self, grid: GridSpec, far_m: float) -> None:
        across = 2 * int(np.ceil(far_m / grid.resolution_m)) + 3  # edge in voxels of a box around the range sphere
        box = int(np.prod(np.minimum(grid.shape, across)))
        self.hits = np.zeros(box + 1, dtype=np.int32)
        self.listed = np.zeros(box, dtype=np.int64)
        self.found = np.zeros(box, dtype=np.uint8)
        self._pixels = (0, 0)

    def fit(self, pixels: tuple[int, ...]) -> FrameScratch:
        """Allocate the arrays for images of (H, W) pixels; returns self."""
        if pixels != self._pixels:
            height, width = pixels
            self._pixels = (height, width)
            rows, columns = -(-height // CELL), -(-width // CELL)
            self.lowest_m = np.zeros((LEVELS, rows, columns), dtype=np.float32)
            self.farthest_m = np.zeros(-(-columns // STRIP), dtype=np.float32)
            self.valid = np.zeros((rows + 1, columns + 1), dtype=np.int32)
            self.touched = np.zeros(height * width + 1, dtype=np.int32)
        return self

    def list(self, flat: IntArray) -> None:
        """Set the list of voxels to ``flat``, replacing its content."""
        if flat.size > self.listed.size:
            self.listed = np.zeros(flat.size, dtype=np.int64)
            self.found = np.zeros(flat.size, dtype=np.uint8)
        self.listed[: flat.size] = flat


@kernel
def fuse(
    depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, origin: AnyArray, near_m: float, far_m: float, noise_per_m: float,
    resolution_m: float, shape: tuple[int, int, int], lowest_m: AnyArray, farthest_m: AnyArray, valid: AnyArray,
    hits: AnyArray, touched: AnyArray, odds: AnyArray, listed: AnyArray,
) -> int:  # fmt: skip
    """Integrate a frame into the log-odds; returns the number of voxels listed.

    The listed voxels are those whose state may have changed. depth_m (H, W) float32; camera: fx, fy, cx, cy; rotation (3, 3)
    and origin (3,), in voxels, of the camera in the grid. The depth noise (one sigma) is noise_per_m * depth². The other
    arrays: see FrameScratch.
    """
    box = np.empty((2, 3), dtype=np.int64)
    pixels = depth_m.shape
    view_box(camera, rotation, origin, far_m / resolution_m, pixels, shape, box)
    min_pool(depth_m, near_m, lowest_m, farthest_m, valid)
    doubtful = weak_observation_steps(noise_per_m, far_m, resolution_m)
    number = count_hits(depth_m, camera, rotation, origin, near_m, far_m, resolution_m, box, hits, touched)
    listing = carve_free(
        lowest_m, farthest_m, valid, camera, rotation, origin, pixels, far_m, noise_per_m, doubtful, resolution_m, box, shape,
        hits, odds, listed,
    )  # fmt: skip
    return mark_occupied(
        touched, number, camera, rotation, origin, noise_per_m, resolution_m, box, shape, hits, odds, listed, listing
    )
