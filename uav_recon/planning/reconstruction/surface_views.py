"""Reconstruction tasks: views of the uncertain surface near the vehicle (paper, Algorithm 1).

What the released code left out stands here: visibility by ray casting, |n.v| in the gain, the whole shell, and "near" by the
way through free space, so that a radius does not reach through walls.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.geometry.jit import kernel
from uav_recon.planning.camera_frustum import RANGE, CameraGeometry
from uav_recon.planning.candidate_view import CandidateView, PlanningContext
from uav_recon.planning.reconstruction.geodesic_neighbourhood import seen_from_near, wave
from uav_recon.planning.reconstruction.surface_elements import Elements, KeptElements, squarest, weigh, within
from uav_recon.planning.reconstruction.unmodelled_surface import unmodelled_surface
from uav_recon.planning.reconstruction.view_gain import best_view, patches_near, promising
from uav_recon.planning.view_sampling import shell
from uav_recon.types.frames import Float32Array, FloatArray, IntArray
from uav_recon.types.maps import SurfaceElements
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

LOOK_DISCOUNT = 0.35  # of an element's uncertainty, for each task that has looked squarely at it: so that tasks run out
WORTH_SHARE = 1.0  # of min_visible: a view that gains less than so many most uncertain elements is noise
HOPEFUL_VIEWS = 12  # of all candidates for a task: those counted by element ...
FULL_VIEWS = 3  # ... and of these: those counted in full
_TIGHT_RADII_M = (0.5, 0.65)  # tight rooms
_NEGLIGIBLE = 1e-6  # an element of less weight is no seed of a cluster


class SurfaceViews:
    """Finds views of uncertain surface for one vehicle and camera; keeps the last surface sorted, and nothing else."""

    def __init__(self, config: PlannerConfig, camera: CameraGeometry) -> None:
        self._config = config
        self._camera = camera
        radii_m = (*_TIGHT_RADII_M, *np.linspace(config.shell_min_m, config.shell_max_m, 3))
        self._offsets_m = shell(camera, tuple(float(r) for r in radii_m), 1.0)
        self._elements = KeptElements(config.downsample)

    def propose(
        self, situation: PlanningContext, surface: SurfaceElements | None, looks: Float32Array, factor: float
    ) -> list[CandidateView]:
        """Return at most N_rec tasks; ``factor`` multiplies R_loc, R_clu and N_rec (alpha once no frontier is left).

        looks: (nx, ny, nz), sum of the cosines under which tasks have looked at the surface in a voxel. Gains are what a task
        adds to the ones before it.
        """
        if surface is None or not len(surface.position_world):
            return []
        config, resolution_m = self._config, situation.voxels.grid.resolution_m
        elements = self._elements.of(surface, situation.voxels.grid)
        start = np.stack(np.unravel_index(situation.exit_cells[-1], situation.space.mask.shape)) - 1
        limit = config.local_radius_m * factor / resolution_m
        radius = config.cluster_radius_m / resolution_m
        lens = self._camera.lens(resolution_m, min(self._camera.surface_range_m, self._camera.range_m))
        # a view stands at most d_f from its cluster, and sees as far as the camera does
        elements = _and_bare(elements, situation, start, limit + radius)
        around = within(elements, start + 0.5, limit + config.shell_max_m / resolution_m + lens[RANGE])
        weight = weigh(around, elements.sigma, elements.voxel, looks.ravel(), LOOK_DISCOUNT)
        near = local(elements, around, situation, start, limit)
        left = weighty(near, weight)
        proposals: list[CandidateView] = []
        for _ in range(round(config.max_reconstruct_tasks * factor)):
            if not len(left):
                break
            seed, aim = cluster(elements.position, weight, left, radius)
            found = self._propose_one(situation, elements, around, weight, elements.position[aim], lens)
            if found is not None:
                proposals.append(found)
            # where a cluster cannot be seen, what lies beyond R_clu may well be
            left = beyond(elements.position, left, seed, radius if found is None else radius * factor)
        return proposals

    def _propose_one(
        self,
        situation: PlanningContext,
        elements: Elements,
        cells: IntArray,
        weight: FloatArray,
        centre: FloatArray,
        lens: FloatArray,
    ) -> CandidateView | None:
        """The best view of one cluster; what it will show is worth less afterwards (``weight`` is changed)."""
        state, min_visible = situation.voxels.state, self._config.min_visible
        surface = (elements.position, elements.normal, weight, cells)
        places = np.floor(centre + self._offsets_m / situation.voxels.grid.resolution_m) + 0.5
        patches = patches_near(centre, lens[RANGE], *surface)
        hopeful = places[promising(state, situation.space.reachable, lens, places, centre, patches, HOPEFUL_VIEWS)]
        cosine = np.zeros(len(weight))
        best, yaw, pitch, gain = best_view(state, lens, hopeful, centre, *surface, min_visible, FULL_VIEWS, cosine)
        if best < 0 or gain < WORTH_SHARE * min_visible:
            return None
        seen = np.flatnonzero(cosine)
        weight[seen] *= LOOK_DISCOUNT ** cosine[seen]
        grid = situation.voxels.grid
        viewpoint = Viewpoint(grid.origin_world_m + hopeful[best] * grid.resolution_m, yaw, pitch)
        task = Task(TaskKind.RECONSTRUCT, grid.origin_world_m + centre * grid.resolution_m, viewpoint, gain)
        return CandidateView(task, hopeful[best] + 1.0, *squarest(elements.voxel[seen], cosine[seen]))


def _and_bare(elements: Elements, situation: PlanningContext, start: IntArray, reach: float) -> Elements:
    """And what the map alone knows, at most ``reach`` voxels along each axis from ``start`` (3,)."""
    voxels = situation.voxels
    low = np.maximum(start - math.ceil(reach), 0)
    high = np.minimum(start + math.ceil(reach) + 1, np.array(voxels.grid.shape, dtype=np.int64))
    position, normal = unmodelled_surface(voxels.state, low, high, elements.modelled)
    return elements.with_bare(position, normal, voxels.grid)


def local(elements: Elements, cells: IntArray, situation: PlanningContext, start: IntArray, limit: float) -> IntArray:
    """Of some cells (C, 3), those that the vehicle is at most ``limit`` voxels away from, through free space."""
    state = situation.voxels.state
    reach, low = wave(state, start, limit)
    middle = cells[:, 2]
    near: IntArray = cells[seen_from_near(state, reach, low, limit, elements.position[middle], elements.normal[middle])]
    return near


@kernel
def weighty(cells: IntArray, weight: FloatArray) -> IntArray:
    """Those elements (M,) of some cells (C, 3) whose weight can make a cluster."""
    out = np.empty(len(weight), dtype=np.int64)
    count = 0
    for c in range(len(cells)):
        for n in range(cells[c, 0], cells[c, 1]):
            if weight[n] > _NEGLIGIBLE:
                out[count] = n
                count += 1
    return out[:count].copy()


@kernel
def cluster(position: FloatArray, weight: FloatArray, left: IntArray, radius: float) -> tuple[int, int]:
    """The most uncertain of the elements ``left`` (M,), and the one to aim at for it.

    That is the element nearest to the weighted mean of those within ``radius`` voxels of the first.
    """
    seed = left[0]
    for n in left:
        if weight[n] > weight[seed]:
            seed = n
    x, y, z, total = 0.0, 0.0, 0.0, 0.0
    for n in left:
        if _away2(position, n, position[seed, 0], position[seed, 1], position[seed, 2]) <= radius * radius:
            x += weight[n] * position[n, 0]
            y += weight[n] * position[n, 1]
            z += weight[n] * position[n, 2]
            total += weight[n]
    x, y, z = x / total, y / total, z / total
    aim, aim2 = seed, np.inf
    for n in left:
        from_mean2 = _away2(position, n, x, y, z)
        if from_mean2 < aim2 and (
            _away2(position, n, position[seed, 0], position[seed, 1], position[seed, 2]) <= radius * radius
        ):
            aim, aim2 = n, from_mean2
    return seed, aim


@kernel
def beyond(position: FloatArray, left: IntArray, seed: int, radius: float) -> IntArray:
    """Those of ``left`` that are farther than ``radius`` voxels from an element."""
    out = np.empty(len(left), dtype=np.int64)
    count = 0
    for n in left:
        if _away2(position, n, position[seed, 0], position[seed, 1], position[seed, 2]) > radius * radius:
            out[count] = n
            count += 1
    return out[:count].copy()


@kernel
def _away2(position: FloatArray, n: int, x: float, y: float, z: float) -> float:
    away2: float = (position[n, 0] - x) ** 2 + (position[n, 1] - y) ** 2 + (position[n, 2] - z) ** 2
    return away2
