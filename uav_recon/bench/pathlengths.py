"""Lengths of the planner's ways against an independent oracle, between seeded pairs of places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.bench import path_oracle
from uav_recon.mapping.distance import distance2_to_not_free
from uav_recon.planning.flyable import FlyableSpace
from uav_recon.planning.frontiers import fence_box
from uav_recon.planning.proposal import Proposal, Situation
from uav_recon.planning.routes import Routes
from uav_recon.planning.search import distances_from
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import LARGEST_DISTANCE_VOXELS, GridSpec, VoxelMap
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

PAIRS = 100
SEED = 20240410


@dataclass(frozen=True, slots=True)
class PathLengths:
    """Means over the pairs in metres, and by which share the planner's ways are longer: mean, 95th percentile, largest."""

    pairs: int
    mean_m: float
    oracle_mean_m: float
    mean_excess: float
    p95_excess: float
    max_excess: float


def compare(
    state: ByteArray, grid: GridSpec, fence_m: tuple[FloatArray, FloatArray], clearance_m: float, pairs: int = PAIRS
) -> PathLengths | None:
    """Ways on a finished map (nx, ny, nz); None where there is no room to fly in.

    fence_m: lower and upper corner (3,); the body keeps ``clearance_m`` from it too.
    """
    reach = min(int(np.ceil(clearance_m / grid.resolution_m)) + 2, LARGEST_DISTANCE_VOXELS)
    voxels = VoxelMap.whole(grid, state, distance2_to_not_free(state, reach), 1)
    low, high = fence_box(grid, fence_m[0] + clearance_m, fence_m[1] - clearance_m)
    mask = path_oracle.flyable(voxels, clearance_m, low, high)
    chosen = path_oracle.connected_pairs(mask, pairs, SEED)
    if not len(chosen):
        return None
    ours, exact = [], []
    for start, goal in chosen:
        exact.append(path_oracle.length_of(path_oracle.shortest_way(mask, start, goal)) * grid.resolution_m)
        ours.append(_planned_m(voxels, clearance_m, (low, high), grid.centre(start), grid.centre(goal)))
    excess = np.array(ours) / np.array(exact) - 1.0
    return PathLengths(
        pairs=pairs,
        mean_m=float(np.mean(ours)),
        oracle_mean_m=float(np.mean(exact)),
        mean_excess=float(excess.mean()),
        p95_excess=float(np.percentile(excess, 95)),
        max_excess=float(excess.max()),
    )


def flyable_of(voxels: VoxelMap, clearance_m: float, box: tuple[IntArray, IntArray]) -> BoolArray:
    """Where the planner itself says that the body may be, (nx, ny, nz)."""
    mask: BoolArray = FlyableSpace.of(voxels, clearance_m, *box).mask[1:-1, 1:-1, 1:-1] > 0
    return mask


def _planned_m(
    voxels: VoxelMap, clearance_m: float, box: tuple[IntArray, IntArray], start_m: FloatArray, goal_m: FloatArray
) -> float:
    space = FlyableSpace.of(voxels, clearance_m, *box)
    source = space.flat(voxels.grid.index(start_m) + 1)
    cell = space.flat(voxels.grid.index(goal_m) + 1)
    reach, previous = distances_from(space.mask, source, np.zeros(0, dtype=np.int64), np.inf)
    situation = Situation(voxels, space, np.array([source]), start_m, space.mask, reach, previous)
    nothing = np.zeros(0, dtype=np.int64)
    task = Task(TaskKind.EXPLORE, goal_m, Viewpoint(goal_m, 0.0, 0.0), 1.0)
    routes = Routes(situation, start_m, [Proposal(task, cell, nothing, nothing.astype(np.float64))])
    return float(routes.lengths_m[0, 1])
