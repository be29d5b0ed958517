"""Reconstruction tasks: views of uncertain surface near the vehicle (paper, Algorithm 1).

Added to the released code: visibility by ray casting, |n.v| in the gain, the whole shell, and nearness by paths through
free space, so that a radius does not extend through walls.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.geometry.jit import kernel
from uav_recon.planning.camera_frustum import RANGE, CameraGeometry
from uav_recon.planning.candidate_view import CandidateView, PlanningContext
from uav_recon.planning.reconstruction.geodesic_neighbourhood import geodesic_distances, within_geodesic_radius
from uav_recon.planning.reconstruction.surface_elements import (
    Elements,
    ElementsCache,
    element_weights,
    max_cosine_per_voxel,
    within,
)
from uav_recon.planning.reconstruction.unmodelled_surface import unmodelled_surface
from uav_recon.planning.reconstruction.view_gain import best_candidates, best_view, patches_near
from uav_recon.planning.view_sampling import RANGE_MARGIN_M, edge_shell, shell
from uav_recon.types.frames import Float32Array, FloatArray, IntArray
from uav_recon.types.maps import SurfaceElements
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

VIEW_DISCOUNT = 0.35  # factor on an element's uncertainty for each task that saw it at a right angle, so that tasks end
MIN_GAIN_SHARE = 1.0  # min. gain of a view as a share of min_visible; one most uncertain element has gain 1
CANDIDATE_VIEWS = 12  # candidates per task evaluated by element ...
FULL_VIEWS = 3  # ... and of these, the number evaluated in full
_TIGHT_RADII_M = (0.5, 0.65)  # for tight rooms
_NEGLIGIBLE = 1e-6  # elements with less weight do not seed a cluster


class SurfaceViews:
    """Finds views of uncertain surface for one vehicle and camera. Its only state is a cache.

    The cache holds the last surface, sorted by cell.
    """

    def __init__(self, config: PlannerConfig, camera: CameraGeometry, elements: ElementsCache | None = None) -> None:
        """Prepare the places of views. elements: a cache to be shared; None = its own."""
        self._config = config
        self._camera = camera
        radii_m = (*_TIGHT_RADII_M, *np.linspace(config.shell_min_m, config.shell_max_m, 3))
        farthest_m = min(camera.surface_range_m, camera.range_m) - RANGE_MARGIN_M
        edge_m = tuple(float(r) for r in np.linspace(config.shell_max_m, max(farthest_m, config.shell_max_m), 2))
        self._offsets_m = np.concatenate(
            [shell(camera, tuple(float(r) for r in radii_m), 1.0), edge_shell(camera, edge_m, 1.0)]
        )
        self._elements = ElementsCache(config.downsample) if elements is None else elements

    def propose(
        self, context: PlanningContext, surface: SurfaceElements | None, cosine_sums: Float32Array, factor: float
    ) -> list[CandidateView]:
        """Return at most N_rec tasks. Each gain is what the task adds to the ones before it.

        surface: None without a mapper; empty if the mapper has learned nothing, so that all surface is bare.
        cosine_sums: (nx, ny, nz) sum of the cosines under which tasks have seen the surface in a voxel.
        factor: multiplies R_loc, R_clu and N_rec (alpha once no frontier is left).
        """
        if surface is None:
            return []
        config, resolution_m = self._config, context.voxels.grid.resolution_m
        elements = self._elements.of(surface, context.voxels.grid)
        start = np.stack(np.unravel_index(context.exit_cells[-1], context.space.mask.shape)) - 1
        limit = config.local_radius_m * factor / resolution_m
        radius = config.cluster_radius_m / resolution_m
        lens = self._camera.lens(resolution_m, min(self._camera.surface_range_m, self._camera.range_m))
        # a view is at most d_f from its cluster, and sees up to the range of the camera
        elements = _with_unmodelled(elements, context, start, limit + radius)
        around = within(elements, start + 0.5, limit + config.shell_max_m / resolution_m + lens[RANGE])
        weight = element_weights(around, elements.sigma, elements.voxel, cosine_sums.ravel(), VIEW_DISCOUNT)
        near = within_path_length(elements, around, context, start, limit)
        left = with_weight(near, weight)
        proposals: list[CandidateView] = []
        for _ in range(round(config.max_reconstruct_tasks * factor)):
            if not len(left):
                break
            seed, aim = next_cluster(elements.position, weight, left, radius)
            found = self._propose_one(context, elements, around, weight, elements.position[aim], lens)
            if found is not None:
                proposals.append(found)
            # if a cluster cannot be seen, surface beyond R_clu may still be visible
            left = outside_radius(elements.position, left, seed, radius if found is None else radius * factor)
        return proposals

    def _propose_one(
        self,
        context: PlanningContext,
        elements: Elements,
        cells: IntArray,
        weight: FloatArray,
        centre: FloatArray,
        lens: FloatArray,
    ) -> CandidateView | None:
        """Return the best view of one cluster, or None.

        ``weight`` is changed: the surface that the view shows has less weight afterwards.
        """
        state, min_visible = context.voxels.state, self._config.min_visible
        surface = (elements.position, elements.normal, weight, cells)
        places = np.floor(centre + self._offsets_m / context.voxels.grid.resolution_m) + 0.5
        patches = patches_near(centre, lens[RANGE], *surface)
        candidates = places[best_candidates(state, context.space.reachable, lens, places, centre, patches, CANDIDATE_VIEWS)]
        cosine = np.zeros(len(weight))
        best, yaw, pitch, gain = best_view(state, lens, candidates, centre, *surface, min_visible, FULL_VIEWS, cosine)
        if best < 0 or gain < MIN_GAIN_SHARE * min_visible:
            return None
        seen = np.flatnonzero(cosine)
        weight[seen] *= VIEW_DISCOUNT ** cosine[seen]
        grid = context.voxels.grid
        viewpoint = Viewpoint(grid.origin_world_m + candidates[best] * grid.resolution_m, yaw, pitch)
        task = Task(TaskKind.RECONSTRUCT, grid.origin_world_m + centre * grid.resolution_m, viewpoint, gain)
        return CandidateView(task, candidates[best] + 1.0, *max_cosine_per_voxel(elements.voxel[seen], cosine[seen]))


def _with_unmodelled(elements: Elements, context: PlanningContext, start: IntArray, reach: float) -> Elements:
    """Add the surface that is only in the map.

    Only voxels within ``reach`` voxels of ``start`` (3,) along each axis are searched.
    """
    voxels = context.voxels
    low = np.maximum(start - math.ceil(reach), 0)
    high = np.minimum(start + math.ceil(reach) + 1, np.array(voxels.grid.shape, dtype=np.int64))
    position, normal = unmodelled_surface(voxels.state, low, high, elements.modelled)
    return elements.with_unmodelled(position, normal, voxels.grid)


def within_path_length(
    elements: Elements, cells: IntArray, context: PlanningContext, start: IntArray, limit: float
) -> IntArray:
    """Return those of some cells (C, 3) within ``limit`` voxels of path through free space."""
    state = context.voxels.state
    reach, low = geodesic_distances(state, start, limit)
    middle = cells[:, 2]
    near: IntArray = cells[within_geodesic_radius(state, reach, low, limit, elements.position[middle], elements.normal[middle])]
    return near


@kernel
def with_weight(cells: IntArray, weight: FloatArray) -> IntArray:
    """Return the elements (M,) of some cells (C, 3) with enough weight for a cluster."""
    out = np.empty(len(weight), dtype=np.int64)
    count = 0
    for c in range(len(cells)):
        for n in range(cells[c, 0], cells[c, 1]):
            if weight[n] > _NEGLIGIBLE:
                out[count] = n
                count += 1
    return out[:count].copy()


@kernel
def next_cluster(position: FloatArray, weight: FloatArray, left: IntArray, radius: float) -> tuple[int, int]:
    """Return the most uncertain of the elements ``left`` (M,), and the element to aim at.

    The element to aim at is the nearest to the weighted mean of those within ``radius`` voxels of the most uncertain one.
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
def outside_radius(position: FloatArray, left: IntArray, seed: int, radius: float) -> IntArray:
    """Return those of ``left`` that are farther than ``radius`` voxels from an element."""
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
