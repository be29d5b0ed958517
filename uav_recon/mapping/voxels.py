"""What is known free, occupied or unknown: log-odds voxels from posed depth frames.

Voxel-centric. Each voxel in view is projected, and the frame frees it only if EVERY depth under its footprint lies
behind it by more than its own half extent and the depth noise. So a grazing ray cannot carve a wall, and a hole (NaN)
frees nothing. Returns mark the voxel they end in, and in that frame the mark wins over freeing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.distance import distance_to_not_free
from uav_recon.mapping.distance import warm_up as warm_up_distance
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, GridSpec, VoxelMap
from uav_recon.types.pose import Pose

# Evidence in steps of log-odds. One frame never frees a voxel: two clear looks or four doubtful ones do. A solid hit
# at close range occupies at once, a thin or distant one after two frames. The clamps bound how long a change takes.
FREE_AT, OCCUPIED_AT = -4, 2
LOWEST, HIGHEST = -10, 12
LEVELS = 6  # sliding minima over 1, 2, 4 ... 32 cells
CELL = 2  # pixels per cell of the pooled depth
NOISE_SIGMAS = 2.5  # a surface is believed to lie no nearer than its depth less so many sigmas
VALID_SHARE = 0.75  # of the footprint must have a return before a voxel is freed
SOLID_SHARE = 0.15  # of the pixels that a facing voxel would catch make a hit solid; fewer are a speckle or a wire


@kernel
def _pool(depth_m: AnyArray, near_m: float, lowest_m: AnyArray, valid: AnyArray) -> None:
    """Sliding minima lowest_m (LEVELS, h, w) float32 and the integral image valid (h + 1, w + 1) of pixels with a return."""
    height, width = depth_m.shape
    _, rows, columns = lowest_m.shape
    infinite = np.float32(np.inf)
    for i in range(rows):
        running = 0
        for j in range(columns):
            nearest = infinite
            for v in range(CELL * i, min(CELL * i + CELL, height)):
                for u in range(CELL * j, min(CELL * j + CELL, width)):
                    depth = depth_m[v, u]
                    if depth >= near_m and depth < infinite:
                        running += 1
                        nearest = min(nearest, depth)
            lowest_m[0, i, j] = nearest
            valid[i + 1, j + 1] = valid[i, j + 1] + running
    for level in range(1, LEVELS):
        half = 1 << (level - 1)
        for i in range(rows):
            upper = lowest_m[level - 1, i]
            lower = lowest_m[level - 1, min(i + half, rows - 1)]
            target = lowest_m[level, i]
            for j in range(columns - half):
                target[j] = min(min(upper[j], lower[j]), min(upper[j + half], lower[j + half]))
            for j in range(max(columns - half, 0), columns):
                target[j] = min(upper[j], lower[j])


@kernel
def _count_hits(
    depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, origin: AnyArray, near_m: float, far_m: float,
    resolution_m: float, shape: tuple[int, int, int], hits: AnyArray, depth_sum_m: AnyArray, touched: AnyArray,
) -> int:  # fmt: skip
    """Count the returns that end in each voxel; ``touched`` lists the flat indices, the number of them is returned."""
    fx, fy, cx, cy = camera
    nx, ny, nz = shape
    scale = 1.0 / resolution_m
    number = 0
    for v in range(depth_m.shape[0]):
        y = (v - cy) / fy
        ax = (rotation[0, 1] * y + rotation[0, 2]) * scale
        ay = (rotation[1, 1] * y + rotation[1, 2]) * scale
        az = (rotation[2, 1] * y + rotation[2, 2]) * scale
        for u in range(depth_m.shape[1]):
            depth = depth_m[v, u]
            if not (depth >= near_m and depth <= far_m):
                continue
            x = (u - cx) / fx
            if depth * depth * (x * x + y * y + 1.0) > far_m * far_m:
                continue
            i = int(np.floor(origin[0] + depth * (rotation[0, 0] * scale * x + ax)))
            j = int(np.floor(origin[1] + depth * (rotation[1, 0] * scale * x + ay)))
            k = int(np.floor(origin[2] + depth * (rotation[2, 0] * scale * x + az)))
            if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
                index = (i * ny + j) * nz + k
                if hits[index] == 0:
                    touched[number] = index
                    number += 1
                    depth_sum_m[index] = 0.0
                hits[index] += 1
                depth_sum_m[index] += depth
    return number


@kernel
def _add(odds: AnyArray, index: int, evidence: int) -> int:
    """Add evidence to a voxel; returns whether that changed its state (before the fence is applied)."""
    before = int(odds[index])
    after = min(max(before + evidence, LOWEST), HIGHEST)
    odds[index] = np.int8(after)
    return int((before <= FREE_AT) != (after <= FREE_AT) or (before >= OCCUPIED_AT) != (after >= OCCUPIED_AT))


@kernel
def _free(
    lowest_m: AnyArray, valid: AnyArray, camera: AnyArray, rotation: AnyArray, origin: AnyArray, bounds: AnyArray,
    far_m: float, noise_per_m: float, resolution_m: float, shape: tuple[int, int, int], hits: AnyArray, odds: AnyArray,
) -> int:  # fmt: skip
    """Free the voxels in front of everything seen under their footprint. Returns how many changed state.

    The noise is in disparity: a depth d may truly be 1 / (1 / d + sigmas * noise_per_m), noise_per_m = noise / (f * b).
    """
    fx, fy, cx, cy = camera
    _, rows, columns = lowest_m.shape
    _, ny, nz = shape
    extent_m = 0.5 * resolution_m * (abs(rotation[0, 2]) + abs(rotation[1, 2]) + abs(rotation[2, 2]))
    changed = 0
    for i in range(bounds[0, 0], bounds[1, 0]):
        dx = (i + 0.5 - origin[0]) * resolution_m
        for j in range(bounds[0, 1], bounds[1, 1]):
            dy = (j + 0.5 - origin[1]) * resolution_m
            for k in range(bounds[0, 2], bounds[1, 2]):
                dz = (k + 0.5 - origin[2]) * resolution_m
                z = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
                if z < resolution_m or dx * dx + dy * dy + dz * dz > far_m * far_m:
                    continue
                inverse = 1.0 / (CELL * z)
                u = (rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz) * fx * inverse + (cx + 0.5) / CELL
                v = (rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz) * fy * inverse + (cy + 0.5) / CELL
                if not (u >= 0.0 and v >= 0.0 and u < columns and v < rows):
                    continue
                index = (i * ny + j) * nz + k
                if hits[index] != 0:
                    continue
                ru, rv = 0.5 * resolution_m * fx * inverse, 0.5 * resolution_m * fy * inverse
                u0, u1 = max(int(u - ru), 0), min(int(u + ru), columns - 1) + 1
                v0, v1 = max(int(v - rv), 0), min(int(v + rv), rows - 1) + 1
                level, size = 0, 1
                while level < LEVELS - 1 and 2 * size <= u1 - u0 and 2 * size <= v1 - v0:
                    level += 1
                    size *= 2
                nearest = lowest_m[level, v1 - size, u1 - size]
                row = v0
                while row < v1:
                    top = min(row, v1 - size)
                    column = u0
                    while column < u1:
                        nearest = min(nearest, lowest_m[level, top, min(column, u1 - size)])
                        column += size
                    row += size
                if not nearest < np.inf:
                    continue
                gap_m = nearest - z
                margin_m = max(extent_m, nearest - nearest / (1.0 + NOISE_SIGMAS * noise_per_m * nearest))
                if not gap_m > margin_m:
                    continue
                seen = valid[v1, u1] - valid[v0, u1] - valid[v1, u0] + valid[v0, u0]
                if seen < VALID_SHARE * (u1 - u0) * (v1 - v0) * CELL * CELL:
                    continue
                changed += _add(odds, index, -2 if gap_m > 2.0 * margin_m else -1)
    return changed


@kernel
def _occupy(
    touched: AnyArray, number: int, focal: float, noise_per_m: float, resolution_m: float, hits: AnyArray,
    depth_sum_m: AnyArray, odds: AnyArray,
) -> int:  # fmt: skip
    """Mark the voxels with returns, the surer the more, and clear the counts. Returns how many changed state."""
    changed = 0
    for n in range(number):
        index = touched[n]
        depth = depth_sum_m[index] / hits[index]
        facing = focal * resolution_m / depth
        sigma_m = noise_per_m * depth * depth
        weight = 1
        if hits[index] >= SOLID_SHARE * facing * facing:
            weight = 4 if sigma_m <= 0.25 * resolution_m else 2 if sigma_m <= 0.5 * resolution_m else 1
        changed += _add(odds, index, weight)
        hits[index] = 0
    return changed


@kernel
def _states(odds: AnyArray, fence: AnyArray, state: AnyArray) -> None:
    """Log-odds (nx, ny, nz) to states; outside the fence [fence[0], fence[1]) nothing is free."""
    nx, ny, nz = odds.shape
    for i in range(nx):
        for j in range(ny):
            inside = fence[0, 0] <= i < fence[1, 0] and fence[0, 1] <= j < fence[1, 1]
            for k in range(nz):
                value = odds[i, j, k]
                found = np.uint8(OCCUPIED) if value >= OCCUPIED_AT else np.uint8(UNKNOWN)
                if value <= FREE_AT and inside and fence[0, 2] <= k < fence[1, 2]:
                    found = np.uint8(FREE)
                state[i, j, k] = found


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
        self._sensor, self._max_range_m, self._cap_m = sensor, max_range_m, distance_cap_m
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
        _pool(frame.depth_m, self._sensor.depth_min_m, self._lowest_m, self._valid)
        number = _count_hits(
            frame.depth_m, camera, rotation, origin, self._sensor.depth_min_m, self._max_range_m, resolution_m,
            self.grid.shape, self._hits, self._depth_sum_m, self._touched,
        )  # fmt: skip
        changed = _free(
            self._lowest_m, self._valid, camera, rotation, origin, self._bounds(lens, rotation, origin),
            self._max_range_m, noise_per_m, resolution_m, self.grid.shape, self._hits, odds,
        )  # fmt: skip
        changed += _occupy(self._touched, number, lens.fx, noise_per_m, resolution_m, self._hits, self._depth_sum_m, odds)
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
            _states(self._odds, self._fence, state)
            distance_m = distance_to_not_free(state, self.grid.resolution_m, self._cap_m)
            state.setflags(write=False)
            distance_m.setflags(write=False)
            self._picture = VoxelMap(self.grid, state, distance_m, self._revision, self._map_epoch)
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
