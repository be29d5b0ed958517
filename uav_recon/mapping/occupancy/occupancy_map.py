"""Occupancy map: log-odds voxels from posed depth frames, with their distance field.

Voxel-centric: each voxel in view is projected into the frame. The frame frees a voxel only if EVERY depth in its footprint
lies behind it by more than half its extent and the depth noise. So a grazing ray cannot carve a wall, and a hole (NaN) frees
nothing. A return marks the voxel it ends in; within one frame, marking takes precedence over freeing. If the marked voxel
was free, an obstacle has appeared, and the free space behind it becomes unknown. It is provisional for a while, see
provisional_voxels: what walks through the room does not stay in the map.

All updates are incremental: the states and the number of known voxels are stored, the distance field is updated around the
changes when a snapshot is requested, and a snapshot reuses the memory of an old one that is no longer referenced.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_recon.mapping.occupancy.cone_clearing import clear_cone
from uav_recon.mapping.occupancy.depth_fusion import FrameScratch, fuse
from uav_recon.mapping.occupancy.distance_field import DistanceField
from uav_recon.mapping.occupancy.grid_camera import GridCamera
from uav_recon.mapping.occupancy.log_odds import FREE_AT, MIN_LOG_ODDS, copy_changed, new_states
from uav_recon.mapping.occupancy.occlusion_reset import reset_behind_new_obstacles
from uav_recon.mapping.occupancy.provisional_voxels import ProvisionalVoxels
from uav_recon.mapping.occupancy.snapshot_pool import SnapshotPool
from uav_recon.mapping.occupancy.thin_gaps import close_thin_gaps
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.maps import EUCLIDEAN, LARGEST_DISTANCE_VOXELS, TILE, GridSpec, HeightMeasure, VoxelMap
from uav_recon.types.pose import Pose

_OCCLUSION_RESET_DEPTH_M = 0.6  # depth reset behind a new obstacle: that of a person or a chair
_MOVING_VOXELS = 12  #: plan: a frame with returns in this many provisional voxels shows something that moves


@dataclass(frozen=True, slots=True)
class DepthSensor:
    """Noise model of the depth camera: sigma_z = z² * noise_px / (f * baseline).

    Returns nearer than depth_min_m are ignored.
    """

    depth_min_m: float
    noise_px: float
    baseline_m: float


class OccupancyMap:
    """The occupancy map of one flight, one map epoch at a time.

    Not thread-safe: it has one owner. Snapshots are immutable.
    """

    def __init__(
        self,
        grid: GridSpec,
        sensor: DepthSensor,
        max_range_m: float,
        fence_min_m: Sequence[float],
        fence_max_m: Sequence[float],
        distance_cap_m: float,
        map_epoch: int = 0,
        pixel_stride: int = 1,
        heights: HeightMeasure = EUCLIDEAN,
    ) -> None:
        """Start with all voxels unknown.

        A voxel whose centre is outside the fence box (world, metres) may be occupied, never free. pixel_stride: use only
        every pixel_stride-th row and column of the depth. heights: of the distances, see VoxelMap.
        """
        self.grid = grid
        self._sensor = sensor
        self._max_range_m = float(max_range_m)
        self._pixel_stride = pixel_stride
        self._heights = heights
        self._reach = min(int(np.ceil(distance_cap_m / grid.resolution_m)), LARGEST_DISTANCE_VOXELS)
        bounds = (np.array([fence_min_m, fence_max_m]) - grid.origin_world_m) / grid.resolution_m
        self._fence = np.clip(np.ceil(bounds - 0.5 - 1e-9), 0, np.array(grid.shape)).astype(np.int64)
        self._scratch = FrameScratch(grid, max_range_m)
        self._provisional = ProvisionalVoxels(grid.shape)
        self._revision = 0
        self.reset(map_epoch)

    def reset(self, map_epoch: int) -> None:
        """Clear the map for a new epoch, whose poses do not fit the old map."""
        self._revision += 1
        self._map_epoch = map_epoch
        self._known = 0
        self._provisional.clear()
        self._odds = np.zeros(int(np.prod(self.grid.shape)), dtype=np.int8)
        self._tile_revision = np.full([-(-n // TILE) for n in self.grid.shape[:2]], self._revision, dtype=np.int64)
        self._distance = DistanceField(self.grid.shape, self._reach, self._heights)
        self._snapshots = SnapshotPool(self.grid, self._revision, self._heights)
        self._snapshot: VoxelMap | None = None

    @property
    def revision(self) -> int:
        """Counter that grows whenever a snapshot would differ."""
        return self._revision

    def integrate(self, posed: PosedFrame) -> int:
        """Integrate a frame; returns the number of voxels that changed state.

        About 0.4 ms for 320 x 240. NaN and infinite depth are ignored. Depth beyond the range frees voxels up to the range
        and marks nothing. Raises ValueError for a frame of another map epoch (call reset first).
        """
        if posed.map_epoch != self._map_epoch:
            raise ValueError(f"frame of map epoch {posed.map_epoch} given to voxels of epoch {self._map_epoch}")
        depth_m, lens, stride = posed.frame.depth_m, posed.frame.depth_intrinsics, self._pixel_stride
        if stride > 1:
            depth_m = np.ascontiguousarray(depth_m[::stride, ::stride])
            depth_m.setflags(write=False)
        pinhole_px = lens.pinhole_px() / stride
        noise_per_m = self._sensor.noise_px / (pinhole_px[0] * self._sensor.baseline_m)
        pose, resolution_m = posed.world_from_depth, self.grid.resolution_m
        scratch, origin = self._scratch.fit(depth_m.shape), (pose.translation_m - self.grid.origin_world_m) / resolution_m
        camera = GridCamera(
            pinhole_px=pinhole_px, rotation=pose.rotation(), origin=origin, near_m=float(self._sensor.depth_min_m),
            far_m=self._max_range_m, noise_per_m=noise_per_m, resolution_m=resolution_m,
        )  # fmt: skip
        number = fuse(depth_m, camera, self.grid.shape, scratch.pooled, scratch.hits, self._odds, scratch.listed)
        known = self._snapshots.current.state
        behind = reset_behind_new_obstacles(
            scratch.listed, number, self._odds, known, self.grid.shape, origin, _OCCLUSION_RESET_DEPTH_M / resolution_m
        )
        return self._apply_state_changes(
            self._provisional.update(scratch.listed, number, behind, known, self._odds, posed.frame.stamp_s)
        )

    @property
    def shows_motion(self) -> bool:
        """True if the newest frame shows something where free space was known a moment ago."""
        return self._provisional.shown >= _MOVING_VOXELS

    def give_up_provisional(self, stamp_s: float) -> int:
        """Give up the provisional voxels without a return for a while, without a frame.

        Returns the number of voxels that changed state.
        """
        if not self._provisional.any:
            return 0
        state = self._snapshots.current.state
        return self._apply_state_changes(self._provisional.update(self._scratch.listed, 0, 0, state, self._odds, stamp_s))

    def integrate_cone(self, cone: FreeCone) -> int:
        """Integrate what a range finder found empty; returns the number of voxels that became free.

        Occupied voxels stay as they are. Raises ValueError for a cone of another map epoch.
        """
        if cone.map_epoch != self._map_epoch:
            raise ValueError(f"cone of map epoch {cone.map_epoch} given to voxels of epoch {self._map_epoch}")
        return self._list_changes(clear_cone(cone, self.grid, self._odds))

    def close_thin_gaps(self) -> int:
        """Free what is unknown between free voxels and one voxel thick.

        Returns the number of voxels that became free.
        """
        state = self._snapshots.current.state
        number = close_thin_gaps(state, self.grid.shape, self._odds, self._scratch.listed)
        return self._apply_state_changes(number)

    def declare_free(self, centre_world: FloatArray, radius_m: float, z_min_m: float, z_max_m: float) -> None:
        """Set the voxels in an upright cylinder free, as declared by the operator.

        Applies to voxels with their centre in the cylinder; later returns can mark them again. centre_world: (2,) or (3,)
        metres; only x and y are used.
        """
        low = self.grid.index(np.array([centre_world[0] - radius_m, centre_world[1] - radius_m, z_min_m]))
        high = self.grid.index(np.array([centre_world[0] + radius_m, centre_world[1] + radius_m, z_max_m])) + 1
        low, high = np.maximum(low, 0), np.minimum(high, np.array(self.grid.shape))
        if np.any(high <= low):
            return
        index = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1).reshape(-1, 3)
        centres = self.grid.centre(index)
        inside = np.hypot(centres[:, 0] - centre_world[0], centres[:, 1] - centre_world[1]) <= radius_m
        inside &= (centres[:, 2] >= z_min_m) & (centres[:, 2] <= z_max_m)
        flat = np.ravel_multi_index(tuple(index[inside].T), self.grid.shape)
        changing = flat[self._odds[flat] > FREE_AT]
        self._odds[flat] = MIN_LOG_ODDS
        self._list_changes(changing)

    def snapshot(self) -> VoxelMap:
        """Return an immutable snapshot with its distance field.

        About 0.1 ms after a frame. Returns the same object if nothing changed.
        """
        if self._snapshot is None:
            canvas, revision = self._snapshots.current, self._revision
            self._distance.update(canvas.state, canvas.distance2, self._tile_revision, revision)
            self._snapshot = self._snapshots.show(self._tile_revision, revision, self._map_epoch)
        return self._snapshot

    def explored_m3(self) -> float:
        """Return the volume inside the fence that is known (free or occupied), in cubic metres."""
        return self._known * self.grid.resolution_m**3

    def warm_up(self) -> None:
        """Compile every kernel on a small separate map."""
        lens = Intrinsics.from_fov(16, 8, 1.5, 1.0)
        small = OccupancyMap(
            GridSpec(np.zeros(3), 0.5, (4, 4, 4)), self._sensor, 2.0, (0, 0, 0), (2, 2, 2), 1.0, pixel_stride=1
        )
        depth_m = np.full((8, 16), 1.0, dtype=np.float32)
        frame = Frame(0.0, 0, depth_m, lens, np.zeros((8, 16, 3), dtype=np.uint8), lens, Pose.identity())
        held = []
        for _ in range(3):  # the second snapshot uses another buffer than the first
            small.integrate(PosedFrame(frame, Pose.from_yaw(0.0, np.array([1.0, 1.0, 0.2]))))
            small.close_thin_gaps()
            held.append(small.snapshot())
            small.declare_free(np.ones(3), 0.5 * len(held), 0.0, 2.0)

    def _list_changes(self, flat: IntArray) -> int:
        """Update the voxels (N,) of these flat indices; returns the number whose state changed."""
        self._scratch.list(flat)
        return self._apply_state_changes(flat.size)

    def _apply_state_changes(self, number: int) -> int:
        """Update the listed voxels whose state changed; returns their number."""
        shape, scratch = self.grid.shape, self._scratch
        number = new_states(
            scratch.listed, number, self._odds, shape, self._fence, self._snapshots.current.state, scratch.found
        )  # fmt: skip
        if number:
            self._revision += 1
            self._snapshot = None
            canvas = self._snapshots.writable_buffer(self._tile_revision)
            self._known += copy_changed(
                scratch.listed, scratch.found, number, shape, self._fence, self._revision, canvas.state,
                self._tile_revision, self._distance.first, self._distance.last,
            )  # fmt: skip
        return number
