"""Positions where the body may be, updated only where the map changed."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.planning.free_space.escape_path import EscapePath
from uav_recon.planning.free_space.reachability import ReachableSpace
from uav_recon.planning.free_space.subvoxel_clearance import make_clearance_box
from uav_recon.planning.free_space.voxel_blocks import EDGE
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import EUCLIDEAN, FREE, TILE, GridSpec, HeightMeasure, VoxelMap

NEVER = 256  # larger than any squared distance stored in a byte
MAX_OPEN_SAMPLES = 12
CONFINED_M = 1.5  # along each axis from the vehicle: if there are fewer reachable positions than ...
CONFINED_M3 = 1.5  # ... this, it is confined


def needed_distance2(clearance_m: float, resolution_m: float) -> int:
    """Return the least squared distance in voxels for a clearance to the sides of voxels."""
    return int(min(math.ceil((clearance_m / resolution_m + 0.5 - 1e-3) ** 2), NEVER))


def height_measure(clearance_m: float, half_height_m: float, above_m: float, resolution_m: float) -> HeightMeasure:
    """Return the measure of heights that gives a body less clearance above and below.

    clearance_m: from the body's centre. half_height_m: of the body. above_m: clearance above and below it.
    """
    half = half_height_m / resolution_m
    above = math.ceil((half_height_m + above_m) / resolution_m + 0.5 - 1e-3)
    return HeightMeasure(half, max(math.sqrt(needed_distance2(clearance_m, resolution_m)) / (above - half), 1.0))


class MapArrays(NamedTuple):
    """The arrays of a VoxelMap that the space depends on.

    state, distance2: (nx, ny, nz). tiles: (N, 2) the tiles to read.
    """

    state: ByteArray
    distance2: ByteArray
    tiles: IntArray


class ClearanceRule(NamedTuple):
    """The condition for a voxel to be flyable.

    box: (2, 3) first and one-past-last voxel. needed2: least squared distance, voxels.
    open_samples2: (MAX_OPEN_SAMPLES - 1,) squared distances from which one more sample of a line is known to be open.
    """

    box: IntArray
    needed2: int
    open_samples2: IntArray


class SpaceArrays(NamedTuple):
    """Arrays of a FlyableSpace that an update writes; see there.

    blocks_shape: (3,) of the blocks of ``reachable_space``. changed: (blocks,) output, the changed blocks, each once.
    opened: shape of the mask, 1 = flyable without the clearance, where it is known free.
    """

    mask: ByteArray
    opened: ByteArray
    known_free: ByteArray
    open_samples: ByteArray
    mask_revision: IntArray
    block_revision: IntArray
    blocks_shape: IntArray
    changed: IntArray


class FlyableSpace:
    """Voxels in which the body's centre may be; one object per flight.

    The arrays are updated in place. Positions in kernels are in PADDED voxel units: (p - origin) / resolution + 1.

    mask: (nx+2, ny+2, nz+2) uint8, 1 = flyable: known free, far enough from all voxels that are not known free, and with
        indices in [low, high). The border of zeros removes the bounds checks from searches.
    known_free: the same shape, 1 = known free.
    reachable: the same shape, 1 = flyable and 26-connected to the vehicle's last position given to locate_vehicle().
    open_samples: the same shape, for lines through the mask, see ``segment_is_open``. 0 where the mask is 0, else 1 + the
        number of following samples that the distance field shows to be open for every direction of the line. Lines begin
        and end in the mask, so they never leave the box.
    clearance_box: (9,) clearance box for positions off a voxel centre, see ``make_clearance_box``.
    revision: increases with each change of mask or reachable.
    mask_revision, reachable_revision: (tiles along x, along y), the revision at which a tile of TILE x TILE columns last
        changed.
    block_revision: the same for the mask in the blocks of ``reachable_space``.
    """

    def __init__(
        self, grid: GridSpec, clearance_m: float, low: IntArray, high: IntArray, heights: HeightMeasure = EUCLIDEAN
    ) -> None:
        """Create an empty space: no voxel is known free.

        heights: of the map's distances, see VoxelMap. Half a voxel is added to the clearance, because the distance field
        measures to a voxel's centre and an obstacle may extend to its near face.
        """
        self.grid = grid
        needed2 = needed_distance2(clearance_m, grid.resolution_m)
        needed = math.sqrt(needed2) + math.sqrt(2.0 + heights.weight)  # twice the distance from a point to its voxel's centre
        step = 0.5 * heights.slope
        open_samples2 = np.array(
            [min(math.ceil((needed + step * n) ** 2), NEVER) for n in range(1, MAX_OPEN_SAMPLES)], dtype=np.int64
        )
        box = np.array([np.clip(low, 0, grid.shape), np.clip(high, 0, grid.shape)], dtype=np.int64)
        self._rule = ClearanceRule(box=box, needed2=needed2, open_samples2=open_samples2)
        self.clearance_box = make_clearance_box(grid.shape, box[0], box[1], needed2, heights)
        self._escape = EscapePath(grid.resolution_m)
        self._start()

    def _start(self) -> None:
        nx, ny, nz = self.grid.shape
        self.mask = np.zeros((nx + 2, ny + 2, nz + 2), dtype=np.uint8)
        self.known_free = np.zeros_like(self.mask)
        self.open_samples = np.zeros_like(self.mask)
        self.reachable_space = ReachableSpace(self.grid.shape)
        self.reachable: ByteArray = self.reachable_space.reachable
        self.reachable_revision: IntArray = self.reachable_space.tile_revision
        self.mask_revision = np.zeros_like(self.reachable_revision)
        self.block_revision = np.zeros(len(self.reachable_space.blocks.counts), dtype=np.int64)
        self._opened = np.zeros_like(self.mask)
        self._reopened = np.zeros(self.mask_revision.shape, dtype=np.bool_)  # tiles whose opened voxels changed
        self._arrays = SpaceArrays(
            mask=self.mask, opened=self._opened, known_free=self.known_free, open_samples=self.open_samples,
            mask_revision=self.mask_revision, block_revision=self.block_revision,
            blocks_shape=self.reachable_space.blocks.shape,
            changed=np.empty(len(self.reachable_space.blocks.counts), dtype=np.int64),
        )  # fmt: skip
        self.revision = 0
        self._seen: tuple[int, int] = (0, -1)  # map epoch and revision

    def update(self, voxels: VoxelMap) -> None:
        """Apply the changes of the map since the last call.

        A new map epoch starts from an empty space. Raises ValueError if the shape of the map differs.
        """
        if voxels.grid.shape != self.grid.shape:
            raise ValueError(f"map of shape {voxels.grid.shape} given to a space of shape {self.grid.shape}")
        if voxels.map_epoch != self._seen[0]:
            revision = self.revision
            self._start()
            self.revision = revision + 1
            self.reachable_revision.fill(self.revision)
            self.mask_revision.fill(self.revision)
        since = self._seen[1] if voxels.map_epoch == self._seen[0] else -1
        self._seen = (voxels.map_epoch, voxels.revision)
        tiles = np.ascontiguousarray(np.argwhere((voxels.tile_revision > since) | self._reopened))
        self._reopened.fill(False)
        arrays = MapArrays(state=voxels.state, distance2=voxels.distance2, tiles=tiles)
        count = _renew(arrays, self._rule, self._arrays, self.revision + 1)
        if count:
            self.revision += 1
            self.reachable_space.update(self.mask, self._arrays.changed[:count], self.revision)

    def set_opened(self, flat: IntArray) -> None:
        """Set the voxels that are flyable without the clearance, where they are known free.

        flat: (N,) PADDED indices. A finer map has shown that the body fits there. They replace those of the last call. The next
        update() applies them.
        """
        opened = self._opened.reshape(-1)
        before = np.flatnonzero(opened)
        if np.array_equal(before, flat):
            return
        opened[before] = 0
        opened[flat] = 1
        i, j, _ = np.unravel_index(np.concatenate([before, flat]), self.mask.shape)
        self._reopened[(i - 1) // TILE, (j - 1) // TILE] = True

    def locate_vehicle(self, position_world: FloatArray) -> IntArray | None:
        """Return the flat cells from the vehicle's cell to the nearest flyable one, both included.

        The result is one cell if the vehicle's cell is flyable. Just after take-off, or after a change of the map, the
        vehicle may be in a cell that is not flyable. It then leaves through known-free cells only; its own cell is exempt.
        None if there is no such path within ESCAPE_LIMIT_M; ``reachable`` is then unchanged. Otherwise ``reachable``
        becomes the set of cells reachable from the last cell.
        """
        cell = np.floor(self.padded_from_world(position_world)).astype(np.int64)
        if np.any(cell < 1) or np.any(cell >= np.array(self.mask.shape) - 1):
            return None
        cells = self._escape.find(self.mask, self.known_free, cell)
        if cells is None:
            return None
        i, j, k = (int(n) for n in np.unravel_index(int(cells[-1]), self.mask.shape))
        if not self.reachable[i, j, k]:
            self.revision += 1
            self.reachable_space.set_root(i, j, k, self.revision)
        return cells

    def padded_from_world(self, points_world: FloatArray) -> FloatArray:
        """Convert world points (3,) or (N, 3) to padded voxel units."""
        out: FloatArray = (points_world - self.grid.origin_world_m) / self.grid.resolution_m + 1.0
        return out

    def is_confined(self, position_world: FloatArray) -> bool:
        """Return True if the vehicle can hardly move, as over its pad after the first look round."""
        at, reach = self.padded_from_world(position_world), CONFINED_M / self.grid.resolution_m
        low, high = np.maximum(np.floor(at - reach), 0).astype(np.int64), np.floor(at + reach).astype(np.int64) + 1
        around = self.reachable[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        return bool(np.count_nonzero(around) * self.grid.resolution_m**3 < CONFINED_M3)

    def world_from_padded(self, points_padded: FloatArray) -> FloatArray:
        """Convert padded voxel units to world points."""
        out: FloatArray = (points_padded - 1.0) * self.grid.resolution_m + self.grid.origin_world_m
        return out

    def flat_index(self, cell_padded: IntArray) -> int:
        """Return the flat index of a padded cell (3,), clipped to the border if it lies outside."""
        cell = np.clip(cell_padded, 0, np.array(self.mask.shape) - 1)
        return int(np.ravel_multi_index((int(cell[0]), int(cell[1]), int(cell[2])), self.mask.shape))

    def cell_centres(self, flat: IntArray) -> FloatArray:
        """Return the centres (N, 3) in padded voxel units of flat indices (N,)."""
        centre: FloatArray = np.stack(np.unravel_index(flat, self.mask.shape), axis=-1) + np.float64(0.5)
        return centre


@kernel
def _renew(  # noqa: C901, PLR0912
    voxels: MapArrays, rule: ClearanceRule, space: SpaceArrays, revision: int
) -> int:
    """Update the arrays of a space in some tiles; return the number of changed blocks."""
    state, distance2, tiles = voxels
    box, needed2, open_samples2 = rule
    mask, opened, known_free, open_samples, mask_revision, block_revision, blocks_shape, changed = space
    nx, ny, nz = state.shape
    count = 0
    column = np.zeros(nz, dtype=np.uint8)
    for tile in tiles:
        for i in range(tile[0] * TILE, min(tile[0] * TILE + TILE, nx)):
            for j in range(tile[1] * TILE, min(tile[1] * TILE + TILE, ny)):
                states, distances = state[i, j], distance2[i, j]
                frees, masks, open_counts = known_free[i + 1, j + 1], mask[i + 1, j + 1], open_samples[i + 1, j + 1]
                exempt = opened[i + 1, j + 1]
                low, high = box[0, 2], box[1, 2]
                if i < box[0, 0] or i >= box[1, 0] or j < box[0, 1] or j >= box[1, 1]:
                    high = low
                for k in range(nz):
                    column[k] = np.uint8(states[k] == FREE)
                    frees[k + 1] = column[k]
                differs = np.uint8(0)
                for k in range(nz):
                    enough = np.uint8(distances[k] >= needed2) | exempt[k + 1]
                    column[k] &= enough & np.uint8(k >= low) & np.uint8(k < high)
                    differs |= column[k] ^ masks[k + 1]
                for k in range(nz):
                    open_counts[k + 1] = column[k]
                for least2 in open_samples2:
                    for k in range(nz):
                        open_counts[k + 1] += column[k] & np.uint8(distances[k] >= least2)
                if differs == 0:
                    continue
                base = ((i // EDGE + 1) * blocks_shape[1] + j // EDGE + 1) * blocks_shape[2] + 1
                for k in range(nz):
                    if column[k] != masks[k + 1]:
                        masks[k + 1] = column[k]
                        block = base + k // EDGE
                        if block_revision[block] != revision:
                            block_revision[block] = revision
                            changed[count] = block
                            count += 1
                mask_revision[i // TILE, j // TILE] = revision
    return count


def warm_up() -> None:
    """Compile all kernels of a space for the read-only arrays of a VoxelMap."""
    grid = GridSpec(np.zeros(3), 0.1, (12, 12, 12))
    state = np.zeros(grid.shape, dtype=np.uint8)
    state[2:, 2:, 2:] = FREE
    space = FlyableSpace(grid, 0.1, np.zeros(3, dtype=np.int64), np.array(grid.shape))
    for revision, distance in enumerate((9, 0, 9)):
        voxels = VoxelMap.whole(grid, state, np.where(state == FREE, distance, 0).astype(np.uint8), revision)
        space.update(voxels)
        for position in (0.25, 0.15, 0.65):
            space.locate_vehicle(np.full(3, position))
    state[6] = 0  # two regions: the vehicle changes from one to the other
    space.update(VoxelMap.whole(grid, state, np.where(state == FREE, 9, 0).astype(np.uint8), 3))
    for place in ((0.35, 0.65, 0.65), (0.95, 0.65, 0.65)):
        space.locate_vehicle(np.array(place))
