"""Reconstruction tasks: views of the uncertain surface near the vehicle (paper, Algorithm 1).

What the released code left out stands here: visibility by ray casting, |n.v| in the gain, the whole shell, and "near" by the
way through free space, so that a radius does not reach through walls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.geometry.jit import kernel
from uav_recon.geometry.traversal import is_visible
from uav_recon.planning.camera import RANGE, CameraGeometry, aim, in_view, sight
from uav_recon.planning.proposal import Proposal, Situation
from uav_recon.planning.search import distances_from
from uav_recon.planning.viewpoints import shell
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import SurfaceElements
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

LOOK_DISCOUNT = 0.35  # of an element's uncertainty, for each task that has looked squarely at it: so that tasks run out
WORTH_SHARE = 1.0  # of min_visible: a view that gains less than so many most uncertain elements is not worth its flight
PROBE_CELL = 3.0  # voxels: elements are merged to this for the first sorting of candidates ...
FULL_VIEWS = 6  # ... and so many of them are then counted in full
TAIL = 1.5  # voxels before an element that may be occupied or unknown: the element's own wall


@dataclass(frozen=True, slots=True, eq=False)
class UncertainSurface:
    """Thinned elements in voxel units: position (N, 3), outward normal (N, 3), weight (N,) in 0..1, voxel (N,) flat or -1."""

    position: FloatArray
    normal: FloatArray
    weight: FloatArray
    voxel: IntArray

    def taken(self, which: IntArray | BoolArray) -> UncertainSurface:
        """Return some of the elements."""
        return UncertainSurface(self.position[which], self.normal[which], self.weight[which], self.voxel[which])


def thinned(surface: SurfaceElements, situation: Situation, looks: FloatArray, every: int) -> UncertainSurface:
    """Every N_down-th element; uncertainty divided by its 90th percentile, clipped to 1, less for what was looked at.

    The scale of the uncertainty is the mapper's own and drifts as it learns: only its ranking within this map is used.
    """
    grid = situation.voxels.grid
    position = (surface.position_world[::every] - grid.origin_world_m) / grid.resolution_m
    sigma = surface.uncertainty[::every]
    usable = np.isfinite(position).all(axis=1) & np.isfinite(surface.normal_world[::every]).all(axis=1) & np.isfinite(sigma)
    position, normal, sigma = position[usable], surface.normal_world[::every][usable], np.maximum(sigma[usable], 0.0)
    if not len(sigma):
        return UncertainSurface(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.int64))
    scale = float(np.percentile(sigma, 90)) or float(sigma.max()) or 1.0
    index = np.floor(position).astype(np.int64)
    inside = grid.contains(index)
    voxel = np.where(inside, np.ravel_multi_index(tuple(np.where(inside[:, None], index, 0).T), grid.shape), -1)
    looked = np.where(voxel >= 0, looks.ravel()[voxel], 0.0)
    weight = np.minimum(sigma / scale, 1.0) * LOOK_DISCOUNT**looked
    return UncertainSurface(np.ascontiguousarray(position), np.ascontiguousarray(normal, dtype=np.float64), weight, voxel)


def local(surface: UncertainSurface, situation: Situation, radius_m: float) -> UncertainSurface:
    """Elements with a free voxel beside them that the vehicle is at most R_loc away from, through free space."""
    space = situation.space
    limit = radius_m / situation.voxels.grid.resolution_m
    distance, _ = distances_from(space.free, int(situation.exit_cells[-1]), np.zeros(0, dtype=np.int64), limit)
    return surface.taken(_beside(np.isfinite(distance).reshape(space.free.shape), surface.position))


@kernel
def _beside(near: BoolArray, position: FloatArray) -> BoolArray:
    out = np.zeros(len(position), dtype=np.bool_)
    for n in range(len(position)):
        # padded index of the neighbourhood's lower corner is the voxel's own unpadded index
        i, j, k = int(np.floor(position[n, 0])), int(np.floor(position[n, 1])), int(np.floor(position[n, 2]))
        for a in range(max(i, 0), min(i + 3, near.shape[0])):
            for b in range(max(j, 0), min(j + 3, near.shape[1])):
                for c in range(max(k, 0), min(k + 3, near.shape[2])):
                    out[n] = out[n] or near[a, b, c]
    return out


def clusters(surface: UncertainSurface, radius: float, aim_radius: float, count: int) -> list[FloatArray]:
    """Aim points (3,): take the most uncertain element, all within ``radius`` voxels of it with it, and so on, ``count`` times.

    The aim is the member nearest to the weighted mean of those within ``aim_radius``.
    """
    centres: list[FloatArray] = []
    left = surface.weight > 1e-6
    while len(centres) < count and left.any():
        seed = surface.position[int(np.argmax(np.where(left, surface.weight, -1.0)))]
        distance2 = ((surface.position - seed) ** 2).sum(axis=1)
        members = np.flatnonzero(left & (distance2 <= aim_radius**2))
        mean = np.average(surface.position[members], axis=0, weights=surface.weight[members])
        nearest = members[int(np.argmin(((surface.position[members] - mean) ** 2).sum(axis=1)))]
        centres.append(surface.position[nearest])
        left &= distance2 > radius**2
    return centres


def merged_to_cells(surface: UncertainSurface) -> UncertainSurface:
    """Elements summed up by cube of PROBE_CELL and main direction of the normal, to sort candidates cheaply."""
    if not len(surface.weight):
        return surface
    axis = np.argmax(np.abs(surface.normal), axis=1)
    side = np.take_along_axis(surface.normal, axis[:, None], axis=1)[:, 0] > 0
    cube = np.floor(surface.position / PROBE_CELL).astype(np.int64) + 4096
    key = ((cube[:, 0] * 8192 + cube[:, 1]) * 8192 + cube[:, 2]) * 6 + axis * 2 + side
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    weight = np.bincount(group.ravel(), weights=surface.weight).astype(np.float64)
    return UncertainSurface(surface.position[first], surface.normal[first], weight, surface.voxel[first])


@kernel
def _gain(
    state: ByteArray,
    lens: FloatArray,
    place: FloatArray,
    yaw: float,
    pitch: float,
    position: FloatArray,
    normal: FloatArray,
    weight: FloatArray,
) -> tuple[float, int, FloatArray]:
    """Sum of (n.v) sigma over visible elements, their number, and the cosine under which each is seen (0 = not)."""
    cosine = np.zeros(len(position))
    line = sight(lens, place, yaw, pitch)
    ex, ey, ez = line[0], line[1], line[2]
    total, count = 0.0, 0
    for n in range(len(position)):
        if not in_view(lens, line, position[n, 0], position[n, 1], position[n, 2]):
            continue
        dx, dy, dz = position[n, 0] - ex, position[n, 1] - ey, position[n, 2] - ez
        # outward normals: an element seen from behind is the far side of something thin
        facing = -(normal[n, 0] * dx + normal[n, 1] * dy + normal[n, 2] * dz) / np.sqrt(dx * dx + dy * dy + dz * dz)
        if facing <= 0.0 or not is_visible(state, ex, ey, ez, position[n, 0], position[n, 1], position[n, 2], TAIL):
            continue
        cosine[n] = facing
        total += facing * weight[n]
        count += 1
    return total, count, cosine


@kernel
def _sort_places(
    state: ByteArray,
    reachable: ByteArray,
    lens: FloatArray,
    places: FloatArray,
    centre: FloatArray,
    position: FloatArray,
    normal: FloatArray,
    weight: FloatArray,
) -> FloatArray:
    scores = np.zeros(len(places))
    for p in range(len(places)):
        i, j, k = int(places[p, 0]) + 1, int(places[p, 1]) + 1, int(places[p, 2]) + 1
        if places[p].min() < 0 or i >= reachable.shape[0] or j >= reachable.shape[1] or k >= reachable.shape[2]:
            continue
        if reachable[i, j, k] == 0:
            continue
        yaw, pitch = aim(lens, places[p, 0], places[p, 1], places[p, 2], centre[0], centre[1], centre[2])
        scores[p] = _gain(state, lens, places[p], yaw, pitch, position, normal, weight)[0]
    return scores


class SurfaceViews:
    """Finds views of uncertain surface for one vehicle and camera."""

    def __init__(self, config: PlannerConfig, camera: CameraGeometry) -> None:
        self._config = config
        self._camera = camera

    def propose(
        self, situation: Situation, surface: SurfaceElements | None, looks: FloatArray, factor: float
    ) -> list[Proposal]:
        """Return at most N_rec tasks; ``factor`` multiplies R_loc, R_clu and N_rec (alpha once no frontier is left).

        looks: (nx, ny, nz), sum of the cosines under which tasks have looked at the surface in a voxel. Gains are what a task
        adds to the ones before it.
        """
        if surface is None or not len(surface.position_world):
            return []
        config, grid = self._config, situation.voxels.grid
        elements = thinned(surface, situation, looks, config.downsample)
        near = local(elements, situation, config.local_radius_m * factor)
        radius = config.cluster_radius_m / grid.resolution_m
        centres = clusters(near, radius * factor, radius, round(config.max_reconstruct_tasks * factor))
        cells = merged_to_cells(near)
        radii_m = (0.5, 0.65, *np.linspace(config.shell_min_m, config.shell_max_m, 3))
        offsets = shell(self._camera, tuple(float(r) for r in radii_m), grid.resolution_m)
        proposals = [self._propose_one(situation, elements, cells, centre, offsets) for centre in centres]
        return [proposal for proposal in proposals if proposal is not None]

    def _propose_one(
        self,
        situation: Situation,
        elements: UncertainSurface,
        cells: UncertainSurface,
        centre: FloatArray,
        offsets: FloatArray,
    ) -> Proposal | None:
        state, reachable, grid = situation.voxels.state, situation.reachable, situation.voxels.grid
        lens = self._camera.lens(grid.resolution_m, min(self._camera.surface_range_m, self._camera.range_m))
        places = np.unique(np.floor(centre + offsets), axis=0) + 0.5
        around = cells.taken(
            ((cells.position - centre) ** 2).sum(axis=1) <= (1.5 * self._config.cluster_radius_m / grid.resolution_m) ** 2
        )
        scores = _sort_places(state, reachable, lens, places, centre, around.position, around.normal, around.weight)
        within = np.flatnonzero(((elements.position - centre) ** 2).sum(axis=1) <= (2 * lens[RANGE]) ** 2)
        in_range = elements.taken(within)
        best: tuple[float, int, float, float, FloatArray] | None = None
        for p in np.argsort(-scores, kind="stable")[:FULL_VIEWS]:
            if scores[p] <= 0.0:
                break
            yaw, pitch = aim(lens, *places[p], *centre)
            gain, count, cosine = _gain(state, lens, places[p], yaw, pitch, in_range.position, in_range.normal, in_range.weight)
            if count >= self._config.min_visible and (best is None or gain > best[0]):
                best = (gain, int(p), yaw, pitch, cosine)
        if best is None or best[0] < WORTH_SHARE * self._config.min_visible:
            return None
        gain, p, yaw, pitch, cosine = best
        cell = situation.space.flat(np.floor(places[p]).astype(np.int64) + 1)
        viewpoint = Viewpoint(grid.origin_world_m + places[p] * grid.resolution_m, yaw, pitch)
        task = Task(TaskKind.RECONSTRUCT, grid.origin_world_m + centre * grid.resolution_m, viewpoint, gain)
        # what this view will show is worth less to the views after it
        elements.weight[within] *= LOOK_DISCOUNT**cosine
        seen = np.flatnonzero((cosine > 0.0) & (in_range.voxel >= 0))
        promised, group = np.unique(in_range.voxel[seen], return_inverse=True)
        squareness = np.zeros(len(promised))
        np.maximum.at(squareness, group, cosine[seen])
        return Proposal(task, cell, promised, squareness)
