"""The best view of each frontier cluster, cached until its dependencies change."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.candidate_view import MIN_SEEN, CandidateView
from uav_recon.planning.frontier.cluster_table import OPENING
from uav_recon.planning.frontier.frontiers import Frontiers
from uav_recon.planning.frontier.reachable_tiles import ReachableInterface, ReachableTiles
from uav_recon.planning.frontier.view_cache import ViewCache
from uav_recon.planning.frontier.view_search import SearchScene
from uav_recon.planning.view_sampling import explore_shell
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, UNKNOWN, GridSpec, VoxelMap
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

COVERED_SHARE = 0.7  # a cluster has no task of its own if other views show this share of what its own view shows
BATCH = 32  # clusters evaluated, nearest first; the number is doubled until there is a view
MAX_MORE = 256  # ... by at most this number: the results of one round must fit into the table
SEARCHES = 2  # searches per map revision since the last plan; if exceeded and a view exists, the rest is left for later plans


class FlyableInterface(ReachableInterface, Protocol):
    """The part of the flyable space used here; see FlyableSpace."""

    @property
    def mask(self) -> ByteArray:
        """Return the mask (nx + 2, ny + 2, nz + 2) uint8, padded by zeros: 1 = flyable."""

    @property
    def clearance_box(self) -> FloatArray:
        """Return the clearance box (9,); see subvoxel_clearance.make_clearance_box()."""


@dataclass(frozen=True, slots=True)
class ViewDemand:
    """The demand that a view of a frontier must meet to be worth a stop.

    min_cells: frontier cells that it shows. specks: clusters of few connected cells are viewed too.
    """

    min_cells: int
    specks: bool = False


USUAL = ViewDemand(MIN_SEEN)
LOW = ViewDemand(3, specks=True)  # of the last views before home


@dataclass(frozen=True, slots=True, eq=False)
class FrontierProposals:
    """Tasks for frontiers, nearest cluster first.

    openings: (N,) number of openings, clusters with much unknown space beyond, that each of the N tasks stands for.
    without_view: number of clusters without a view.
    later: number of clusters left for later plans; openings_later: those of them that are openings.
    """

    proposals: list[CandidateView]
    openings: IntArray
    without_view: int
    later: int
    openings_later: int


class FrontierViews:
    """Finds the best view of each cluster. A view does not depend on the vehicle's position."""

    view_cache: ViewCache
    _revision: int
    _centre: FloatArray

    def __init__(self, config: PlannerConfig, camera: CameraGeometry, demand: ViewDemand = USUAL) -> None:
        self._config = config
        self._camera = camera
        self._demand = demand
        self._plans = 0
        self._tiles = ReachableTiles()
        self._start(np.zeros((0, 0, 0), dtype=np.uint8), 1.0)

    def update(
        self, voxels: VoxelMap, space: FlyableInterface, frontiers: Frontiers, position_world: FloatArray
    ) -> FrontierProposals:
        """Find views of the BATCH clusters nearest to a position, or of more while there is none.

        A cluster has no task of its own if the views of others cover it. ``frontiers`` must be up to date with ``voxels``. The
        tour executes only the first few metres, so distant clusters can wait. A cluster without a reachable voxel in range of
        a view has no view and is not searched.
        """
        grid, specks = voxels.grid, self._demand.specks
        self._keep_map(frontiers, grid.resolution_m)
        self._plans += 1
        here = (position_world - grid.origin_world_m) / grid.resolution_m
        lens, total = self._camera.lens(grid.resolution_m, self._camera.range_m), frontiers.table.size(specks=specks)
        found: list[int] = []
        openings: list[int] = []  # those of the found
        without, later, asked, wanted = 0, 0, 0, min(BATCH, total)
        searches = SEARCHES * max(1, voxels.revision - self._revision)
        self._revision = voxels.revision
        nearest = frontiers.table.nearest(here, wanted, specks=specks)
        while asked < wanted:
            clusters = nearest[asked:wanted]
            before, asked = asked, wanted
            if before:
                near = self._tiles.near(frontiers.table.rows.centre[clusters], self._reach)
                clusters, without = clusters[near], without + int(np.count_nonzero(~near))
            for cluster, held in zip(clusters.tolist(), self._cached_rows(voxels, space, frontiers, clusters), strict=True):
                row = held if self.view_cache.holds_cluster(held, int(frontiers.table.rows.key[cluster])) else -1
                if row < 0 and (searches > 0 or not found):
                    searches -= 1
                    row = self._search(voxels, space, space.reachable, frontiers, cluster, lens)
                if row < 0:
                    later += 1
                elif self._meets_demand(row):
                    self.view_cache.used[row] = self._plans
                    found.append(row)
                    if frontiers.table.rows.beyond[cluster] >= OPENING:
                        openings.append(row)
                else:
                    without += 1
            if not found and asked < total:
                if not before:
                    self._tiles.update(space)
                    nearest = frontiers.table.nearest(here, total, specks=specks)
                wanted = min(2 * wanted, wanted + MAX_MORE, total)
        openings_later = frontiers.openings - int(np.count_nonzero(frontiers.table.rows.beyond[nearest[:asked]] >= OPENING))
        proposals, counts = self._proposals(voxels, found, openings, lens)
        return FrontierProposals(proposals, counts, without, total - asked + later, max(openings_later, 0))

    def reasons(self, voxels: VoxelMap, space: FlyableInterface, frontiers: Frontiers) -> Counter[ReasonCode]:
        """Count the clusters without a view, by reason.

        Evaluates every cluster again; meant for the end of a flight.
        """
        found = self.reasons_of_clusters(voxels, space, frontiers, frontiers.rows())
        return Counter(reason for reason in found if reason is not None)

    def reasons_of_clusters(
        self, voxels: VoxelMap, space: FlyableInterface, frontiers: Frontiers, clusters: IntArray
    ) -> list[ReasonCode | None]:
        """Return why each of some clusters (rows of the table) has no view, None if it has one."""
        self._keep_map(frontiers, voxels.grid.resolution_m)
        lens = self._camera.lens(voxels.grid.resolution_m, self._camera.range_m)
        return [self._reason(voxels, space, frontiers, cluster, lens) for cluster in clusters.tolist()]

    def _cached_rows(self, voxels: VoxelMap, space: FlyableInterface, frontiers: Frontiers, clusters: IntArray) -> list[int]:
        """Return the rows of the valid cached results of these clusters, -1 for none.

        Rows with a view are protected from replacement in this plan.
        """
        keys = frontiers.table.rows.key[clusters].tolist()
        held = self.view_cache.valid_rows(keys, voxels.distance2, space.reachable, frontiers.closed, space.reachable_revision)
        self.view_cache.used[
            [row for row in held if row >= 0 and self.view_cache.rows.shown[row] >= self._demand.min_cells]
        ] = self._plans
        return held

    def _search(
        self,
        voxels: VoxelMap,
        space: FlyableInterface,
        reachable: ByteArray,
        frontiers: Frontiers,
        cluster: int,
        lens: FloatArray,
    ) -> int:
        clusters, revisions = frontiers.table.rows, (voxels.revision, space.revision)
        scene = SearchScene(
            distance2=voxels.distance2.reshape(-1), shape=voxels.grid.shape, reachable=reachable.reshape(-1),
            clearance_box=space.clearance_box, lens=lens,
        )  # fmt: skip
        row = self.view_cache.search(
            int(clusters.key[cluster]), scene, frontiers.faces, frontiers.flat(cluster), clusters.centre[cluster], revisions,
            self._plans,
        )  # fmt: skip
        self._centre[row] = clusters.centre[cluster]
        return row

    def _meets_demand(self, row: int) -> bool:
        return bool(self.view_cache.rows.shown[row] >= self._demand.min_cells)

    def _proposals(
        self, voxels: VoxelMap, found: list[int], openings: list[int], lens: FloatArray
    ) -> tuple[list[CandidateView], IntArray]:
        """Return tasks for views that together cover the clusters, and the openings of each (N,).

        Those of the nearest clusters come first. A view from far away may show several clusters at once. A task promises the
        cells that no larger one shows. It stands for the openings whose own view is nearer to it than to any other task.
        """
        if not found:
            return [], np.zeros(0, dtype=np.int64)
        best_first = sorted(found, key=lambda row: (-int(self.view_cache.rows.shown[row]), self.view_cache.key[row]))
        covering = self.view_cache.covering_views(best_first, voxels, lens, COVERED_SHARE)
        place = {row: n for n, row in enumerate(found)}
        covering.sort(key=lambda one: place[one[0]])
        covering = [one for one in covering if len(one[1]) >= self._demand.min_cells]
        counts = np.zeros(len(covering), dtype=np.int64)
        if covering and openings:
            places = self.view_cache.rows.pose[:, :3]
            away = np.linalg.norm(places[openings, None] - places[[row for row, _ in covering]], axis=2)
            counts += np.bincount(away.argmin(axis=1), minlength=len(covering))
        return [self._proposal(voxels.grid, row, cells) for row, cells in covering], counts

    def _proposal(self, grid: GridSpec, row: int, cells: IntArray) -> CandidateView:
        x, y, z, yaw, pitch = self.view_cache.rows.pose[row].tolist()
        place = np.array([x, y, z])
        viewpoint = Viewpoint(grid.origin_world_m + place * grid.resolution_m, yaw, pitch)
        centroid_world = grid.origin_world_m + self._centre[row] * grid.resolution_m
        task = Task(TaskKind.EXPLORE, centroid_world, viewpoint, float(len(cells)))
        return CandidateView(task, place + 1.0, cells, np.ones(len(cells)))

    def _reason(
        self, voxels: VoxelMap, space: FlyableInterface, frontiers: Frontiers, cluster: int, lens: FloatArray
    ) -> ReasonCode | None:
        row = self._search(voxels, space, space.reachable, frontiers, cluster, lens)
        if self._meets_demand(row):
            return None
        tested = self.view_cache.rows.tested_cells[row, : self.view_cache.rows.counts[row, 0]]
        if not space.mask.reshape(-1)[np.where(tested >= 0, tested, ~tested)].any():
            return ReasonCode.FRONTIERS_TOO_NARROW
        if self.view_cache.rows.shown[row]:
            return ReasonCode.FRONTIERS_TOO_FEW_CELLS
        row = self._search(voxels, space, space.mask, frontiers, cluster, lens)
        beyond = self._meets_demand(row)
        self.view_cache.remove(row)
        return ReasonCode.FRONTIERS_NOT_REACHABLE if beyond else ReasonCode.FRONTIERS_OUT_OF_VIEW

    def _keep_map(self, frontiers: Frontiers, resolution_m: float) -> None:
        if frontiers.faces is not self._faces:
            self._start(frontiers.faces, resolution_m)

    def _start(self, faces: ByteArray, resolution_m: float) -> None:
        """Clear all caches for another map."""
        self._faces = faces
        self._revision = -BATCH  # the first plan may search a whole batch
        self.view_cache = ViewCache(explore_shell(self._config, self._camera, resolution_m))
        self._reach = float(
            np.abs(self.view_cache.shell.offsets).max(initial=0.0)
        )  # of a place from its frontier, along an axis
        self._centre = np.zeros((len(self.view_cache.rows.shown), 3))  # cluster centres by row, voxels


def warm_up(config: PlannerConfig, camera: CameraGeometry) -> None:
    """Compile every kernel of frontiers and their views on a small read-only map."""
    grid = GridSpec(np.zeros(3), 0.1, (40, 30, 20))
    state = np.full(grid.shape, FREE, dtype=np.uint8)
    state[28:, :20] = UNKNOWN
    state[3, 3, 3] = UNKNOWN
    distance2 = np.where(state == FREE, 25, 0).astype(np.uint8)
    state.setflags(write=False)
    distance2.setflags(write=False)
    frontiers, views = Frontiers(), FrontierViews(config, camera)
    mask = np.zeros((42, 32, 22), dtype=np.uint8)
    clearance_box = np.array([0.0, 0.0, 0.0, 40.0, 30.0, 20.0, 9.0, 0.0, 1.0])
    for revision, reachable in enumerate((mask + np.uint8(1), mask)):
        space = _Anywhere(mask + np.uint8(1), reachable, revision, np.full((5, 4), revision, dtype=np.int64), clearance_box)
        voxels = VoxelMap.whole(grid, state, distance2, revision)
        frontiers.update(voxels, np.zeros(3, dtype=np.int64), np.array(grid.shape), np.zeros(grid.shape, dtype=np.uint8))
        views.update(voxels, space, frontiers, np.ones(3))
        views.reasons(voxels, space, frontiers)
        tiles = ReachableTiles()
        tiles.update(space)
        tiles.near(np.ones((1, 3)), 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Anywhere:
    """A flyable space for warm_up()."""

    mask: ByteArray
    reachable: ByteArray
    revision: int
    reachable_revision: IntArray
    clearance_box: FloatArray
