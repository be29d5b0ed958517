"""The best view of each frontier cluster, kept until something that it hangs on changes."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.planning.camera import CameraGeometry
from uav_recon.planning.frontiers import Frontiers
from uav_recon.planning.glimpses import MOST_BLOCKERS, best_view, redundant, still_holds, targets
from uav_recon.planning.proposal import Proposal
from uav_recon.planning.shell import Shell, explore_shell
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import FREE, UNKNOWN, GridSpec, VoxelMap
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

MIN_SEEN = 4  # cells: less is not worth a stop, unless the cluster has no more
COVERED_SHARE = 0.7  # of what its own view sees: a frontier that another view shows so well needs no stop of its own
BATCH = 32  # clusters looked at, the nearest first; as many more as long as there is no view at all
SEARCHES = 6  # for each revision of the map since the last plan, or until there is a view: the rest is left for later
MOST_KEPT = 4096


class Flyable(Protocol):
    """What of the flyable space is asked; see FlyableSpace. Both (nx + 2, ny + 2, nz + 2) uint8, padded by zeros."""

    @property
    def mask(self) -> ByteArray:
        """1 = flyable."""

    @property
    def reachable(self) -> ByteArray:
        """1 = flyable and connected with the vehicle."""

    @property
    def revision(self) -> int:
        """Grows with each change of ``reachable``."""

    @property
    def reachable_revision(self) -> IntArray:
        """(tiles) the revision at which ``reachable`` last changed in a tile of TILE x TILE columns."""


@dataclass(frozen=True, slots=True, eq=False)
class KeptView:
    """The best view of a cluster as of revisions of map and space, and what it hangs on (see glimpses.best_view).

    proposal: None = there is no view. view: (5,) place in voxels, yaw, pitch down. points, first: glimpses.targets() of the
    cells it shows. is_whole: what it hangs on is known in full.
    """

    key: int
    proposal: Proposal | None
    view: FloatArray
    points: FloatArray
    first: IntArray
    asked: IntArray
    blockers: IntArray
    box: IntArray
    revision: int
    space_revision: int
    is_whole: bool

    @property
    def cells_shown(self) -> int:
        """How many cells of the cluster the view shows; 0 without one."""
        return len(self.first) - 1 if self.proposal is not None else 0


@dataclass(frozen=True, slots=True, eq=False)
class FrontierProposals:
    """Tasks for frontiers, the nearest cluster first; how many clusters have no view, and how many were left for later."""

    proposals: list[Proposal]
    without_view: int
    later: int


class FrontierViews:
    """Finds the best view of each cluster for one vehicle and camera. A view does not depend on where the vehicle is."""

    def __init__(self, config: PlannerConfig, camera: CameraGeometry) -> None:
        self._config = config
        self._camera = camera
        self._shell: tuple[float, Shell] | None = None
        self._revision = 0
        self._start(np.zeros((0, 0, 0), dtype=np.uint8))

    def update(self, voxels: VoxelMap, space: Flyable, frontiers: Frontiers, position_world: FloatArray) -> FrontierProposals:
        """Find views of the clusters nearest to a position, BATCH at a time, until there is one. Tasks that another one's view
        covers are left out; that view promises theirs too.

        ``frontiers`` is to have seen ``voxels``. The tour executes only the first few metres: far clusters can wait.
        """
        if frontiers.faces is not self._faces:
            self._start(frontiers.faces)
        grid = voxels.grid
        lens = self._camera.lens(grid.resolution_m, self._camera.range_m)
        here = (position_world - grid.origin_world_m) / grid.resolution_m
        total = len(frontiers)
        views: list[KeptView] = []
        without, later = 0, 0
        searches = SEARCHES * max(1, voxels.revision - self._revision)
        self._revision = voxels.revision
        asked, wanted = 0, min(BATCH, total)
        while asked < wanted:
            rows = frontiers.table.nearest(here, wanted)[asked:]
            for row in rows:
                view = self._known(voxels, space, frontiers, int(row))
                if view is None and (searches > 0 or not views):
                    searches -= 1
                    view = self._search(voxels, space, frontiers, int(row), lens)
                if view is None:
                    later += 1
                elif view.proposal is None:
                    without += 1
                else:
                    views.append(view)
            asked += len(rows)
            wanted = asked if views else min(wanted + BATCH, total)
        self._forget_most()
        return FrontierProposals(self._without_redundant(voxels, views, lens), without, total - asked + later)

    def reasons(self, voxels: VoxelMap, space: Flyable, frontiers: Frontiers) -> Counter[str]:
        """Why clusters have no view: how many, by reason. For the end: it looks at every cluster without one in full."""
        counts: Counter[str] = Counter()
        lens = self._camera.lens(voxels.grid.resolution_m, self._camera.range_m)
        for row in frontiers.rows():
            view = self._known(voxels, space, frontiers, int(row)) or self._search(voxels, space, frontiers, int(row), lens)
            if view.proposal is None:
                counts[self._reason(voxels, space, frontiers, int(row), view, lens)] += 1
        return counts

    def _known(self, voxels: VoxelMap, space: Flyable, frontiers: Frontiers, row: int) -> KeptView | None:
        kept = self._kept.get(int(frontiers.table.key[row]))
        if (
            kept is None
            or not kept.is_whole
            or not still_holds(
                voxels.distance2.reshape(-1), space.reachable.reshape(-1), frontiers.closed, kept.revision,
                space.reachable_revision, kept.space_revision, kept.asked, kept.blockers, kept.box,
            )
        ):  # fmt: skip
            return None
        return kept

    def _search(self, voxels: VoxelMap, space: Flyable, frontiers: Frontiers, row: int, lens: FloatArray) -> KeptView:
        kept = self._find(voxels, space.reachable, space.revision, frontiers, row, lens)
        self._kept[kept.key] = kept
        return kept

    def _find(
        self, voxels: VoxelMap, reachable: ByteArray, space_revision: int, frontiers: Frontiers, row: int, lens: FloatArray
    ) -> KeptView:
        grid = voxels.grid
        flat, centre = frontiers.flat(row), frontiers.table.centre[row]
        points, first = targets(frontiers.faces, flat)
        self._mark += 1
        shell = self._shell_of(grid.resolution_m)
        view, seen, asks, hidden, box = best_view(
            voxels.distance2.reshape(-1), grid.shape, reachable.reshape(-1), lens, shell.offsets, shell.ends, shell.places,
            centre, points, first, self._stamp, self._mark, self._asked, self._blockers,
        )  # fmt: skip
        count = int(np.count_nonzero(seen))
        proposal = None
        if count >= min(MIN_SEEN, len(flat)):
            viewpoint = Viewpoint(grid.origin_world_m + view[:3] * grid.resolution_m, float(view[3]), float(view[4]))
            task = Task(TaskKind.EXPLORE, grid.origin_world_m + centre * grid.resolution_m, viewpoint, float(count))
            i, j, k = (int(v) + 1 for v in view[:3])
            cell = (i * reachable.shape[1] + j) * reachable.shape[2] + k
            proposal = Proposal(task, cell, flat[seen], np.ones(count))
            points, first = targets(frontiers.faces, flat[seen])
        return KeptView(
            key=int(frontiers.table.key[row]),
            proposal=proposal,
            view=view,
            points=points,
            first=first,
            asked=self._asked[:asks].copy(),
            blockers=self._blockers[:hidden].copy(),
            box=box,
            revision=voxels.revision,
            space_revision=space_revision,
            is_whole=hidden <= MOST_BLOCKERS,
        )

    def _without_redundant(self, voxels: VoxelMap, views: list[KeptView], lens: FloatArray) -> list[Proposal]:
        """Leave out tasks whose cells a better view shows as well; that view then promises those too."""
        if not views:
            return []
        best_first = sorted(range(len(views)), key=lambda n: (-views[n].cells_shown, views[n].key))
        ordered = [views[n] for n in best_first]
        lengths = [len(view.points) for view in ordered]
        offset = np.cumsum([0, *lengths])
        first = np.concatenate(
            [view.first[:-1] + start for view, start in zip(ordered, offset[:-1], strict=True)] + [offset[-1:]]
        )
        begin = np.cumsum([0, *(len(view.first) - 1 for view in ordered)])
        covered_by = redundant(
            voxels.distance2.reshape(-1), voxels.grid.shape, lens, np.stack([view.view for view in ordered]),
            np.concatenate([view.points for view in ordered]), first, begin, COVERED_SHARE,
        )  # fmt: skip
        groups: dict[int, list[KeptView]] = {}
        for n, by in enumerate(covered_by.tolist()):
            groups.setdefault(by, []).append(ordered[n])
        return [self._joined(tuple(groups[n])) for _, n in sorted((best_first[n], n) for n in groups)]

    def _joined(self, group: tuple[KeptView, ...]) -> Proposal:
        """The first one's task, which promises what all promise."""
        own = group[0].proposal
        assert own is not None
        if len(group) == 1:
            return own
        kept = self._joined_kept.get(group[0].key)
        if kept is None or len(kept[0]) != len(group) or any(a is not b for a, b in zip(kept[0], group, strict=True)):
            promised = np.concatenate([view.proposal.promised for view in group if view.proposal is not None])
            kept = (group, replace(own, promised=promised, squareness=np.ones(len(promised))))
            self._joined_kept[group[0].key] = kept
        return kept[1]

    def _reason(
        self, voxels: VoxelMap, space: Flyable, frontiers: Frontiers, row: int, kept: KeptView, lens: FloatArray
    ) -> str:
        places = np.where(kept.asked >= 0, kept.asked, ~kept.asked)
        if not space.mask.reshape(-1)[places].any():
            return "too narrow"
        if kept.view.any():
            return "too few cells in sight"
        if self._find(voxels, space.mask, space.revision, frontiers, row, lens).proposal is not None:
            return "not reachable"
        return "out of the camera's sight"

    def _shell_of(self, resolution_m: float) -> Shell:
        if self._shell is None or self._shell[0] != resolution_m:
            self._shell = (resolution_m, explore_shell(self._config, self._camera, resolution_m))
            self._asked = np.zeros(len(self._shell[1].offsets), dtype=np.int64)
        return self._shell[1]

    def _start(self, faces: ByteArray) -> None:
        """Forget all: it is another map."""
        self._faces = faces
        self._revision = -BATCH  # for the first plan all of a batch
        self._kept: dict[int, KeptView] = {}
        self._joined_kept: dict[int, tuple[tuple[KeptView, ...], Proposal]] = {}
        self._stamp, self._mark = np.zeros(faces.size, dtype=np.int64), 0
        self._blockers = np.zeros(MOST_BLOCKERS, dtype=np.int64)

    def _forget_most(self) -> None:
        """Views of clusters that are gone would pile up; those still wanted are soon found again."""
        if len(self._kept) > MOST_KEPT:
            self._kept.clear()
            self._joined_kept.clear()


def warm_up(config: PlannerConfig, camera: CameraGeometry) -> None:
    """Compile every kernel of frontiers and their views on a toy map: read-only, as those of the mapping are."""
    grid = GridSpec(np.zeros(3), 0.1, (40, 30, 20))
    state = np.full(grid.shape, FREE, dtype=np.uint8)
    state[28:, :20] = UNKNOWN
    state[3, 3, 3] = UNKNOWN
    distance2 = np.where(state == FREE, 25, 0).astype(np.uint8)
    state.setflags(write=False)
    distance2.setflags(write=False)
    frontiers, views = Frontiers(), FrontierViews(config, camera)
    mask = np.zeros((42, 32, 22), dtype=np.uint8)
    for revision, reachable in enumerate((mask + np.uint8(1), mask)):
        space = _Anywhere(mask + np.uint8(1), reachable, revision, np.full((5, 4), revision, dtype=np.int64))
        voxels = VoxelMap.whole(grid, state, distance2, revision)
        frontiers.update(voxels, np.zeros(3, dtype=np.int64), np.array(grid.shape), np.zeros(grid.shape, dtype=np.uint8))
        views.update(voxels, space, frontiers, np.ones(3))
        views.reasons(voxels, space, frontiers)


@dataclass(frozen=True, slots=True, eq=False)
class _Anywhere:
    """A space to warm up with."""

    mask: ByteArray
    reachable: ByteArray
    revision: int
    reachable_revision: IntArray
