"""Information-gain field (EVPP): unknown space and uncertain surface seen from a position.

After Zeng et al., "Efficient view path planning for autonomous implicit reconstruction" (ICRA 2023): views are sampled near
the vehicle and the best is taken, without clusters and without a tour. The paper fits a network to the gain. Here, the
mapper's uncertainty is summed in patches, and so are frontier cells, which represent the unknown space behind them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.geometry.jit import kernel
from uav_recon.geometry.traversal import is_visible
from uav_recon.planning.camera_frustum import CAM_Z, NEAR, RANGE, CameraGeometry, LineOfSight, in_view, sight
from uav_recon.planning.candidate_view import MIN_SEEN, CandidateView, PlanningContext
from uav_recon.planning.frontier.frontiers import FACES, Frontier
from uav_recon.planning.reconstruction.surface_elements import (
    CELL,
    Elements,
    ElementsCache,
    element_weights,
    max_cosine_per_voxel,
    within,
)
from uav_recon.planning.reconstruction.surface_views import VIEW_DISCOUNT
from uav_recon.planning.reconstruction.view_gain import TAIL, patches_near, visible_gain
from uav_recon.types.frames import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from uav_recon.types.maps import FREE, SurfaceElements
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

UNKNOWN_WEIGHT = 2.0  # weight of a frontier cell; the most uncertain surface element has 1
SPACING = 4  # voxels between sampled positions
RADII_M = (3.0, 9.0, 1000.0)  # sampling radii around the vehicle; the next one is used if no view is found
MAX_PLACES = 1500  # the nearest ones
HEADINGS = 12
PITCHES = 3  # over the range of the mount
BEST_VIEWS = 12  # max. views for which path lengths are computed


class FieldViews:
    """Samples views of the gain field for one vehicle and camera."""

    def __init__(self, config: PlannerConfig, camera: CameraGeometry) -> None:
        self._config = config
        self._camera = camera
        self._elements = ElementsCache(config.downsample)

    def propose(
        self,
        context: PlanningContext,
        frontiers: Sequence[Frontier],
        surface: SurfaceElements | None,
        cosine_sums: Float32Array,
    ) -> list[CandidateView]:
        """Return the views (at most BEST_VIEWS) with the most gain per metre of distance.

        The order of ``frontiers`` does not matter.

        cosine_sums: (nx, ny, nz) sum of the cosines under which views have seen the surface in a voxel.

        The kind of a view is the larger part of its gain: unknown space or surface.
        """
        grid = context.voxels.grid
        here = context.space.cell_centres(context.exit_cells[-1:])[0] - 1.0
        for radius_m in RADII_M:
            proposals = self._within(context, frontiers, surface, cosine_sums, here, radius_m / grid.resolution_m)
            if proposals:
                return proposals
        return []

    def _within(
        self,
        context: PlanningContext,
        frontiers: Sequence[Frontier],
        surface: SurfaceElements | None,
        cosine_sums: Float32Array,
        here: FloatArray,
        radius: float,
    ) -> list[CandidateView]:
        resolution_m = context.voxels.grid.resolution_m
        lens = self._camera.lens(resolution_m, self._camera.range_m)
        places = sampled_places(context, here, radius)
        flat, frontier_rows, groups = frontier_patches(frontiers, context.voxels.grid.shape)
        rows = [frontier_rows]
        elements, around, weight = None, np.zeros((0, 3), dtype=np.int64), np.zeros(0)
        if surface is not None and len(surface.position_world):
            elements = self._elements.of(surface, context.voxels.grid)
            reach = radius + self._camera.range_m / resolution_m
            around = within(elements, here, reach)
            weight = element_weights(around, elements.sigma, elements.voxel, cosine_sums.ravel(), VIEW_DISCOUNT)
            rows.append(patches_near(here, reach, elements.position, elements.normal, weight, around))
        pitches = np.linspace(self._camera.pitch_min_rad, self._camera.pitch_max_rad, PITCHES)
        surface_range = min(self._camera.surface_range_m, self._camera.range_m) / resolution_m
        field = np.concatenate(rows)
        gains, yaws, tilts = field_gains(context.voxels.state, lens, places, field, len(frontier_rows), surface_range, pitches)
        away_m = np.sqrt(((places - here) ** 2).sum(axis=1)) * resolution_m
        proposals: list[CandidateView] = []
        for p in np.argsort(-gains / (1.0 + away_m), kind="stable"):
            if gains[p] <= 0.0 or len(proposals) == BEST_VIEWS:
                break
            view = Viewpoint(context.voxels.grid.origin_world_m + places[p] * resolution_m, float(yaws[p]), float(tilts[p]))
            found = self._proposal(context, lens, places[p], view, field, (flat, groups), elements, around, weight)
            if found is not None:
                proposals.append(found)
        return proposals

    def _proposal(
        self,
        context: PlanningContext,
        lens: FloatArray,
        place: FloatArray,
        view: Viewpoint,
        field: FloatArray,
        frontier: tuple[IntArray, IntArray],
        elements: Elements | None,
        around: IntArray,
        weight: FloatArray,
    ) -> CandidateView | None:
        """Return a view as a task of the kind with the larger gain; None if the gain is too small."""
        grid, state = context.voxels.grid, context.voxels.state
        cells, groups = frontier
        unknown = field[: len(groups) - 1]
        line = sight(lens, place, view.yaw_rad, view.pitch_down_rad)
        shown = rows_in_view(state, lens, line, unknown)
        flat = np.concatenate([np.zeros(0, dtype=np.int64), *(cells[groups[r] : groups[r + 1]] for r in np.flatnonzero(shown))])
        unknown_gain = float((shown * unknown[:, 6]).sum())
        surface_gain, cosine = 0.0, np.zeros(len(weight))
        if elements is not None:
            near = self._camera.lens(grid.resolution_m, min(self._camera.surface_range_m, self._camera.range_m))
            surface_gain, count = visible_gain(
                state, near, line, elements.position, elements.normal, weight, around, True, cosine
            )
            surface_gain = surface_gain if count >= self._config.min_visible else 0.0
        if len(flat) >= MIN_SEEN and unknown_gain >= surface_gain:
            task = Task(TaskKind.EXPLORE, view.position_world, view, unknown_gain + surface_gain)
            return CandidateView(task, place + 1.0, np.sort(flat), np.ones(len(flat)))
        if elements is None or surface_gain < self._config.min_visible:
            return None
        task = Task(TaskKind.RECONSTRUCT, view.position_world, view, unknown_gain + surface_gain)
        settled = np.flatnonzero(cosine)
        return CandidateView(task, place + 1.0, *max_cosine_per_voxel(elements.voxel[settled], cosine[settled]))


def sampled_places(context: PlanningContext, here: FloatArray, radius: float) -> FloatArray:
    """Return the centres (P, 3) of every SPACING-th reachable voxel within a radius of ``here``.

    ``here`` comes first.
    """
    reachable = context.space.reachable[1:-1, 1:-1, 1:-1]
    low = np.maximum(np.floor(here - radius).astype(np.int64), 0)
    low += -low % SPACING  # the same voxels for every vehicle position
    high = np.minimum(np.ceil(here + radius).astype(np.int64) + 1, reachable.shape)
    box = tuple(slice(int(a), int(max(a, b)), SPACING) for a, b in zip(low, high, strict=True))
    places = np.argwhere(reachable[box]) * SPACING + low + 0.5
    away2 = ((places - here) ** 2).sum(axis=1)
    nearest = np.argsort(away2, kind="stable")[:MAX_PLACES]
    nearest = nearest[away2[nearest] <= radius**2]
    return np.concatenate([here[None], places[nearest]])


def frontier_patches(frontiers: Sequence[Frontier], shape: tuple[int, int, int]) -> tuple[IntArray, FloatArray, IntArray]:
    """Group frontier cells by cubes.

    Returns flat voxels (F,), rows (G, 7) and the groups (G + 1,). A row is as in patches_near. Its normal points out of the
    unknown space; its weight is proportional to the number of cells.

    groups: start of each row's cells in the flat voxels.
    """
    if not frontiers:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 7)), np.zeros(1, dtype=np.int64)
    cells = np.concatenate([frontier.cells for frontier in frontiers])
    bits = np.concatenate([frontier.faces for frontier in frontiers])
    flat = np.ravel_multi_index(tuple(cells.T), shape).astype(np.int64)
    cube = np.ravel_multi_index(tuple((cells // int(CELL)).T), shape)
    order = np.lexsort((flat, cube))
    flat, cells, bits, cube = flat[order], cells[order], bits[order], cube[order]
    groups = np.append(np.flatnonzero(np.diff(cube, prepend=-1)), len(cube)).astype(np.int64)
    away = -((bits[:, None] >> np.arange(6)) & 1).astype(np.float64) @ FACES
    normal = np.add.reduceat(away, groups[:-1], axis=0)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    count = np.diff(groups)
    middle = np.add.reduceat(cells + 0.5, groups[:-1], axis=0) / count[:, None]
    # unknown on all sides of a cube: visible from every direction, so the normal is zero and _cosine() returns 1
    rows = np.column_stack([middle, np.where(length > 1e-9, normal / np.maximum(length, 1e-9), 0.0), UNKNOWN_WEIGHT * count])
    return flat, rows, groups


@kernel
def _cosine(row: FloatArray, x: float, y: float, z: float) -> float:
    dx, dy, dz = x - row[0], y - row[1], z - row[2]
    if row[3] == 0.0 and row[4] == 0.0 and row[5] == 0.0:
        return 1.0
    cosine: float = (row[3] * dx + row[4] * dy + row[5] * dz) / np.sqrt(dx * dx + dy * dy + dz * dz)
    return cosine


@kernel
def field_gains(
    state: ByteArray,
    lens: FloatArray,
    places: FloatArray,
    rows: FloatArray,
    unknown: int,
    surface_range: float,
    pitches: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the best gain, heading and pitch of each position (P, 3): three arrays (P,).

    rows: (M, 7) as in patches_near; the first ``unknown`` rows are frontier cells.
    surface_range: range in voxels up to which the other rows count.
    """
    best, yaws, tilts = np.zeros(len(places)), np.zeros(len(places)), np.zeros(len(places))
    visible = np.empty(len(rows), dtype=np.int64)
    cosine = np.empty(len(rows))
    for p in range(len(places)):
        x, y, z = places[p, 0], places[p, 1], places[p, 2] + lens[CAM_Z]
        count = 0
        for m in range(len(rows)):
            away2 = (rows[m, 0] - x) ** 2 + (rows[m, 1] - y) ** 2 + (rows[m, 2] - z) ** 2
            reach = lens[RANGE] if m < unknown else surface_range
            if away2 > reach * reach or away2 < lens[NEAR] * lens[NEAR]:
                continue
            facing = _cosine(rows[m], x, y, z)
            if facing > 0.0 and is_visible(state, x, y, z, rows[m, 0], rows[m, 1], rows[m, 2], TAIL):
                visible[count], cosine[count] = m, facing if m >= unknown else 1.0
                count += 1
        for heading in range(HEADINGS):
            for pitch in pitches:
                yaw = 2.0 * np.pi * heading / HEADINGS
                line = sight(lens, places[p], yaw, pitch)
                gain = 0.0
                for n in range(count):
                    m = visible[n]
                    if in_view(lens, line, rows[m, 0], rows[m, 1], rows[m, 2]):
                        gain += cosine[n] * rows[m, 6]
                if gain > best[p]:
                    best[p], yaws[p], tilts[p] = gain, yaw, pitch
    return best, yaws, tilts


@kernel
def rows_in_view(state: ByteArray, lens: FloatArray, line: LineOfSight, rows: FloatArray) -> BoolArray:
    """Return a mask (M,) of the rows that are visible along a line of sight."""
    out = np.zeros(len(rows), dtype=np.bool_)
    for m in range(len(rows)):
        x, y, z = rows[m, 0], rows[m, 1], rows[m, 2]
        out[m] = in_view(lens, line, x, y, z) and _cosine(rows[m], line[0], line[1], line[2]) > 0.0
        out[m] = out[m] and is_visible(state, line[0], line[1], line[2], x, y, z, TAIL)
    return out


def warm_up() -> None:
    """Compile the kernels of FieldViews that are not also compiled for SurfaceViews."""
    state = np.full((4, 4, 4), FREE, dtype=np.uint8)
    state.setflags(write=False)
    lens = CameraGeometry(1.5, 1.0, np.zeros(3), -1.0, 1.0, 4.5).lens(1.0, 4.5)
    places, rows = np.full((1, 3), 0.5), np.array([[2.5, 2.5, 2.5, -1.0, 0.0, 0.0, 1.0]])
    field_gains(state, lens, places, rows, 1, 3.0, np.zeros(1))
    line = sight(lens, places[0], 0.0, 0.0)
    rows_in_view(state, lens, line, rows)
    cells, one = np.array([[0, 1, 0]]), np.ones(1)
    visible_gain(state, lens, line, rows[:, :3].copy(), rows[:, 3:6].copy(), one, cells, True, np.zeros(1))
    element_weights(cells, one, np.zeros(1, dtype=np.int64), np.zeros(64, dtype=np.float32), VIEW_DISCOUNT)
    patches_near(places[0], 9.0, rows[:, :3].copy(), rows[:, 3:6].copy(), one, cells)
