"""Maps of free and occupied space, and of the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import BoolArray, ByteArray, Float32Array, FloatArray, IntArray, frozen

UNKNOWN = 0
FREE = 1
OCCUPIED = 2
TILE = 8  # columns along x and y of a tile, the unit in which changes of a map are recorded
LARGEST_DISTANCE_VOXELS = 15  # its square fits a byte


@dataclass(frozen=True, slots=True)
class HeightMeasure:
    """Measure of the vertical part of a distance, for distances of a flat body.

    half_voxels: half of the body's height, which does not count. slope: factor on the rest, at least 1: a body needs less
    clearance above and below than its radius and its clearance at the sides.
    """

    half_voxels: float = 0.0
    slope: float = 1.0

    def squares(self, voxels: IntArray) -> IntArray:
        """Return the squared distances (N,) of numbers of voxels (N,) along z.

        They are rounded down, and 0 only for 0.
        """
        counted = self.slope * np.maximum(voxels - self.half_voxels, 0.0)
        squares: IntArray = np.maximum(np.floor(counted**2 + 1e-9), voxels > 0).astype(np.int64)
        return squares

    @property
    def weight(self) -> float:
        """Squared factor by which a distance changes at most along z, of its change along x."""
        return self.slope**2


EUCLIDEAN = HeightMeasure()


@dataclass(frozen=True, slots=True, eq=False)
class GridSpec:
    """A voxel grid in C order (x, y, z).

    Voxel (i, j, k) spans origin + resolution * [(i,j,k), (i,j,k)+1].
    """

    origin_world_m: FloatArray
    resolution_m: float
    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin_world_m", frozen(np.asarray(self.origin_world_m, dtype=np.float64)))

    @staticmethod
    def covering(lower_m: FloatArray, upper_m: FloatArray, resolution_m: float) -> GridSpec:
        """Return the smallest grid on multiples of the resolution that covers a box."""
        first = np.floor(np.asarray(lower_m) / resolution_m + 1e-6).astype(int)
        last = np.ceil(np.asarray(upper_m) / resolution_m - 1e-6).astype(int)
        nx, ny, nz = (int(n) for n in last - first)
        return GridSpec(first * resolution_m, resolution_m, (nx, ny, nz))

    def index(self, points_world: FloatArray) -> IntArray:
        """Return the voxel index (N, 3) or (3,) of points; may lie outside the grid."""
        return np.floor((points_world - self.origin_world_m) / self.resolution_m).astype(np.int64)

    def centre(self, index: IntArray) -> FloatArray:
        """Return the centres in world, (N, 3) or (3,), of voxel indices."""
        centre: FloatArray = self.origin_world_m + (np.asarray(index) + 0.5) * self.resolution_m
        return centre

    def contains(self, index: IntArray) -> BoolArray:
        """Return a mask (N,) of the indices (N, 3) inside the grid."""
        inside: BoolArray = np.all((index >= 0) & (index < np.array(self.shape)), axis=-1)
        return inside


@dataclass(frozen=True, slots=True, eq=False)
class VoxelMap:
    """A frozen snapshot of the voxels.

    state: (nx, ny, nz) uint8 of UNKNOWN | FREE | OCCUPIED.
    distance2: (nx, ny, nz) uint8, SQUARED distance in voxels from a voxel's centre to the centre of the nearest voxel that
    is NOT known free (occupied, unknown, or outside the grid or the fence), exact below the cap; 0 in such a voxel.
    Unknown is not free.
    tile_revision: (ceil(nx / TILE), ceil(ny / TILE)) int64, the revision at which anything in a tile of TILE x TILE columns
    last changed. A reader that knows an older revision of this map only has to read the changed tiles.
    heights: how the vertical part of these distances counts.
    fine: maps of a higher resolution of places in this map, all of one shape.
    """

    grid: GridSpec
    state: ByteArray
    distance2: ByteArray
    tile_revision: IntArray
    revision: int
    map_epoch: int = 0
    heights: HeightMeasure = EUCLIDEAN
    fine: tuple[VoxelMap, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "state", frozen(np.asarray(self.state, dtype=np.uint8)))
        object.__setattr__(self, "distance2", frozen(np.asarray(self.distance2, dtype=np.uint8)))
        object.__setattr__(self, "tile_revision", frozen(np.asarray(self.tile_revision, dtype=np.int64)))

    @staticmethod
    def whole(
        grid: GridSpec,
        state: ByteArray,
        distance2: ByteArray,
        revision: int,
        map_epoch: int = 0,
        heights: HeightMeasure = EUCLIDEAN,
    ) -> VoxelMap:
        """Return a map in which every tile has the map's own revision."""
        tiles = (-(-grid.shape[0] // TILE), -(-grid.shape[1] // TILE))
        dated = np.full(tiles, revision, dtype=np.int64)
        return VoxelMap(grid, state, distance2, dated, revision, map_epoch, heights)

    def changed_tiles(self, since_revision: int) -> IntArray:
        """Return the tiles (N, 2) that changed after a revision of the same map epoch.

        All tiles for a negative revision.
        """
        changed: IntArray = np.ascontiguousarray(np.argwhere(self.tile_revision > since_revision))
        return changed

    def distance_m(self, index: IntArray) -> FloatArray:
        """Return the distance in metres at voxel indices (..., 3); 0 outside the grid."""
        inside = self.grid.contains(index)
        i, j, k = np.moveaxis(np.where(inside[..., None], index, 0), -1, 0)
        found: FloatArray = np.where(inside, np.sqrt(self.distance2[i, j, k].astype(np.float64)), 0.0) * self.grid.resolution_m
        return found


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpace:
    """The voxels that are known free: one bit each, in C order.

    The first voxel is the highest bit of the first byte. bits: (ceil(nx ny nz / 8),) uint8. It remains valid after the mission
    process that published it has ended.
    """

    grid: GridSpec
    bits: ByteArray
    revision: int
    map_epoch: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "bits", frozen(np.asarray(self.bits, dtype=np.uint8)))

    @staticmethod
    def of(voxels: VoxelMap) -> FreeSpace:
        """Return the voxels of a map that are known free."""
        return FreeSpace(voxels.grid, np.packbits(voxels.state == FREE), voxels.revision, voxels.map_epoch)


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceElements:
    """Points of the learned surface.

    position_world: (N, 3). normal_world: (N, 3), outward. uncertainty: (N,) >= 0.
    """

    position_world: FloatArray
    normal_world: FloatArray
    uncertainty: FloatArray
    revision: int
    map_epoch: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """A coloured triangle mesh.

    vertices_world: (V, 3) float64. faces: (F, 3) int64. rgb: (V, 3) uint8. uncertainty: (V,) float32.
    """

    vertices_world: FloatArray
    faces: IntArray
    rgb: ByteArray
    uncertainty: Float32Array
