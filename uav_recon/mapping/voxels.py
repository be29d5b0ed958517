"""What is known free, occupied or unknown: log-odds voxels from posed depth frames.

Voxel-centric. Each voxel in view is projected, and the frame frees it only if EVERY depth under its footprint lies
behind it by more than its own half extent and the depth noise. So a grazing ray cannot carve a wall, and a hole (NaN)
frees nothing. Returns mark the voxel they end in, and in that frame the mark wins over freeing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_recon.mapping.distance import distance2_to_not_free
from uav_recon.mapping.distance import warm_up as warm_up_distance
from uav_recon.mapping.evidence import CELL, FREE_AT, LEVELS, LOWEST, OCCUPIED_AT, count_hits, free, occupy, pool, states
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.maps import LARGEST_DISTANCE_VOXELS, GridSpec, VoxelMap
from uav_recon.types.pose import Pose


@dataclass(frozen=True, slots=True)
class DepthSensor:
    """What the voxels believe of the camera: sigma_z = z² * noise_px / (f * baseline); nearer returns are not believed."""

    depth_min_m: float
    noise_px: float
    baseline_m: float


class Voxels:
    """The occupancy map of one flight, one map epoch at a time. Not thread-safe: one owner; snapshots are frozen."""

    def __init__(
        self,
        grid: GridSpec,
        sensor: DepthSensor,
        max_range_m: float,
        fence_min_m: Sequence[float],
        fence_max_m: Sequence[float],
        distance_cap_m: float,
        map_epoch: int = 0,
    ) -> None:
        """Start unknown. A voxel whose centre is outside the fence box (world, metres) may be occupied, never free."""
        self.grid = grid
        self._sensor, self._max_range_m = sensor, max_range_m
        self._reach = min(int(np.ceil(distance_cap_m / grid.resolution_m)), LARGEST_DISTANCE_VOXELS)
        bounds = (np.array([fence_min_m, fence_max_m]) - grid.origin_world_m) / grid.resolution_m
        self._fence = np.clip(np.ceil(bounds - 0.5 - 1e-9), 0, np.array(grid.shape)).astype(np.int64)
        size = int(np.prod(grid.shape))
        self._hits = np.zeros(size, dtype=np.int32)
        self._depth_sum_m = np.zeros(size, dtype=np.float64)
        self._touched = np.zeros(size, dtype=np.int64)
        self._lowest_m = np.zeros((LEVELS, 0, 0), dtype=np.float32)
        self._valid = np.zeros((1, 1), dtype=np.int32)
        self._revision = 0
        self.reset(map_epoch)

    def reset(self, map_epoch: int) -> None:
        """Forget everything: poses of a new epoch do not fit the old map."""
        self._odds = np.zeros(self.grid.shape, dtype=np.int8)
        self._map_epoch = map_epoch
        self._picture: VoxelMap | None = None
        self._revision += 1

    @property
    def revision(self) -> int:
        """Grows whenever a snapshot would differ."""
        return self._revision

    def integrate(self, posed: PosedFrame) -> int:
        """Add a frame; returns how many voxels changed between unknown, free and occupied.

        About 1-2 ms for 424 x 240. NaN and infinite depth say nothing; depth beyond the range frees up to it and marks
        nothing. Raises ValueError for a frame of another map epoch (call reset first).
        """
        if posed.map_epoch != self._map_epoch:
            raise ValueError(f"frame of map epoch {posed.map_epoch} given to voxels of epoch {self._map_epoch}")
        frame, pose, resolution_m = posed.frame, posed.world_from_depth, self.grid.resolution_m
        lens = frame.depth_intrinsics
        cells = tuple(-(-n // CELL) for n in frame.depth_m.shape)
        if self._lowest_m.shape[1:] != cells:
            self._lowest_m = np.zeros((LEVELS, *cells), dtype=np.float32)
            self._valid = np.zeros((cells[0] + 1, cells[1] + 1), dtype=np.int32)
        camera = np.array([lens.fx, lens.fy, lens.cx, lens.cy])
        rotation = np.ascontiguousarray(pose.rotation())
        origin = (pose.translation_m - self.grid.origin_world_m) / resolution_m
        noise_per_m = self._sensor.noise_px / (lens.fx * self._sensor.baseline_m)
        odds = self._odds.reshape(-1)
        pool(frame.depth_m, self._sensor.depth_min_m, self._lowest_m, self._valid)
        number = count_hits(
            frame.depth_m, camera, rotation, origin, self._sensor.depth_min_m, self._max_range_m, resolution_m,
            self.grid.shape, self._hits, self._depth_sum_m, self._touched,
        )  # fmt: skip
        changed = free(
            self._lowest_m, self._valid, camera, rotation, origin, self._bounds(lens, rotation, origin),
            self._max_range_m, noise_per_m, resolution_m, self.grid.shape, self._hits, odds,
        )  # fmt: skip
        changed += occupy(self._touched, number, lens.fx, noise_per_m, resolution_m, self._hits, self._depth_sum_m, odds)
        self._changed(changed)
        return changed

    def declare_free(self, centre_world: FloatArray, radius_m: float, z_min_m: float, z_max_m: float) -> None:
        """The operator's word: the voxels with centres in this upright cylinder are free, until returns say otherwise.

        centre_world: (2,) or (3,) metres, of which x and y count.
        """
        low = self.grid.index(np.array([centre_world[0] - radius_m, centre_world[1] - radius_m, z_min_m]))
        high = self.grid.index(np.array([centre_world[0] + radius_m, centre_world[1] + radius_m, z_max_m])) + 1
        low, high = np.maximum(low, 0), np.minimum(high, np.array(self.grid.shape))
        if np.any(high <= low):
            return
        centres = self.grid.centre(np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1))
        across = np.hypot(centres[..., 0] - centre_world[0], centres[..., 1] - centre_world[1]) <= radius_m
        inside = across & (centres[..., 2] >= z_min_m) & (centres[..., 2] <= z_max_m)
        block = self._odds[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        touched = int(np.count_nonzero(inside & (block > FREE_AT)))
        block[inside] = LOWEST
        self._changed(touched)

    def mark_visited(self, position_world: FloatArray, radius_m: float, height_m: float) -> None:
        """The body's hull (upright cylinder around its position) is there, so nothing else is."""
        z_m = float(position_world[2])
        self.declare_free(position_world, radius_m, z_m - height_m / 2, z_m + height_m / 2)

    def snapshot(self) -> VoxelMap:
        """A frozen picture with its distance field: about 1.5 ms for 120,000 voxels, nothing if nothing changed."""
        if self._picture is None:
            state = np.empty(self.grid.shape, dtype=np.uint8)
            states(self._odds, self._fence, state)
            distance2 = distance2_to_not_free(state, self._reach)
            state.setflags(write=False)
            distance2.setflags(write=False)
            self._picture = VoxelMap.whole(self.grid, state, distance2, self._revision, self._map_epoch)
        return self._picture

    def explored_m3(self) -> float:
        """Volume inside the fence that is known, free or occupied."""
        low, high = self._fence
        odds = self._odds[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        return int(np.count_nonzero((odds <= FREE_AT) | (odds >= OCCUPIED_AT))) * self.grid.resolution_m**3

    def warm_up(self) -> None:
        """Compile every kernel on a map of its own."""
        lens = Intrinsics.from_fov(16, 8, 1.5, 1.0)
        small = Voxels(GridSpec(np.zeros(3), 0.5, (4, 4, 4)), self._sensor, 2.0, (0, 0, 0), (2, 2, 2), 1.0)
        depth_m = np.full((8, 16), 1.0, dtype=np.float32)
        frame = Frame(0.0, 0, depth_m, lens, np.zeros((8, 16, 3), dtype=np.uint8), lens, Pose.identity())
        small.integrate(PosedFrame(frame, Pose.from_yaw(0.0, np.array([1.0, 1.0, 0.2]))))
        small.snapshot()
        warm_up_distance()

    def _bounds(self, lens: Intrinsics, rotation: FloatArray, origin: FloatArray) -> AnyArray:
        """Voxel box (2, 3) around the view, clipped to the grid; origin is the camera in voxels."""
        u, v = np.array([-0.5, lens.width - 0.5]), np.array([-0.5, lens.height - 0.5])
        corners = np.array([[(a - lens.cx) / lens.fx, (b - lens.cy) / lens.fy, 1.0] for a in u for b in v])
        reach = self._max_range_m / self.grid.resolution_m
        points = np.vstack([np.zeros((1, 3)), corners @ rotation.T * reach]) + origin
        low = np.maximum(np.maximum(points.min(axis=0), origin - reach), 0)
        high = np.minimum(np.minimum(points.max(axis=0), origin + reach) + 1, np.array(self.grid.shape))
        return np.stack([np.floor(low), np.maximum(np.floor(high), 0)]).astype(np.int64)

    def _changed(self, voxels: int) -> None:
        if voxels:
            self._revision += 1
            self._picture = None
