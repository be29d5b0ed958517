"""Lengths of the planner's paths against an independent oracle, for seeded random pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.bench.planner import path_oracle
from uav_recon.mapping.occupancy.distance_field import distance2_to_not_free
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.frontier.frontiers import fence_box
from uav_recon.planning.paths.path_cache import PathCache
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import LARGEST_DISTANCE_VOXELS, GridSpec, VoxelMap

PAIRS = 100
SEED = 20240410


@dataclass(frozen=True, slots=True)
class PathLengths:
    """Mean lengths over the pairs in metres, and the relative excess of the planner's paths.

    The excess is the mean, the 95th percentile and the maximum.
    """

    pairs: int
    mean_m: float
    oracle_mean_m: float
    mean_excess: float
    p95_excess: float
    max_excess: float


def compare(
    state: ByteArray, grid: GridSpec, fence_m: tuple[FloatArray, FloatArray], clearance_m: float, pairs: int = PAIRS
) -> PathLengths | None:
    """Compare path lengths on a finished map (nx, ny, nz); None if there is no room to fly in.

    fence_m: lower and upper corner (3,). The body keeps ``clearance_m`` from the fence too.
    """
    reach = min(int(np.ceil(clearance_m / grid.resolution_m)) + 2, LARGEST_DISTANCE_VOXELS)
    voxels = VoxelMap.whole(grid, state, distance2_to_not_free(state, reach), 1)
    low, high = fence_box(grid, fence_m[0] + clearance_m, fence_m[1] - clearance_m)
    mask = path_oracle.flyable(voxels, clearance_m, low, high)
    chosen = path_oracle.connected_pairs(mask, pairs, SEED)
    if not len(chosen):
        return None
    space = space_of(voxels, clearance_m, (low, high))
    path_cache = PathCache(space)
    ours, exact = [], []
    for start, goal in chosen:
        exact.append(path_oracle.length_of(path_oracle.shortest_path(mask, start, goal)) * grid.resolution_m)
        ours.append(_planned_m(space, path_cache, start, goal))
    excess = np.array(ours) / np.array(exact) - 1.0
    return PathLengths(
        pairs=pairs,
        mean_m=float(np.mean(ours)),
        oracle_mean_m=float(np.mean(exact)),
        mean_excess=float(excess.mean()),
        p95_excess=float(np.percentile(excess, 95)),
        max_excess=float(excess.max()),
    )


def space_of(voxels: VoxelMap, clearance_m: float, box: tuple[IntArray, IntArray]) -> FlyableSpace:
    """Return the planner's flyable space."""
    space = FlyableSpace(voxels.grid, clearance_m, *box)
    space.update(voxels)
    return space


def _planned_m(space: FlyableSpace, path_cache: PathCache, start: IntArray, goal: IntArray) -> float:
    """Return the planner's path length between two connected voxels (3,)."""
    start_m = space.grid.centre(start)
    exit_cells = space.locate_vehicle(start_m)
    if exit_cells is None:
        return float(np.inf)
    path_cache.update(exit_cells, start_m, goal[None] + np.float64(1.5))
    return float(path_cache.lengths_m[0, 1])
