"""Task sources: best views of frontier and surface clusters, or samples of a gain field."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.planning.candidate_view import CandidateView, PlanningContext
from uav_recon.planning.frontier.cluster_table import OPENING
from uav_recon.planning.frontier.frontier_views import FrontierViews
from uav_recon.planning.frontier.frontiers import Frontiers
from uav_recon.planning.paths.path_cache import PathCache
from uav_recon.planning.reconstruction.gain_field import FieldViews
from uav_recon.planning.reconstruction.surface_views import SurfaceViews
from uav_recon.planning.variants import Variant
from uav_recon.types.frames import Float32Array, FloatArray, IntArray
from uav_recon.types.maps import SurfaceElements
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import PlanMode, TaskKind

# the nearest ones: the horizon executes only the first few
MAX_FRONTIERS = 24
MAX_TASKS = 40


@dataclass(frozen=True, slots=True, eq=False)
class GeneratedTasks:
    """The tasks of one plan.

    frontiers: number of frontiers that can be viewed, and of openings that have not been searched for a view yet.
    widening: alpha once no opening can be viewed, else 1. explored: exploration has ended.
    """

    mode: PlanMode
    proposals: list[CandidateView]
    frontiers: int
    widening: float = 1.0
    explored: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class TaskQuery:
    """The inputs of a task source for one plan.

    cosine_sums: (nx, ny, nz) sum of the cosines under which earlier views have seen the surface in a voxel.
    views_left: remaining views in the budget.
    """

    context: PlanningContext
    frontiers: Frontiers
    path_cache: PathCache
    surface: SurfaceElements | None
    cosine_sums: Float32Array
    views_left: int


class TaskSource(Protocol):
    """Generates the tasks of one plan. Its state is only a cache."""

    def propose(self, query: TaskQuery) -> GeneratedTasks:
        """Return the tasks of one plan."""
        ...

    def reasons(self, context: PlanningContext, frontiers: Frontiers) -> Counter[ReasonCode]:
        """Count the frontiers without a view, by reason. Slow; meant for the end of a flight."""
        ...


class ClusterTasks:
    """The paper's task source: the best view of each frontier and surface cluster.

    Surface tasks are generated only in merged mode. min_unknown: unknown voxels that a view of a frontier must promise.

    Difference from the paper: surface gets the views that the frontiers leave, most uncertain surface first.
    """

    def __init__(
        self, config: PlannerConfig, variant: Variant, views: FrontierViews, surfaces: SurfaceViews, min_unknown: int = 0
    ) -> None:
        self._variant = variant
        self._min_unknown = min_unknown
        self._explores = TaskKind.EXPLORE in variant.kinds
        self._end_factor = config.end_factor
        self._views = views
        self._surfaces = surfaces

    def propose(self, query: TaskQuery) -> GeneratedTasks:
        """See TaskSource."""
        context, path_cache = query.context, query.path_cache
        found, openings, later = self._explore(context, query.frontiers)
        explore = found[:MAX_FRONTIERS]
        path_cache.update(context.exit_cells, context.position_world, view_positions(explore))
        farther = later + int(openings[MAX_FRONTIERS:].sum())
        mode = self._variant.mode_rule.choose(path_cache.lengths_m[0, 1:], openings[:MAX_FRONTIERS], farther)
        spare, frontiers = query.views_left - len(explore), len(found) + later
        if mode is PlanMode.EXPLORE or TaskKind.RECONSTRUCT not in self._variant.kinds or spare <= 0:
            return GeneratedTasks(mode, explore, frontiers)
        ended = self._explores and not any(one.task.gain >= OPENING for one in explore)
        surface, widening = self._surface(query, ended=ended, only=not explore)
        tasks = (explore + surface[:spare])[:MAX_TASKS]
        return GeneratedTasks(mode, tasks, frontiers, widening, explored=ended and not later)

    def _surface(self, query: TaskQuery, *, ended: bool, only: bool) -> tuple[list[CandidateView], float]:
        """Return surface tasks near the vehicle, and the factor by which "near" was widened.

        ended: no opening can be viewed, so tasks are sought in the whole room. only: there is no other task, so that they
        are if none is near.
        """
        for widening in (self._end_factor,) if ended else (1.0, self._end_factor) if only else (1.0,):
            tasks = self._surfaces.propose(query.context, query.surface, query.cosine_sums, widening)
            if tasks:
                break
        return tasks, widening

    def reasons(self, context: PlanningContext, frontiers: Frontiers) -> Counter[ReasonCode]:
        """See TaskSource."""
        if not self._explores:
            return Counter()
        return self._views.reasons(context.voxels, context.space, frontiers)

    def _explore(self, context: PlanningContext, frontiers: Frontiers) -> tuple[list[CandidateView], IntArray, int]:
        """Return the tasks of the nearest frontiers, and the number of openings of each (N,).

        The last result is the number of openings not searched yet.

        Openings come first. The gain of a task is the unknown volume beyond all frontier cells that its view shows.
        """
        if not self._explores:
            return [], np.zeros(0, dtype=np.int64), 0
        found = self._views.update(context.voxels, context.space, frontiers, context.position_world)
        gains = frontiers.unknown_beyond(context.voxels, [one.expected_voxels for one in found.proposals])
        kept = [n for n, gain in enumerate(gains.tolist()) if gain >= self._min_unknown]
        tasks = [found.proposals[n].with_gain(gains[n]) for n in kept]
        return tasks, found.openings[kept], found.openings_later


def view_positions(proposals: list[CandidateView]) -> FloatArray:
    """Return the positions (N, 3) of the candidate views, in padded voxel units."""
    return np.array([proposal.position_padded for proposal in proposals], dtype=np.float64).reshape(-1, 3)


class GainField:
    """EVPP's task source: views sampled near the vehicle, ranked by an information-gain field."""

    def __init__(self, views: FieldViews, reasons: FrontierViews) -> None:
        self._views = views
        self._reasons = reasons

    def propose(self, query: TaskQuery) -> GeneratedTasks:
        """See TaskSource."""
        frontiers = query.frontiers.clusters()
        return GeneratedTasks(
            PlanMode.MERGED,
            self._views.propose(query.context, frontiers, query.surface, query.cosine_sums),
            len(frontiers),
        )

    def reasons(self, context: PlanningContext, frontiers: Frontiers) -> Counter[ReasonCode]:
        """See TaskSource."""
        return self._reasons.reasons(context.voxels, context.space, frontiers)
